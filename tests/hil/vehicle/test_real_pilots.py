"""A pilot's radio and the guard on each real autopilot whose simulator is named; skipped, with the
reason, without one.

What each order does, and how soon the companion's driver sees it, in OFFBOARD (GUIDED); a guard
whose script is dead, or climbs on, with a GPS altitude that is 10 m off. No cameras, one vehicle.
"""

from __future__ import annotations

import asyncio
import math
import os
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.interfaces import FlightMode, VehicleState, VelocitySetpoint
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Script
from drivers.mavlink.vehicle import MavsdkVehicle
from drivers.rig.parts import PartContext, Rig, create, part_context
from drivers.rig.tables import decode_table
from flight.config import GuardConfig, MissionConfig
from flight.guard.rules import GuardStage
from flight.guard.watch import GuardWatch, watch
from hil.autopilot.radio import STICKS_SLOT, Transmitter
from hil.autopilot.simulator import Kind
from hil.vehicle.simulators.followed_world import SimulatedVehicle, start_simulators
from hil.vehicle.simulators.process import BINARY_VARIABLE
from hil.world.config import PositionOffsetConfig, WorldConfig
from hil.world.dynamics import POSITION
from missions.fly.guard.command import as_flown, guard_of
from missions.ground import rig_library
from path.messages import Role
from tests.doubles import NoLog

LIMIT_S = 90.0
HEIGHT_M = 2.0
# ArduCopter counts a radio lost after 1 s
SEEN_WITHIN_S = {"mode": 0.5, "sticks": 0.5, "kill": 1.5, "lost": 1.7}
AFTER = {"mode": FlightMode.OTHER, "sticks": FlightMode.OTHER}
STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)

PATIENT: dict[Kind, dict[str, float]] = {"px4": {"COM_OF_LOSS_T": 5.0}, "ardupilot": {}}
"""Its own failsafe for setpoints waits, so that it is the guard that acts."""

CEILING_M = 3.5
OVER_M: dict[Kind, float] = {"px4": 2.0, "ardupilot": 1.0}
"""In truth over the ceiling at most: half a second of patience at 0.5 m/s, and PX4's error of
height, 1.7 m seen.
"""

CLIMB = VelocitySetpoint((0.0, 0.0, -0.5), 0.0)

Order = Callable[[Transmitter], None]


def by_mode(held: Transmitter) -> None:
    held.slot = STICKS_SLOT


def by_sticks(held: Transmitter) -> None:
    held.sticks = (0.0, -0.6, 0.0, 0.0)


def by_kill(held: Transmitter) -> None:
    held.kill = True


def by_loss(held: Transmitter) -> None:
    held.away_until_s = math.inf


ORDERS: dict[str, Order] = {"mode": by_mode, "sticks": by_sticks, "kill": by_kill, "lost": by_loss}


def named(kind: Kind) -> pytest.MarkDecorator:
    variable = BINARY_VARIABLE[kind]
    return pytest.mark.skipif(
        not os.environ.get(variable), reason=f"{variable} names no simulator of {kind}"
    )


KINDS = [pytest.param(kind, marks=named(kind)) for kind in BINARY_VARIABLE]


def field_rig(kind: Kind) -> Rig:
    return rig_library.load(f"sitl-{kind}-field")


