"""The contract of every Vehicle: PX4's MAVLink, a Tello's SDK, and both as the sim levels have
them.

The real drivers talk to their emulated far sides over sockets; the others fly in virtual time.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import pytest

from drivers.interfaces import (
    Capability,
    Clock,
    FlightMode,
    TakenOver,
    Vehicle,
    VehicleError,
    VelocitySetpoint,
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
from path.messages import Role
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, px4
from tests.drivers.tello import tello_stand
from tests.exact_world import QUICK
from tests.hil.vehicle.test_sim_vehicle import Harness
from tests.hil.vehicle.test_sim_vehicle import context as sim_context

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
HEIGHT_M = 0.9
PATIENCE_S = 60.0
LOST_S = 20.0  # any call's bound once the far side is gone; the machine may be busy
FRESH_NS = 1_000_000_000
Test = Callable[["Stage"], Awaitable[None]]


@dataclass
class Stage:
    """A vehicle, closed, and what is known of its far side.

    Attributes:
        clock: of the role.
        unplug: nothing passes any more, either way.
        heard: how many commands and setpoints have come to the far side.
        run: on a real or a virtual loop.
    """

    vehicle: Vehicle
    clock: Clock
    drone: Callable[[], SimDrone]
    unplug: Callable[[], object]
    heard: Callable[[], int]
    run: Callable[[Any], Any]

    @property
    def on_ground(self) -> bool:
        return self.drone().on_ground


@contextmanager
def sim(part: Callable[[PartContext], Vehicle]) -> Generator[Stage]:
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
    yield Stage(
        part(context),
        context.clock,
        lambda: harness.world.drone(Role.SENDER),
        lambda: harness.silent_vehicles.add(Role.SENDER),
        lambda: len(calls),
        run_virtual,
    )


def sim_vehicle() -> contextlib.AbstractContextManager[Stage]:
    return sim(lambda context: SimVehicle(SimVehicleConfig(), context))


def steady() -> contextlib.AbstractContextManager[Stage]:
    return sim(
        lambda context: SteadyVehicle(SimVehicle(SimVehicleConfig(), context), MissionConfig())
    )


def sim_tello() -> contextlib.AbstractContextManager[Stage]:
    return sim(lambda context: SimTello(SimTelloConfig(), context))


@contextmanager
def mavsdk() -> Generator[Stage]:
    with px4(replace(QUICK, offboard_loss_s=1.0), speed=3.0) as bench:
        yield Stage(
            bench.vehicle(),
            CONTEXT.clock,
            lambda: bench.drone,
            lambda: setattr(bench.endpoint, "silent", True),
            lambda: (
                len(bench.wire.of("COMMAND_LONG"))
                + len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED"))
            ),
            asyncio.run,
        )


@contextmanager
def tello() -> Generator[Stage]:
    with tello_stand.emulated(speed=4.0) as stand:
        context = tello_stand.context()
        yield Stage(
            TelloVehicle(TelloVehicleConfig(**stand.address), context),
            context.clock,
            lambda: stand.drone,
            lambda: setattr(stand.emulator, "silent", True),
            lambda: len(stand.heard),
            asyncio.run,
        )


VEHICLES = pytest.mark.parametrize("stage_of", [sim_vehicle, steady, sim_tello, mavsdk, tello])
StageOf = Callable[[], contextlib.AbstractContextManager[Stage]]


def on(stage_of: StageOf, test: Test) -> None:
    with stage_of() as stage:
        stage.run(test(stage))


async def until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            each()
            await asyncio.sleep(0.02)


async def up(vehicle: Vehicle) -> None:
    await vehicle.wait_armable(PATIENCE_S)
    await vehicle.arm()
    await vehicle.take_off(HEIGHT_M, PATIENCE_S)


def commands(vehicle: Vehicle) -> list[Callable[[], Awaitable[None]]]:
    return [
        lambda: vehicle.wait_armable(0.5),
        vehicle.arm,
        lambda: vehicle.take_off(HEIGHT_M, 0.5),
        lambda: vehicle.start_offboard(STILL),
        vehicle.hold,
        lambda: vehicle.land(0.5),
    ]


async def refuses_all(stage: Stage) -> None:
    """Every call is refused, says what to do, and sends nothing."""
    heard = stage.heard()
    for command in commands(stage.vehicle):
        with pytest.raises(VehicleError) as caught:
            await command()
        assert caught.value.remedy
    with pytest.raises(VehicleError) as caught:
        stage.vehicle.fly(STILL)
    assert caught.value.remedy
    await asyncio.sleep(0.1)  # what was sent would have come by now
    assert stage.heard() == heard


@VEHICLES
def test_before_it_is_open_everything_is_refused_and_nothing_sent(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        await refuses_all(stage)
        with pytest.raises(VehicleError):
            _ = stage.vehicle.state
        with pytest.raises(VehicleError):
            stage.vehicle.attitude_at(0)

    on(stage_of, test)


@VEHICLES
def test_state_stamps_never_go_back_and_are_of_the_role_s_clock(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        async with stage.vehicle as vehicle:
            await vehicle.wait_armable(PATIENCE_S)
            states, fresh = [vehicle.state], [0]

            def look() -> None:
                state = vehicle.state
                ages_ns = [
                    stage.clock.now_ns() - stamp_ns
                    for stamp_ns in (state.stamp_ns, state.heartbeat_ns)
                ]
                assert min(ages_ns) >= -20_000_000
                states.append(state)
                fresh[0] += max(ages_ns) < FRESH_NS  # older where this process stood still

            await until(
                lambda: len({state.stamp_ns for state in states}) > 4 and fresh[0] > 4, look
            )
            for earlier, later in pairwise(states):
                assert later.stamp_ns >= earlier.stamp_ns
                assert later.heartbeat_ns >= earlier.heartbeat_ns
            for state in states:
                assert math.hypot(*state.q_n_b) == pytest.approx(1.0, abs=1e-3)
                assert 0.0 <= state.battery <= 1.0
                assert (state.armed, state.in_air, state.armable) == (False, False, True)
            newest = vehicle.state
            assert vehicle.attitude_at(newest.stamp_ns + 10**9) == pytest.approx(
                newest.q_n_b, abs=0.05
            )

    on(stage_of, test)


@VEHICLES
def test_on_the_ground_what_makes_no_sense_is_refused_and_moves_nothing(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        async with stage.vehicle as vehicle:
            await vehicle.wait_armable(PATIENCE_S)
            with pytest.raises(VehicleError, match="not armed"):
                await vehicle.take_off(HEIGHT_M, 2.0)
            await vehicle.land(2.0)  # it is down
            with pytest.raises(VehicleError, match="not finite"):
                vehicle.fly(VelocitySetpoint((0.0, math.nan, 0.0), 0.0))
            with pytest.raises(VehicleError, match="not finite"):
                vehicle.fly(VelocitySetpoint((0.0, 0.0, 0.0), math.inf))
            await vehicle.arm()
            for height_m in (math.nan, 0.0, -1.0):
                with pytest.raises(VehicleError, match="height"):
                    await vehicle.take_off(height_m, 2.0)
            assert stage.on_ground

    on(stage_of, test)


@VEHICLES
def test_closing_is_quick_and_once_and_nothing_is_sent_after_it_and_it_opens_again(
    stage_of: StageOf,
) -> None:
    async def test(stage: Stage) -> None:
        loop = asyncio.get_running_loop()
        async with stage.vehicle as vehicle:
            assert not vehicle.state.armed
            start_s = loop.time()
        assert loop.time() - start_s < LOST_S
        await vehicle.__aexit__(None, None, None)
        await refuses_all(stage)
        async with stage.vehicle:
            stamp_ns = vehicle.state.stamp_ns
            await until(lambda: vehicle.state.stamp_ns > stamp_ns)

    on(stage_of, test)


@VEHICLES
def test_a_flight_shows_what_was_told_and_then_a_far_side_that_is_lost_ends_every_call(
    stage_of: StageOf,
) -> None:
    async def test(stage: Stage) -> None:
        loop = asyncio.get_running_loop()
        async with stage.vehicle as vehicle:
            await up(vehicle)
            state = vehicle.state
            assert (state.armed, state.in_air, state.mode) == (True, True, FlightMode.HOLD)
            assert not stage.on_ground
            await vehicle.start_offboard(STILL)
            assert vehicle.state.mode is FlightMode.OFFBOARD
            # far enough from its north, and to where its own axes are its start's
            await until(
                lambda: vehicle.state.velocity_n_mps[0] > 0.25,
                lambda: vehicle.fly(VelocitySetpoint((0.5, 0.0, 0.0), 0.0)),
            )
            says_where(vehicle)
            stage.unplug()
            for command in (
                vehicle.hold,
                lambda: vehicle.land(PATIENCE_S),
                lambda: vehicle.wait_armable(PATIENCE_S),
            ):
                start_s = loop.time()
                with pytest.raises(VehicleError) as caught:
                    await command()
                assert caught.value.remedy
                assert loop.time() - start_s < LOST_S
            # still answers, is not made to look younger, and nobody has seen it land
            await until(lambda: stage.clock.now_ns() - vehicle.state.heartbeat_ns > 1_500_000_000)
            await until(lambda: stage.clock.now_ns() - vehicle.state.stamp_ns > 1_500_000_000)
            assert vehicle.state.armed
            await until(lambda: stage.on_ground)  # by its own failsafe
            start_s = loop.time()
        assert loop.time() - start_s < LOST_S

    on(stage_of, test)


def says_where(vehicle: Vehicle) -> None:
    """A position that drifts comes with how far it may be off, any other without."""
    drifts = Capability.GLOBAL_POSITION in lacking(vehicle)
    sigma_m = vehicle.state.position_sigma_m
    assert (sigma_m is not None) == drifts
    assert sigma_m is None or sigma_m > 0.0


def needs_a_pilot(vehicle: Vehicle) -> None:
    if Capability.PILOT_OVERRIDE in lacking(vehicle):
        pytest.skip("nobody has a remote control for it")


@VEHICLES
def test_a_pilot_can_take_over_exactly_those_that_say_so(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        async with stage.vehicle as vehicle:
            await vehicle.wait_armable(PATIENCE_S)
            needs_a_pilot(vehicle)
            drone = stage.drone()
            drone.autopilot.request_mode(drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            await until(lambda: vehicle.state.mode is FlightMode.OTHER)

    on(stage_of, test)


@VEHICLES
def test_a_take_off_that_a_pilot_ends_says_whose_the_vehicle_is(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
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
