"""The contract of every Vehicle: PX4's MAVLink, a Tello's SDK, and both as the sim levels have
them.

The real drivers talk to their emulated far sides over sockets; the others fly in virtual time.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import pytest

from drivers.interfaces import (
    Capability,
    FlightMode,
    TakenOver,
    Vehicle,
    lacking,
)
from drivers.rig.parts import PartContext
from drivers.tello.config import TelloVehicleConfig
from drivers.tello.vehicle import TelloVehicle
from flight.config import MissionConfig
from flight.steady_vehicle import SteadyVehicle
from hil.harness.virtual_time import run_virtual
from hil.tello.sim import SimTello, SimTelloConfig
from hil.vehicle.sim_vehicle import SimVehicle, SimVehicleConfig
from hil.world.config import WorldConfig
from hil.world.world import SimDrone, World
from missions.fly.testing.vehicle import PATIENCE_S, Stage, VehicleContract, until
from path.messages import Role
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, px4
from tests.drivers.tello import tello_stand
from tests.exact_world import QUICK
from tests.hil.vehicle.test_sim_vehicle import Harness
from tests.hil.vehicle.test_sim_vehicle import context as sim_context

Test = Callable[["Flown"], Awaitable[None]]


@dataclass
class Flown(Stage):
    """With the drone itself, which a pilot can take."""

    drone: Callable[[], SimDrone]


@contextmanager
def sim(part: Callable[[PartContext], Vehicle]) -> Generator[Flown]:
    harness = Harness(World(WorldConfig(), 1))
    context = sim_context(harness)
    drone = harness.truth.drone(Role.SENDER)
    calls: list[str] = []

    def counted(name: str) -> None:
        told = getattr(drone.autopilot, name)

        def tell(*arguments: Any, **named: Any) -> Any:
            calls.append(name)
            return told(*arguments, **named)

        setattr(drone.autopilot, name, tell)

    for name in ("setpoint", "request_arm", "request_takeoff", "request_mode"):
        counted(name)
    yield Flown(
        part(context),
        context.clock,
        lambda: harness.world.drone(Role.SENDER).on_ground,
        lambda: harness.silent_vehicles.add(Role.SENDER),
        lambda: len(calls),
        run_virtual,
        lambda: harness.world.drone(Role.SENDER),
    )


def sim_vehicle() -> contextlib.AbstractContextManager[Flown]:
    return sim(lambda context: SimVehicle(SimVehicleConfig(), context))


def steady() -> contextlib.AbstractContextManager[Flown]:
    return sim(
        lambda context: SteadyVehicle(SimVehicle(SimVehicleConfig(), context), MissionConfig())
    )


def sim_tello() -> contextlib.AbstractContextManager[Flown]:
    return sim(lambda context: SimTello(SimTelloConfig(), context))


@contextmanager
def mavsdk() -> Generator[Flown]:
    with px4(replace(QUICK, offboard_loss_s=1.0), speed=3.0) as bench:
        yield Flown(
            bench.vehicle(),
            CONTEXT.clock,
            lambda: bench.drone.on_ground,
            lambda: setattr(bench.endpoint, "silent", True),
            lambda: (
                len(bench.wire.of("COMMAND_LONG"))
                + len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED"))
            ),
            asyncio.run,
            lambda: bench.drone,
        )


@contextmanager
def tello() -> Generator[Flown]:
    with tello_stand.emulated(speed=4.0) as stand:
        context = tello_stand.context()
        yield Flown(
            TelloVehicle(TelloVehicleConfig(**stand.address), context),
            context.clock,
            lambda: stand.drone.on_ground,
            lambda: setattr(stand.emulator, "silent", True),
            lambda: len(stand.heard),
            asyncio.run,
            lambda: stand.drone,
        )


class TestSimVehicle(VehicleContract):
    def stage(self) -> contextlib.AbstractContextManager[Flown]:
        return sim_vehicle()


class TestSteadyVehicle(VehicleContract):
    def stage(self) -> contextlib.AbstractContextManager[Flown]:
        return steady()


class TestSimTello(VehicleContract):
    def stage(self) -> contextlib.AbstractContextManager[Flown]:
        return sim_tello()


class TestMavsdk(VehicleContract):
    def stage(self) -> contextlib.AbstractContextManager[Flown]:
        return mavsdk()


class TestTello(VehicleContract):
    def stage(self) -> contextlib.AbstractContextManager[Flown]:
        return tello()


VEHICLES = pytest.mark.parametrize("stage_of", [sim_vehicle, steady, sim_tello, mavsdk, tello])
StageOf = Callable[[], contextlib.AbstractContextManager[Flown]]


def on(stage_of: StageOf, test: Test) -> None:
    with stage_of() as stage:
        stage.run(test(stage))


def needs_a_pilot(vehicle: Vehicle) -> None:
    if Capability.PILOT_OVERRIDE in lacking(vehicle):
        pytest.skip("nobody has a remote control for it")


@VEHICLES
def test_a_pilot_can_take_over_exactly_those_that_say_so(stage_of: StageOf) -> None:
    async def test(stage: Flown) -> None:
        async with stage.vehicle as vehicle:
            await vehicle.wait_armable(PATIENCE_S)
            needs_a_pilot(vehicle)
            drone = stage.drone()
            drone.autopilot.request_mode(drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            await until(lambda: vehicle.state.mode is FlightMode.OTHER)

    on(stage_of, test)


@VEHICLES
def test_a_take_off_that_a_pilot_ends_says_whose_the_vehicle_is(stage_of: StageOf) -> None:
    async def test(stage: Flown) -> None:
        async with stage.vehicle as vehicle:
            await vehicle.wait_armable(PATIENCE_S)
            needs_a_pilot(vehicle)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(3.0, PATIENCE_S))
            drone = stage.drone()
            await until(lambda: not drone.autopilot.landed)
            drone.autopilot.request_mode(drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            with pytest.raises(TakenOver, match="mode other"):
                await climb

    on(stage_of, test)