@asynccontextmanager
async def offboard(
    kind: Kind,
    folder: Path,
    role: Role = Role.SENDER,
    before: Callable[[], Awaitable[None]] | None = None,
) -> AsyncGenerator[tuple[MavsdkVehicle, SimulatedVehicle]]:
    """One vehicle with the field rig's parameters, in the air under its companion; without the
    wrong height of D2.
    """
    rig = field_rig(kind)
    config = replace(
        decode_table(rig.world, WorldConfig, "world"), position_offset=PositionOffsetConfig()
    )
    simulator = config.simulator(role)
    assert simulator is not None
    patient = replace(simulator, parameters={**simulator.parameters, **PATIENT[kind]})
    simulated = SimulatedVehicle(rig, role, patient, config, folder)
    try:
        await start_simulators({role: simulated})
        spec = rig.role(role).vehicle
        parameters = {**spec.options["parameters"], **PATIENT[kind]}
        flown_with = replace(spec, options={**spec.options, "parameters": parameters})
        async with create(flown_with, part_context(rig, role)) as vehicle:
            pumping = asyncio.create_task(pump(simulated))
            try:
                await vehicle.wait_armable(LIMIT_S)
                if before is not None:
                    await before()
                await vehicle.arm()
                await vehicle.take_off(HEIGHT_M, LIMIT_S)
                await vehicle.start_offboard(STILL)
                await flown(vehicle, 2.0, lambda _: False)
                yield vehicle, simulated
            finally:
                pumping.cancel()
    finally:
        simulated.close()


async def pump(simulated: SimulatedVehicle) -> None:
    while True:
        simulated.pump(0.0)
        await asyncio.sleep(0.01)


async def flown(
    vehicle: MavsdkVehicle, seconds: float, until: Callable[[VehicleState], bool]
) -> float | None:
    """Setpoints at 20 Hz until something is seen: after how long, or None when it never was."""
    start_s = time.monotonic()
    while time.monotonic() - start_s < seconds:
        if until(vehicle.state):
            return time.monotonic() - start_s
        if vehicle.state.mode is FlightMode.OFFBOARD:
            vehicle.fly(STILL)
        await asyncio.sleep(0.02)
    return None


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_pilots_radio_wins(kind: Kind, order: str, tmp_path: Path) -> None:
    async def fly() -> None:
        async with offboard(kind, tmp_path) as (vehicle, simulated):
            assert simulated.radio is not None and vehicle.state.mode is FlightMode.OFFBOARD
            ORDERS[order](simulated.radio.transmitter)
            if kind == "ardupilot" and order == "sticks":
                assert (
                    await flown(vehicle, 3.0, lambda state: state.mode is not FlightMode.OFFBOARD)
                    is None
                )
                return  # in GUIDED it looks at no stick: docs/field.md
            seen_s = await flown(
                vehicle,
                5.0,
                lambda state: (
                    not state.armed if order == "kill" else state.mode is not FlightMode.OFFBOARD
                ),
            )
            print(f"\n{kind} {order}: seen after {seen_s} s")
            assert seen_s is not None and seen_s <= SEEN_WITHIN_S[order]
            if order in AFTER:
                assert vehicle.state.mode is AFTER[order]
            if order == "lost":  # it lands by itself
                await flown(vehicle, 40.0, lambda state: not state.armed)
                assert not vehicle.state.armed

    asyncio.run(fly())


class Beating:
    """The line of a program that lives and sends setpoints; or of one that is dead."""

    def __init__(self, context: PartContext) -> None:
        self.alive, self.beats, self.script = True, 0, Script.CLIMB
        self.ignored: dict[str, int] = {}
        self._context = context

    async def __aenter__(self) -> Beating:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def newest(self) -> tuple[int, Beat] | None:
        self.beats += 1
        return (self._context.clock.now_ns(), Beat(self.script, self.beats)) if self.alive else None

    def answer(self, answer: GuardAnswer) -> None: ...


@asynccontextmanager
async def guarded(
    kind: Kind, folder: Path, role: Role = Role.SENDER
) -> AsyncGenerator[tuple[MavsdkVehicle, SimulatedVehicle, GuardWatch, Beating]]:
    """As ``offboard``, with a guard on a link of its own from before the flight, and a ceiling of
    CEILING_M.
    """
    async with AsyncExitStack() as stack:
        guards: list[tuple[GuardWatch, Beating]] = []

        async def begin() -> None:
            rig = field_rig(kind)
            context = part_context(rig, role)
            line, ended = Beating(context), asyncio.Event()
            mission = MissionConfig(guard=GuardConfig(fence_height_m=CEILING_M))
            link = await stack.enter_async_context(
                create(as_flown(rig, role, guard_of(rig, role)), context)
            )
            guard = GuardWatch(link, line, context.clock, mission, NoLog())
            stack.callback(asyncio.create_task(watch((guard,), ended)).cancel)
            stack.callback(ended.set)
            await asyncio.sleep(1.0)  # what it stands on has been seen
            guards.append((guard, line))

        vehicle, simulated = await stack.enter_async_context(offboard(kind, folder, role, begin))
        guard, line = guards[0]
        line.script = Script.CONTROL
        await flown(vehicle, 1.0, lambda _: False)
        assert guard.state.stage is GuardStage.WATCHING, (
            f"{guard.state.reason}; in truth {height_m(simulated):.1f} m"
        )
        yield vehicle, simulated, guard, line


