"""Beacons that stand in for GPS: each drone hears its own, in the frame that the rig says it is."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.mavlink.vision import VisionConfig, beacon_in_n
from drivers.rig.parts import PartSpec, Rig
from drivers.rig.tables import RigError, decode_table
from hil.beacons.pty import PtyHedge, frame_of, open_hedges
from hil.camera.shared import RUN_VARIABLE
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.ground import rig_library
from path.geometry.rotation import R_from_rpy
from path.messages import Role
from tests.drivers.link.link_ends import Context, WallClock, run

NOBODY = PartSpec("drivers.beacons.marvelmind:Marvelmind", {}, "test")
ZERO_N_M = (1.0, 2.0, -0.5)
LEVER_B_M = (0.0, 0.0, -0.05)


@pytest.mark.parametrize("x_heading_deg", [0.0, 90.0, 211.0])
def test_the_made_up_frame_is_the_one_that_the_driver_undoes(x_heading_deg: float) -> None:
    yaw_rad, origin_m = frame_of(x_heading_deg, ZERO_N_M)
    east, north, up = 3.0, -4.0, 1.5
    x, y, z = (R_from_rpy(0.0, 0.0, yaw_rad) @ (east, north, up) + origin_m).tolist()
    config = VisionConfig(NOBODY, 5, x_heading_deg=x_heading_deg, zero_n_m=ZERO_N_M)
    assert beacon_in_n((x, y, z), config) == pytest.approx((north, east, -up), abs=1e-9)


def rig_of(*headings_deg: float) -> Rig:
    rig = rig_library.load("sitl")
    sides: dict[str, Any] = {}
    for role, address, heading_deg in zip(Role, (5, 6), headings_deg, strict=True):
        own = rig.role(role)
        vision = {
            "address": address,
            "lever_b_m": list(LEVER_B_M),
            "x_heading_deg": heading_deg,
            "zero_n_m": list(ZERO_N_M),
            "beacons": {"factory": "hil.beacons.pty:PtyHedge"},
        }
        sides[role.value] = replace(
            own, vehicle=replace(own.vehicle, options={**own.vehicle.options, "vision": vision})
        )
    return replace(rig, **sides)


@pytest.mark.parametrize("role", list(Role))
def test_each_drone_hears_where_it_is(role: Role, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RUN_VARIABLE, f"hedges-{role.value}-{time.monotonic_ns()}")
    rig, start_s = rig_of(40.0, 40.0), time.monotonic()
    snapshot = World(decode_table(rig.world, WorldConfig, "world"), 0).snapshot()
    context: Any = Context(role, WallClock())

    async def test() -> None:
        with open_hedges(rig, 3, lambda: time.monotonic() - start_s, lambda: snapshot):
            async with PtyHedge(PtyHedge.Config(), context) as hedge:
                fixes = [await hedge.read(60.0) for _ in range(9)]
        vision = VisionConfig(NOBODY, 5, x_heading_deg=40.0, zero_n_m=ZERO_N_M)
        places = np.array([beacon_in_n(fix.position_m, vision) for fix in fixes])
        assert {fix.address for fix in fixes} == {5 if role is Role.SENDER else 6}
        east, north, up = snapshot.drones[role].T_w_b.apply(np.array(LEVER_B_M)).tolist()
        assert np.median(places, axis=0) == pytest.approx((north, east, -up), abs=0.06)

    run(test(), within_s=120.0)


def test_drones_in_different_frames_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RUN_VARIABLE, "hedges-refused")
    with (
        pytest.raises(RigError, match="differ"),
        open_hedges(rig_of(0.0, 90.0), 0, time.monotonic, None),  # type: ignore[arg-type]
    ):
        pass
