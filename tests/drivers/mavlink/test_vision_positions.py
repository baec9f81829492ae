"""A beacon's place as an autopilot is told it: in which frame, how sure, and when its origin
follows.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import BeaconFix
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.vehicle_config import VisionConfig
from drivers.mavlink.vision import VisionFeed, beacon_in_n, origin_fields
from drivers.rig.parts import Origin
from path.geometry.rotation import R_from_rpy, quat_from_rpy

S = 1_000_000_000
ORIGIN = Origin(47.4, 8.5, 488.0)
CONFIG = VisionConfig(
    beacons=cast(Any, None), address=5, lever_b_m=(0.1, -0.2, 0.05), x_heading_deg=30.0, zero_n_m=(10.0, -4.0, -1.0),
    sigma_m=0.04, least_quality=60.0,
)  # fmt: skip
FIX = BeaconFix(stamp_ns=1, address=5, position_m=(2.0, 3.0, 1.5), quality=90.0, host_ns=7 * S)


class Feed:
    """A feed whose beacons, session and telemetry stand in."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, config: VisionConfig = CONFIG) -> None:
        def create(*_: object) -> None: ...

        monkeypatch.setattr("drivers.mavlink.vision.create", create)
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.rpy = (0.1, -0.2, 0.7)
        self.telemetry: Any = SimpleNamespace(
            kind=PX4,
            health={"is_local_position_ok": True},
            velocity_n_mps=(0.0, 0.0, 0.0),
            attitude_at=self._attitude,
        )

        def send(name: str, fields: dict[str, Any]) -> None:
            self.sent.append((name, fields))

        parts: Any = (
            config,
            SimpleNamespace(origin=ORIGIN),
            SimpleNamespace(send=send),
            self.telemetry,
        )
        self.feed: Any = VisionFeed(*parts)

    def _attitude(self, stamp_ns: int) -> tuple[float, float, float, float]:
        assert stamp_ns % S == 0 or stamp_ns > 0
        return quat_from_rpy(*self.rpy)

    def origins(self) -> list[dict[str, Any]]:
        return [fields for name, fields in self.sent if name == "SET_GPS_GLOBAL_ORIGIN"]


@pytest.mark.parametrize(
    ("heading_deg", "place_n_m"),
    [
        (0.0, (12.0, -7.0, -2.5)),  # x north, y west, z up
        (90.0, (13.0, -2.0, -2.5)),
        (180.0, (8.0, -1.0, -2.5)),
    ],
)
def test_a_beacon_s_place_is_turned_and_shifted_into_the_mission_s_frame(
    heading_deg: float, place_n_m: tuple[float, float, float]
) -> None:
    found = beacon_in_n(FIX.position_m, replace(CONFIG, x_heading_deg=heading_deg))
    assert found == pytest.approx(place_n_m)


def test_the_autopilot_is_told_its_body_s_place_and_how_sure_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = Feed(monkeypatch)
    feed.feed._take(FIX)
    ((name, told),) = feed.sent
    assert (
        name == "VISION_POSITION_ESTIMATE"
        and told["usec"] == 7_000_000
        and told["reset_counter"] == 0
    )
    body = np.array(beacon_in_n(FIX.position_m, CONFIG)) - R_from_rpy(*feed.rpy) @ CONFIG.lever_b_m
    assert (told["x"], told["y"], told["z"]) == pytest.approx(tuple(body.tolist()))
    assert (told["roll"], told["pitch"], told["yaw"]) == pytest.approx(feed.rpy)
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = told["covariance"]
    assert np.diag(covariance) == pytest.approx([0.04**2] * 3 + [math.pi**2] * 3)
    assert np.count_nonzero(covariance) == 6 and feed.feed.sent == 1


@pytest.mark.parametrize(
    ("changes", "passed"),
    [
        ({}, 1),
        ({"address": 4}, 0),
        ({"quality": 60.0}, 1),
        ({"quality": 59.9}, 0),
        ({"host_ns": None}, 0),
    ],
)
def test_only_this_drone_s_beacon_is_passed_on_when_it_is_good_enough_and_its_time_is_known(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], passed: int
) -> None:
    feed = Feed(monkeypatch)
    feed.feed._take(replace(FIX, **changes))
    assert len(feed.sent) == feed.feed.sent == passed


def test_the_origin_is_told_once_after_the_estimator_has_stood_still_for_three_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = Feed(monkeypatch)

    def take(at_ns: int) -> int:
        feed.feed._take(replace(FIX, host_ns=at_ns))
        return len(feed.origins())

    assert take(10 * S) == take(12 * S) == 0
    feed.telemetry.velocity_n_mps = (0.0, 0.2, 0.0)  # it moves: from the beginning again
    assert take(13 * S) == 0 and not feed.feed.origin_sent
    feed.telemetry.velocity_n_mps = (0.0, 0.19, 0.0)
    assert take(14 * S) == 0
    assert take(17 * S - 1) == 0
    assert take(17 * S) == 1 and feed.feed.origin_sent
    assert take(30 * S) == 1
    assert feed.feed.sent == 7


def test_an_estimator_without_a_local_position_does_not_stand_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = Feed(monkeypatch)
    for health in ({}, {"is_local_position_ok": False}):
        feed.telemetry.health = health
        for second in range(10):
            feed.feed._take(replace(FIX, host_ns=(20 + second) * S))
    assert feed.origins() == []


@pytest.mark.parametrize(("kind", "altitude_mm"), [(PX4, 0), (ARDUPILOT, 488_000), (None, 488_000)])
def test_the_origin_s_altitude_is_told_to_an_ardupilot_and_not_to_a_px4(
    kind: Any, altitude_mm: int
) -> None:
    assert origin_fields(ORIGIN, kind) == {
        "latitude": 474_000_000, "longitude": 85_000_000, "altitude": altitude_mm, "time_usec": 0
    }  # fmt: skip
