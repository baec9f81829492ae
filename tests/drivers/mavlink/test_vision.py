"""Beacons as an autopilot's external vision: from a serial port through both drivers to the
vehicle's own endpoint.
"""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from drivers.interfaces import BeaconFix, VehicleError
from drivers.mavlink import vision as vision_module
from drivers.mavlink.modes import ARDUPILOT, PX4, AutopilotKind
from drivers.mavlink.vision import VisionConfig, VisionFeed, beacon_in_n, origin_fields
from drivers.rig.parts import PartSpec
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.pty import SerialCable
from tests.drivers.link.link_ends import run
from tests.drivers.mavlink.mavsdk_bench import LIMIT_S, ORIGIN, into_the_air, px4, until

NOBODY = PartSpec("drivers.beacons.marvelmind:Marvelmind", {}, "test")


@pytest.mark.parametrize(
    ("heading_deg", "place", "expected"),
    [
        (0.0, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),  # x to the north, y to the west
        (0.0, (0.0, 1.0, 2.0), (0.0, -1.0, -2.0)),
        (90.0, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # x to the east, y to the north
        (90.0, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ],
)
def test_the_beacons_frame_is_turned_into_the_missions(
    heading_deg: float, place: Any, expected: Any
) -> None:
    assert beacon_in_n(place, VisionConfig(NOBODY, 5, x_heading_deg=heading_deg)) == pytest.approx(
        expected, abs=1e-12
    )


def test_positions_reach_the_autopilot_and_then_its_origin(tmp_path: Path) -> None:
    cable = SerialCable(tmp_path / "hedge")
    cable.plug()
    beacons = PartSpec(
        "drivers.beacons.marvelmind:Marvelmind", {"ports": [str(cable.link)]}, "test.vision.beacons"
    )
    vision = VisionConfig(
        beacons, 5, lever_b_m=(0.0, 0.0, -0.05), x_heading_deg=90.0, zero_n_m=(10.0, 0.0, 0.0)
    )

    async def test() -> None:
        with px4() as bench:
            async with bench.vehicle(vision=vision, height_from="home"):
                stamp_ms = 1000
                while len(bench.wire.of("VISION_POSITION_ESTIMATE")) < 5 or not bench.wire.of(
                    "SET_GPS_GLOBAL_ORIGIN"
                ):
                    stamp_ms += 60
                    cable.send(
                        sent.quality(5, 90) + sent.position(stamp_ms, 5, (1.0, 2.0, 0.3), 20)
                    )
                    cable.send(sent.position(stamp_ms, 6, (9.0, 9.0, 9.0), 20))
                    await asyncio.sleep(0.06)
                before = len(bench.wire.of("VISION_POSITION_ESTIMATE"))
                cable.send(
                    sent.quality(5, 20) + sent.position(stamp_ms + 60, 5, (7.0, 7.0, 7.0), 20)
                )
                cable.send(
                    sent.quality(5, 90) + sent.position(stamp_ms + 120, 5, (1.0, 2.0, 0.3), 20)
                )
                await until(lambda: len(bench.wire.of("VISION_POSITION_ESTIMATE")) > before)
            estimates = bench.wire.of("VISION_POSITION_ESTIMATE")
            for estimate in estimates:  # neither the other drone's nor the poor one
                assert (estimate.x, estimate.y, estimate.z) == pytest.approx(
                    (12.0, 1.0, -0.25), abs=0.01
                )
                assert estimate.covariance[0] == estimate.covariance[6] == pytest.approx(0.0025)
            assert all(b.usec > a.usec for a, b in pairwise(estimates))
            origins = bench.wire.of("SET_GPS_GLOBAL_ORIGIN")
            assert len(origins) == 1
            assert estimates[-1].usec - estimates[0].usec > 3_000_000, (
                "the estimator had time to come to rest"
            )
            assert origins[0].latitude == round(ORIGIN.latitude_deg * 1e7)
            assert origins[0].altitude == 0

    run(test(), within_s=120.0)
    cable.unplug()


class Listed:
    """Beacons whose positions are at these instants of this computer's clock, ms."""

    def __init__(self, at_ms: list[int]) -> None:
        self._at_ms = at_ms

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    async def read(self, _timeout_s: float) -> BeaconFix | None:
        if not self._at_ms:
            return None
        return BeaconFix(0, 5, (0.0, 0.0, 0.0), 90.0, self._at_ms.pop(0) * 1_000_000)


def test_no_instant_is_told_twice_nor_after_a_later_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a late packet is followed by one in time: the beacons' clock is known better then."""
    listed = Listed([100, 160, 130, 160, 190])

    def created(*_: object) -> Listed:
        return listed

    monkeypatch.setattr(vision_module, "create", created)
    told: list[int] = []

    def send(_name: str, fields: dict[str, Any]) -> None:
        told.append(fields["usec"])

    def attitude_at(_now_ns: int) -> tuple[float, ...]:
        return 1.0, 0.0, 0.0, 0.0

    session: Any = SimpleNamespace(send=send)
    resting: Any = SimpleNamespace(
        health={}, velocity_n_mps=(0.0, 0.0, 0.0), attitude_at=attitude_at
    )
    context: Any = SimpleNamespace(origin=ORIGIN)
    feed = VisionFeed(VisionConfig(NOBODY, 5), context, session, resting)
    asyncio.run(feed.run())
    assert told == [100_000, 160_000, 190_000]
    assert feed.sent == 3


@pytest.mark.parametrize(
    ("kind", "altitude_mm"), [(PX4, 0), (ARDUPILOT, round(ORIGIN.altitude_m * 1e3))]
)
def test_a_px4s_origin_lies_at_sea_level(kind: AutopilotKind, altitude_mm: int) -> None:
    """As seen with PX4 1.17: after a gap of the beacons its height stood at minus the origin's
    altitude.
    """
    assert origin_fields(ORIGIN, kind)["altitude"] == altitude_mm


def test_a_px4_without_gps_cannot_fly_by_altitude() -> None:
    async def test() -> None:
        beacons = PartSpec(NOBODY.factory, {"ports": ["/dev/null"]}, "test")
        with px4() as bench, pytest.raises(VehicleError, match="no altitude"):
            async with bench.vehicle(vision=VisionConfig(beacons, 5)):
                pass

    run(test(), within_s=120.0)


def test_beacons_that_are_unplugged_in_the_air_are_named_and_the_vehicle_flies_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The script keeps its telemetry and its commands; what the autopilot does without beacons is
    its own.
    """
    cable = SerialCable(tmp_path / "hedge")
    cable.plug()
    options = {"ports": [str(cable.link)], "reopen_s": 0.3}
    vision = VisionConfig(
        PartSpec("drivers.beacons.marvelmind:Marvelmind", options, "test.vision.beacons"), 5
    )

    async def test() -> None:
        with px4(speed=3.0) as bench:
            async with bench.vehicle(vision=vision, height_from="home") as vehicle:
                await into_the_air(vehicle)
                cable.send(
                    bytes(range(200))
                    + sent.quality(5, 90)
                    + sent.position(60, 5, (1.0, 2.0, 0.3), 20)
                )
                await until(lambda: bool(bench.wire.of("VISION_POSITION_ESTIMATE")))
                cable.unplug()
                await until(lambda: "is gone for" in caplog.text)
                await vehicle.hold()
                await vehicle.land(LIMIT_S)
            assert bench.drone.on_ground

    run(test(), within_s=120.0)
