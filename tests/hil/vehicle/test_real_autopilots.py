"""A short flight on each real autopilot whose simulator is named; skipped, with the reason, where
none is.
"""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

import pytest

from drivers.interfaces import FlightMode, VelocitySetpoint
from drivers.mavlink.vehicle import MavsdkVehicle
from drivers.rig.parts import create, part_context
from drivers.rig.tables import decode_table
from hil.autopilot.simulator import Kind
from hil.vehicle.simulators.followed_world import SimulatedVehicle, start_simulators
from hil.vehicle.simulators.process import BINARY_VARIABLE
from hil.world.config import WorldConfig
from hil.world.dynamics import POSITION
from missions.ground import rig_library
from path.messages import Role

HEIGHT_M = 1.5
LIMIT_S = 90.0


def named(kind: Kind) -> pytest.MarkDecorator:
    variable = BINARY_VARIABLE[kind]
    return pytest.mark.skipif(
        not os.environ.get(variable), reason=f"{variable} names no simulator of {kind}"
    )


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=named(kind)) for kind in BINARY_VARIABLE]
)
def test_it_takes_off_flies_north_and_lands(kind: Kind, tmp_path: Path) -> None:
    rig = rig_library.load(f"sitl-{kind}")
    config = decode_table(rig.world, WorldConfig, "world")
    simulator = config.sender_simulator
    assert simulator is not None

    async def fly() -> None:
        simulated = SimulatedVehicle(rig, Role.SENDER, simulator, config, tmp_path)
        try:
            await start_simulators({Role.SENDER: simulated})
            async with create(rig.sender.vehicle, part_context(rig, Role.SENDER)) as vehicle:
                await flight(vehicle, simulated)
        finally:
            simulated.close()

    asyncio.run(fly())


async def flight(vehicle: MavsdkVehicle, simulated: SimulatedVehicle) -> None:
    def truth() -> list[float]:
        simulated.pump(0.0)
        return simulated.follower.row(time.monotonic())[POSITION].tolist()

    ground_m = -truth()[2]
    await vehicle.wait_armable(LIMIT_S)
    await vehicle.arm()
    await vehicle.take_off(HEIGHT_M, LIMIT_S)
    # PX4's height is its first GPS sample's
    assert -truth()[2] - ground_m == pytest.approx(HEIGHT_M, abs=1.2)
    north = VelocitySetpoint((0.8, 0.0, 0.0), 0.0)
    await vehicle.start_offboard(north)
    start_n_m = truth()[0]
    async with asyncio.timeout(LIMIT_S):
        while truth()[0] < start_n_m + 2.0:
            vehicle.fly(north)
            await asyncio.sleep(0.05)
    assert vehicle.state.mode is FlightMode.OFFBOARD
    await vehicle.hold()
    await vehicle.land(LIMIT_S)
    assert -truth()[2] == pytest.approx(ground_m, abs=0.1)
    assert simulated.relay is not None
    assert len(simulated.relay.watch.offboard_sessions) == 1
