"""One short flight under a person's hands, in virtual time, and what was wrong with it.

A drone with its autopilot and radio (``hil``), a script (``missions.fly.leg``: take-off, control,
the way down) and its guard, on a course of a few seconds; no cameras, no link, no second drone.
Everything that script and guard send is written down with the hand that the vehicle was in when it
came.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
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
from hil.harness.guard import MemoryBeatLine, SimGuard, SimGuardConfig
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
from tests.pilots.acts import Act, begin, undo

HEIGHT_M = 1.2
CONTROL_S = 4.0
NOTICED_S = 1.0  # mode and arming come with heartbeats, and one message's word is doubted for 0.3 s
# in a mode that only scripts fly: from then on the guard may take what was let go of
NOBODYS_S = 1.0
# the world goes on for so long at most, until the drone is down or in a person's hands
AFTER_S = 30.0
LIMIT_S = 200.0
UNSEEN_S = 0.25  # what a person does and undoes between two heartbeats is not told by any of them
# of the height at which a take-off is over, and what it climbs on while it brakes
TOLERANCE_M = 0.75
MOVING = (FlightMode.OFFBOARD, FlightMode.TAKEOFF)
CONFIG = MissionConfig(deadlines=Deadlines(take_off_s=12.0, land_s=20.0, depart_s=4.0))
ROLE = Role.SENDER


@dataclass(frozen=True, slots=True)
class Order:
    """Something that reached the autopilot. ``who``: script, guard or person."""

    at_s: float
    who: str
    what: str


@dataclass(slots=True)
class Watched:
    """The history of one autopilot, kept by what is put round its methods.

    Attributes:
        orders: of script and guard.
        theirs_s: since when a person, or the autopilot for want of a radio, has the vehicle; None:
            nobody has.
        modes: (time, mode, whose doing).
    """

    orders: list[Order] = field(default_factory=list[Order])
    wrong: list[str] = field(default_factory=list[str])
    modes: list[tuple[float, FlightMode, str]] = field(
        default_factory=list[tuple[float, FlightMode, str]]
    )
    theirs_s: float | None = None
    by_failsafe: bool = False
    climbing: bool = False
    killed_s: float | None = None
    crossed: int = 0
    # motors were stopped, however shortly: the person who did it is at the sticks
    touched: bool = False
    hand: str = "script"
    cause: str = "itself"

    def put_round(self, autopilot: Autopilot) -> None:
        """Note everything that is asked of an autopilot, and every mode that it enters."""
        own: Any = autopilot
        for name in ("request_arm", "request_takeoff", "request_mode", "setpoint"):
            setattr(own, name, self._noted(autopilot, name, getattr(own, name)))
        enter = own._enter

        def entered(now_s: float, mode: FlightMode) -> None:
            before = autopilot.mode
            self.modes.append((now_s, mode, self.cause))
            if autopilot.armed and self.cause == "person" and mode is not before:
                self._given(autopilot, now_s, mode)
            enter(now_s, mode)

        own._enter = entered

    def _noted(
        self, autopilot: Autopilot, name: str, call: Callable[..., Any]
    ) -> Callable[..., Any]:
        def noted(now_s: float, *args: Any, **options: Any) -> Any:
            if self.cause != "itself":  # a request within a request
                return call(now_s, *args, **options)
            person = self.hand == "person" or options.get("by_pilot", False)
            if not person:
                self._order(autopilot, now_s, name, args)
            self.cause = "person" if person else self.hand
            try:
                return call(now_s, *args, **options)
            finally:
                self.cause = "itself"

        return noted

    def _order(self, autopilot: Autopilot, now_s: float, name: str, args: tuple[Any, ...]) -> None:
        what = (
            name
            if name == "setpoint"
            else f"{name}{tuple(getattr(each, 'value', each) for each in args)}"
        )
        if name != "setpoint":
            self.orders.append(Order(now_s, self.hand, what))
        if name == "request_takeoff" or (name == "request_mode" and args[0] is FlightMode.OFFBOARD):
            self.climbing = name == "request_takeoff"
        just_now = self.theirs_s is not None and now_s - self.theirs_s < UNSEEN_S
        if just_now and name in ("request_takeoff", "request_mode") and not autopilot.killed:
            # no heartbeat has told of it yet: the person's wish and the script's have crossed
            self.theirs_s = None
            self.crossed += 1
        if self.theirs_s is None or now_s - self.theirs_s <= NOTICED_S:
            return
        if self.by_failsafe and name == "request_mode" and args[0] is FlightMode.LAND:
            return  # as the failsafe itself is about to
        nobodys = (
            self.hand == "guard"
            and autopilot.mode in MOVING
            and now_s - self.modes[-1][0] > NOBODYS_S
        )
        if not nobodys:
            since_s = now_s - self.theirs_s
            self.wrong.append(
                f"{now_s:.2f} s: the {self.hand} sent {what}, {since_s:.1f} s after a person took over"
            )

    def look(self, autopilot: Autopilot, now_s: float) -> None:
        """Look at what needs no request: motors stopped, the autopilot's own hold without a radio,
        the end.
        """
        self.touched = self.touched or autopilot.killed
        if not autopilot.killed:
            self.killed_s = None
        elif self.killed_s is None:
            self.killed_s = now_s
        if not autopilot.armed:
            self.theirs_s, self.by_failsafe = None, False
        elif self.killed_s is not None and now_s - self.killed_s > UNSEEN_S:
            self._taken(now_s)
        elif autopilot.failsafe == "radio lost" and self.theirs_s is None:
            self._taken(now_s)
            self.by_failsafe = True
        elif self.by_failsafe and autopilot.failsafe != "radio lost":
            self.theirs_s, self.by_failsafe = None, False  # the radio is back, and the hold is over

    @property
    def has_a_person(self) -> bool:
        """Whether a person took it, or was about to."""
        return self.theirs_s is not None or self.touched

    def _given(self, autopilot: Autopilot, now_s: float, mode: FlightMode) -> None:
        """Take a change of mode by a person.

        One into a mode that scripts fly gives the vehicle to them. A hold where a take-off ends is
        what the take-off would have ended in: no telemetry tells them apart.
        """
        self.touched = True
        home_n_m = autopilot.home_n_m
        height_m = 0.0 if home_n_m is None else home_n_m[2] - autopilot._estimate.position_n_m[2]
        ends_so = (
            self.climbing and mode is FlightMode.HOLD and abs(height_m - HEIGHT_M) < TOLERANCE_M
        )
        if mode in MOVING or ends_so:
            self.theirs_s, self.by_failsafe = None, False
        else:
            self._taken(now_s)
            self.by_failsafe = False

    def _taken(self, now_s: float) -> None:
        if self.theirs_s is None:
            self.theirs_s = now_s


@dataclass(slots=True)
class OneDrone:
    """``PartContext.harness`` of one drone, alone in its world."""

    fleet: Fleet[Role]
    seed: int = 1
    silent_vehicles: set[Role] = field(default_factory=set[Role])
    lost_vehicles: set[Role] = field(default_factory=set[Role])

    @property
    def world(self) -> Fleet[Role]:
        """The world at the loop's present."""
        now_s = asyncio.get_running_loop().time()
        if now_s != self.fleet.time_s:
            self.fleet.advance(now_s)
        return self.fleet


