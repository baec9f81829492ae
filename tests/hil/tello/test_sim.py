"""A Tello's limits in virtual time: what it knows of itself, and what its camera shows."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise

import numpy as np
import pytest

from drivers.interfaces import Capability, VelocitySetpoint
from hil.camera.rendered import RenderedCameraConfig
from hil.harness.virtual_time import run_virtual
from hil.tello.sim import SimTello, SimTelloCamera, SimTelloConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role
from tests.hil.camera.test_rendered import StubHarness
from tests.hil.camera.test_rendered import context as camera_context
from tests.hil.vehicle.test_sim_vehicle import Harness, context

NORTH = VelocitySetpoint((0.5, 0.0, 0.0), 0.0)


def test_it_knows_of_itself_what_state_packets_say() -> None:
    async def main() -> None:
        harness = Harness(World(WorldConfig(), 1))
        drone = harness.truth.drone(Role.SENDER)
        async with SimTello(SimTelloConfig(north_m=0.0, east_m=0.0), context(harness)) as tello:
            await tello.wait_armable(10.0)
            await tello.arm()
            await tello.take_off(1.0, 20.0)
            await tello.start_offboard(NORTH)
            stamps: set[int] = set()
            for _ in range(100):
                tello.fly(NORTH)
                await asyncio.sleep(0.02)
                state = tello.state
                stamps.add(state.stamp_ns)
                w, x, y, z = state.q_n_b
                roll_deg = math.degrees(
                    math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
                )
                assert roll_deg == pytest.approx(round(roll_deg), abs=1e-6)
                climb_dmps = 10.0 * state.velocity_n_mps[2]
                assert climb_dmps == pytest.approx(round(climb_dmps), abs=1e-6)
            assert len(stamps) in (20, 21)
            assert tello.state.position_n_m == pytest.approx(drone.true_position_n_m, abs=0.25)
            assert tello.state.position_sigma_m is not None
            assert tello.state.position_sigma_m > 0.1
            assert tello.attitude_at(tello.state.stamp_ns) == tello.state.q_n_b

    run_virtual(main())


def test_its_camera_has_no_depth_and_went_through_a_codec() -> None:
    async def main() -> None:
        async with SimTelloCamera(
            RenderedCameraConfig(rate_hz=15.0), camera_context(StubHarness())
        ) as camera:
            frames = [await camera.read(1.0) for _ in range(4)]
        assert Capability.RANGE in camera.lacks
        assert all(frame.depth_mm is None for frame in frames)
        assert [b.frame_id - a.frame_id for a, b in pairwise(frames)] == [1, 1, 1]
        before, after = (frame.color.astype(float) for frame in frames[-2:])
        assert np.abs(after - before).max() > 20.0  # the car has moved

    run_virtual(main())