def height_m(simulated: SimulatedVehicle) -> float:
    """Above the ground, in truth."""
    return -float(simulated.follower.row(time.monotonic())[POSITION][2]) - 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_the_guard_holds_and_lands_a_dead_scripts_vehicle(kind: Kind, tmp_path: Path) -> None:
    async def fly() -> None:
        async with guarded(kind, tmp_path) as (vehicle, _, guard, line):
            line.alive, start_s = False, time.monotonic()
            held_s, down_s, reason = math.inf, math.inf, ""
            while time.monotonic() - start_s < 40.0 and math.isinf(down_s):
                if math.isinf(held_s) and vehicle.state.mode is not FlightMode.OFFBOARD:
                    held_s = time.monotonic() - start_s
                reason = guard.state.reason or reason  # forgotten once it is disarmed
                if not vehicle.state.armed:
                    down_s = time.monotonic() - start_s
                await asyncio.sleep(0.01)
            assert "no sign of life" in reason
            print(f"\n{kind}: held {held_s:.2f} s, down {down_s:.2f} s")
            assert held_s < 1.0 and math.isfinite(down_s)

    asyncio.run(fly())


@pytest.mark.parametrize("kind", KINDS)
def test_a_guard_that_has_the_vehicle_gives_it_to_the_pilot(kind: Kind, tmp_path: Path) -> None:
    async def fly() -> None:
        async with guarded(kind, tmp_path) as (vehicle, simulated, guard, line):
            assert simulated.radio is not None
            line.alive = False
            await flown(vehicle, 3.0, lambda state: state.mode is FlightMode.HOLD)
            assert guard.state.stage is GuardStage.HOLDING
            by_mode(simulated.radio.transmitter)
            await flown(vehicle, 1.0, lambda state: state.mode is FlightMode.OTHER)
            await flown(vehicle, 5.0, lambda _: False)  # it would have landed it after 2 s
            assert vehicle.state.armed and vehicle.state.mode is FlightMode.OTHER
            assert guard.state.stage is GuardStage.LET_GO

    asyncio.run(fly())


@pytest.mark.parametrize("role", list(Role))
@pytest.mark.parametrize("kind", KINDS)
def test_the_ceiling_is_kept_in_truth_with_ten_metres_of_gps_altitude(
    kind: Kind, role: Role, tmp_path: Path
) -> None:
    """D1's says 10 m too much, D2's 10 m too little; the script climbs on and looks at no limit."""

    async def fly() -> None:
        async with guarded(kind, tmp_path, role) as (vehicle, simulated, guard, _):
            assert height_m(simulated) == pytest.approx(HEIGHT_M, abs=0.7)
            highest_m, start_s = 0.0, time.monotonic()
            while guard.state.stage is GuardStage.WATCHING and time.monotonic() - start_s < 20.0:
                vehicle.fly(CLIMB)
                highest_m = max(highest_m, height_m(simulated))
                await asyncio.sleep(0.05)
            assert "outside the fence" in guard.state.reason
            await flown(vehicle, 40.0, lambda state: not state.armed)
            print(f"\n{kind} {role.value}: highest {highest_m:.2f} m")
            assert CEILING_M - 0.7 < highest_m < CEILING_M + OVER_M[kind]
            assert not vehicle.state.armed

    asyncio.run(fly())
