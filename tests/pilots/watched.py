"""What reaches one autopilot, and in whose hand the vehicle was then: nobody fights a person for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

from drivers.interfaces import FlightMode
from drivers.rig.parts import NoOptions, PartContext
from flight.harness.flights import RoleResult
from flight.outcome import Outcome
from hil.autopilot.autopilot import Autopilot
from hil.harness.guard import SimGuard
from hil.world.world import Fleet
from path.messages import Role
from tests.pilots.acts import Act, begin, undo

NOTICED_S = 1.0  # mode and arming come with heartbeats, and one message's word is doubted at first
# in a mode that only scripts fly: from then on the guard may take what was let go of
NOBODYS_S = 1.0
UNSEEN_S = 0.25  # what a person does and undoes between two heartbeats is not told by any of them
# of the height at which a take-off is over, and what it climbs on while it brakes
TOLERANCE_M = 0.75
MOVING = (FlightMode.OFFBOARD, FlightMode.TAKEOFF)


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
    climb_to_m: float | None = None  # of the take-off that was asked for last
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
        if name == "request_takeoff":
            self.climb_to_m = float(args[0])
        elif name == "request_mode" and args[0] is FlightMode.OFFBOARD:
            self.climb_to_m = None
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
        if nobodys:
            self.theirs_s = None  # from now on it is the guard's, until it is down
            return
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
            self.climb_to_m is not None
            and mode is FlightMode.HOLD
            and abs(height_m - self.climb_to_m) < TOLERANCE_M
        )
        if mode in MOVING or ends_so:
            self.theirs_s, self.by_failsafe = None, False
        else:
            self._taken(now_s)
            self.by_failsafe = False

    def _taken(self, now_s: float) -> None:
        if self.theirs_s is None:
            self.theirs_s = now_s


class NotedGuard(SimGuard):
    """The guard's vehicle, whose commands are known as the guard's. Its harness has ``noted``."""

    def __init__(self, config: NoOptions, context: PartContext) -> None:
        super().__init__(config, context)
        self._noted: Watched = cast(Any, context.harness).noted

    def _request(self, mode: FlightMode) -> None:
        before = self._noted.hand
        self._noted.hand = "guard"
        try:
            super()._request(mode)
        finally:
            self._noted.hand = before


class Airborne(Protocol):
    """A harness of one drone, as persons know it. ``world`` is at the loop's present."""

    noted: Watched

    @property
    def world(self) -> Fleet: ...


async def act_on(act: Act, role: Role, harness: Airborne) -> None:
    """Do what a person does at its time, and undo it."""
    await asyncio.sleep(act.at_s)
    world = harness.world
    harness.noted.hand = "person"
    try:
        begin(act, world.drone(role).autopilot, world.time_s)
    finally:
        harness.noted.hand = "script"
    if act.back_s:
        await asyncio.sleep(act.back_s)
        undo(act, harness.world.drone(role).autopilot)


async def keep_looking(role: Role, harness: Airborne) -> None:
    """Look at what needs no request, for ever."""
    while True:
        world = harness.world
        harness.noted.look(world.drone(role).autopilot, world.time_s)
        await asyncio.sleep(0.05)


def ends_badly(result: RoleResult | None, autopilot: Autopilot, noted: Watched) -> list[str]:
    """Say what must not be once a program has ended and its drone was given time to come down."""
    wrong: list[str] = []
    if result is None or result.outcome in (Outcome.CRASHED, Outcome.HARNESS_FAILED):
        wrong.append("its program died" if result is None else f"ended as {result}")
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
