"""One short flight under a person's hands, in virtual time, and what was wrong with it.

A drone with its autopilot and radio (``hil``), a script (``missions.fly.leg``: take-off, control,
the way down) and its guard, on a course of a few seconds; no cameras, no link, no second drone.
Everything that script and guard send is written down with the hand that the vehicle was in when it
came.
"""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, cast

from drivers.interfaces import FlightMode, LinkCounters, Received
from drivers.rig.parts import Rig, part_context
from flight.config import Deadlines, MissionConfig
from flight.guard.under_guard import UnderGuard
from flight.guard.watch import GuardWatch, watch
from flight.guidance import Anchor
from flight.harness.flights import RoleResult
from flight.outcome import Outcome
from hil.autopilot.autopilot import Autopilot
from hil.harness.guard import MemoryBeatLine, SimGuard
from hil.harness.virtual_time import run_virtual
from hil.vehicle.sim_vehicle import SimVehicle, SimVehicleConfig
from hil.world.config import HomeConfig, WorldConfig
from hil.world.world import Fleet
from missions.fly.leg.course import fly_course
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, take_off
from missions.ground import rig_library
from path.geometry.rotation import yaw_of
from path.messages import Role
from tests.doubles import NoLog
from tests.pilots.acts import Act
from tests.pilots.watched import MOVING, NotedGuard, Watched, act_on, ends_badly, keep_looking

HEIGHT_M = 1.2
CONTROL_S = 4.0
# the world goes on for so long at most, until the drone is down or in a person's hands
AFTER_S = 30.0
LIMIT_S = 200.0
CONFIG = MissionConfig(deadlines=Deadlines(take_off_s=12.0, land_s=20.0, depart_s=4.0))
ROLE = Role.SENDER


@dataclass(slots=True)
class OneDrone:
    """``PartContext.harness`` of one drone, alone in its world."""

    fleet: Fleet
    noted: Watched
    seed: int = 1
    silent_vehicles: set[Role] = field(default_factory=set[Role])
    lost_vehicles: set[Role] = field(default_factory=set[Role])

    @property
    def world(self) -> Fleet:
        """The world at the loop's present."""
        now_s = asyncio.get_running_loop().time()
        if now_s != self.fleet.time_s:
            self.fleet.advance(now_s)
        return self.fleet


class NoLink:
    """Nobody is on the other side."""

    def __init__(self) -> None:
        self.counters = LinkCounters()

    def send(self, message: object) -> None: ...

    async def receive(self) -> Received:
        return await asyncio.get_running_loop().create_future()


@dataclass(frozen=True, slots=True)
class Flown:
    """How a flight ended.

    Attributes:
        wrong: what must not be, in words; empty when all was well.
        crossed: commands that went out before any heartbeat told of a takeover, and changed the
            mode once more: that person has to move the switch again.
    """

    outcome: str
    detail: str
    wrong: tuple[str, ...]
    seconds: float
    crossed: int = 0


@cache
def _rig() -> Rig:
    return rig_library.load("sim")


@cache
def _world() -> WorldConfig:
    plain = WorldConfig()
    return replace(plain, autopilot=replace(plain.autopilot, settle_s=0.3, land_disarm_s=0.5))


def fly(acts: tuple[Act, ...], seed: int = 1) -> Flown:
    """Fly one course under a person's hands."""
    return cast(Flown, run_virtual(_fly(acts, seed)))


async def _fly(acts: tuple[Act, ...], seed: int) -> Flown:
    fleet = Fleet(_world(), seed, {ROLE: HomeConfig()})
    autopilot = fleet.drone(ROLE).autopilot
    noted = Watched()
    noted.put_round(autopilot)
    harness = OneDrone(fleet, noted, seed)
    rig, loop = _rig(), asyncio.get_running_loop()
    context = part_context(rig, ROLE, cast(Any, harness))
    beats = MemoryBeatLine(context.clock)
    guard = NotedGuard(SimGuard.Config(), context)
    watching = GuardWatch(guard, beats, context.clock, CONFIG, cast(Any, NoLog()))
    vehicle = SimVehicle(SimVehicleConfig(), context)
    async with guard, vehicle:
        tasks = [
            asyncio.create_task(watch((watching,), asyncio.Event(), 0.05)),
            asyncio.create_task(keep_looking(ROLE, harness)),
            *(asyncio.create_task(act_on(act, ROLE, harness)) for act in acts),
        ]
        async with beats.role_end() as line:
            under = UnderGuard(line, context.clock, CONFIG.guard_process)
            parts = cast(Any, (context.clock, vehicle, object(), NoLink()))
            log, chance = cast(Any, NoLog()), random.Random(seed)
            session = RoleSession(
                rig, ROLE, CONFIG, log, lambda _: None, asyncio.Event(), parts, chance, under
            )
            try:
                async with asyncio.timeout(LIMIT_S):
                    result = await fly_course(
                        session, lambda: _course(session), lambda end: _recover(session, end)
                    )
            except TimeoutError:
                result = RoleResult(
                    ROLE, Outcome.HARNESS_FAILED, "the program did not end", False, False
                )
        end_s = loop.time() + AFTER_S
        while loop.time() < end_s and _nobodys(autopilot):  # noqa: ASYNC110 (polls the autopilot)
            await asyncio.sleep(0.5)
        wrong = [*noted.wrong[:3], *ends_badly(result, autopilot, noted)]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return Flown(result.outcome.label, result.detail, tuple(wrong), loop.time(), noted.crossed)


def _nobodys(autopilot: Autopilot) -> bool:
    """Armed, in the air, and in a mode that no person flies or stays in."""
    return autopilot.armed and (
        autopilot.mode in MOVING or autopilot.mode in (FlightMode.LAND, FlightMode.RETURN)
    )


async def _course(session: RoleSession) -> None:
    await session.vehicle.wait_armable(10.0)
    await take_off(session, HEIGHT_M)
    state = session.vehicle.state
    north, east, down = state.position_n_m
    session.pilot.guidance = Anchor((north + 1.0, east, down), yaw_of(state.q_n_b)).hold
    await asyncio.sleep(CONTROL_S)


async def _recover(session: RoleSession, end: Any) -> bool:
    state = session.vehicle.state
    return await bring_down(session, end, Anchor(state.position_n_m, yaw_of(state.q_n_b)))