class NotedGuard(SimGuard):
    """The guard's vehicle, whose commands are known as the guard's."""

    noted: Watched

    def _request(self, mode: FlightMode) -> None:
        before, self.noted.hand = self.noted.hand, "guard"
        try:
            super()._request(mode)
        finally:
            self.noted.hand = before


class NoLink:
    """Nobody is on the other side."""

    def __init__(self) -> None:
        self.counters = LinkCounters()

    def send(self, message: object) -> None: ...

    async def receive(self) -> Received:
        return await asyncio.get_running_loop().create_future()


class NoLog:
    """Nothing is kept."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...


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
    fleet = Fleet(_world(), seed, {ROLE: HomeConfig()}, {})
    harness = OneDrone(fleet, seed)
    autopilot = fleet.drone(ROLE).autopilot
    noted = Watched()
    noted.put_round(autopilot)
    rig, loop = _rig(), asyncio.get_running_loop()
    context = part_context(rig, ROLE, cast(Any, harness))
    beats = MemoryBeatLine(context.clock)
    guard = NotedGuard(SimGuardConfig(), context)
    guard.noted = noted
    watching = GuardWatch(guard, beats, context.clock, CONFIG, cast(Any, NoLog()))
    vehicle = SimVehicle(SimVehicleConfig(), context)
    async with guard, vehicle:
        tasks = [
            asyncio.create_task(watch((watching,), asyncio.Event(), 0.05)),
            asyncio.create_task(_looks(harness, noted)),
            *(asyncio.create_task(_person(act, harness, noted)) for act in acts),
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
        wrong = [*noted.wrong[:3], *_ends_badly(result, autopilot, noted)]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return Flown(result.outcome.label, result.detail, tuple(wrong), loop.time(), noted.crossed)


def _nobodys(autopilot: Autopilot) -> bool:
    """Armed, in the air, and in a mode that no person flies or stays in."""
    return autopilot.armed and (
        autopilot.mode in MOVING or autopilot.mode in (FlightMode.LAND, FlightMode.RETURN)
    )


def _ends_badly(result: RoleResult, autopilot: Autopilot, noted: Watched) -> list[str]:
    wrong: list[str] = []
    if result.outcome in (Outcome.CRASHED, Outcome.HARNESS_FAILED):
        wrong.append(f"ended as {result.outcome.label}: {result.detail}")
    if autopilot.armed and autopilot.mode in MOVING and not autopilot.landed:
        wrong.append(f"left in the air in mode {autopilot.mode.value}: nobody flies it")
    if (
        autopilot.armed
        and autopilot.mode is FlightMode.HOLD
        and not autopilot.landed
        and not noted.has_a_person
    ):
        wrong.append("left in the air in hold, and no person took it")
    return wrong


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


async def _person(act: Act, harness: OneDrone, noted: Watched) -> None:
    await asyncio.sleep(act.at_s)
    world = harness.world
    autopilot = world.drone(ROLE).autopilot
    noted.hand = "person"
    try:
        begin(act, autopilot, world.time_s)
    finally:
        noted.hand = "script"
    if act.back_s:
        await asyncio.sleep(act.back_s)
        undo(act, harness.world.drone(ROLE).autopilot)


async def _looks(harness: OneDrone, noted: Watched) -> None:
    while True:
        world = harness.world
        noted.look(world.drone(ROLE).autopilot, world.time_s)
        await asyncio.sleep(0.05)
