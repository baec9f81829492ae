"""The order of a relay's legs: who is called, when, and what those on the ground do.

The responsible drone asks to be relieved, by its own battery; the base calls the drone that has waited longest. When
none is ready it says so at once: the responsible drone knows by itself when it has to go home.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, Protocol

from flight.guidance import Vec3
from flight.harness.flights import RoleResult
from flight.harness.relay import DroneProgram, Pointed, RelayConfig, RelayField
from flight.outcome import MissionEnd, Outcome
from missions.leg.ends import as_end
from path.messages import Role

POLL_S = 0.5

What = Literal["named", "find", "call", "holds", "leg failed", "lost", "alarm", "down", "ready", "end"]
Where = Literal["ready", "flying", "swap"]


class TakeOffOrder(Enum):
    """The task that a drone takes off for."""

    FIND = "find"  # the target, where it was pointed at
    RELIEVE = "relieve"


@dataclass(slots=True)
class Leg:
    """One hand-over, from the call to its end. Times are of the relay's clock."""

    number: int
    sender: str
    receiver: str
    called_s: float
    battery: float  # of the sender, when it was called
    target: int = 0  # of a team
    held_s: float | None = None
    outcome: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Event:
    """A line for the crew."""

    time_s: float
    drone: str
    what: What
    text: str


Tell = Callable[[Event], None]


class Ground(Protocol):
    """The ground as a drone's program asks and tells it: ``Base``, or the way to it."""

    @property
    def over(self) -> bool:
        """Returns whether the time is over: nobody is called any more."""
        ...

    def order_of(self, name: str) -> TakeOffOrder: ...

    def leg_of(self, name: str) -> Leg | None:
        """The leg under way, when this drone is in it."""
        ...

    def ask(self, name: str, battery: float, wait_s: float) -> None:
        """Asks to be relieved. ``wait_s``: how long it can still wait before it has to go home."""
        ...

    def holds(self, name: str) -> None:
        """The target, from now on: it found it, or it was handed over to it."""
        ...

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        """Tells the end of a leg for the drone that goes on with the target."""
        ...


@dataclass(frozen=True, slots=True)
class SentTo:
    """The target that a drone of a team is sent to, where it was said to be, and the heading to follow it from."""

    target: int
    place_n_m: Vec3
    heading_deg: float


class TeamGround(Ground, Protocol):
    """The ground of a team: it knows targets besides."""

    def sent_to(self, name: str) -> SentTo: ...

    def pointed_at(self, name: str) -> Pointed:
        """Returns the place at which a person points, whose target this drone is sent to find."""
        ...

    def follows(self, name: str, place_n_m: Vec3) -> None:
        """Takes the target's place, as a drone that has it says now and then."""
        ...

    def gave_up(self, name: str, why: str) -> None:
        """A drone that had its target has it no more, and handed it to nobody."""
        ...


@dataclass(slots=True)
class _BaseDrone:
    where: Where = "ready"
    ready_s: float = 0.0  # since, or when
    order: TakeOffOrder = TakeOffOrder.RELIEVE
    task: asyncio.Task[None] | None = None
    result: RoleResult | None = None


@dataclass(slots=True)
class Base:
    """Knows what the drones say, and acts on the field. One loop, in ``run``. Times are from its beginning."""

    config: RelayConfig
    tell: Tell = lambda _: None
    hours: float = 8.0
    legs: list[Leg] = field(default_factory=list[Leg])
    events: list[Event] = field(default_factory=list[Event])
    holder: str | None = None
    outcome: Outcome = Outcome.COMMITTED
    detail: str = ""
    over: bool = False  # the time is: nobody is called any more
    _drones: dict[str, _BaseDrone] = field(init=False)
    _program: DroneProgram = field(init=False)
    _ground: RelayField = field(init=False)
    _begun_s: float = 0.0
    _asking: tuple[str, float, float] | None = None  # who, its battery, how long it can still wait, s
    _leg: Leg | None = None
    _alarmed: bool = False

    def __post_init__(self) -> None:
        self._drones = {drone.name: _BaseDrone(ready_s=float(k)) for k, drone in enumerate(self.config.drones)}

    # --- what the drones' programs ask and say (``Ground``) ---

    def order_of(self, name: str) -> TakeOffOrder:
        return self._drones[name].order

    def leg_of(self, name: str) -> Leg | None:
        leg = self._leg
        return leg if leg is not None and name in (leg.sender, leg.receiver) else None

    def ask(self, name: str, battery: float, wait_s: float) -> None:
        if name == self.holder:
            self._asking = name, battery, wait_s

    def holds(self, name: str) -> None:
        leg = self.leg_of(name)
        if leg is not None:
            leg.held_s, leg.outcome = self._now_s(), Outcome.COMMITTED.label
            self._leg = None
            self._ground.close_leg(leg.number)
        self.holder, self._asking, self._alarmed = name, None, False
        self._say(name, "holds", "responsible" if leg is None else f"responsible, relieved {leg.sender}")

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        leg = self.leg_of(name)
        if leg is not None:
            leg.outcome, leg.detail = end.outcome.label, end.detail
            self._leg, self._asking = None, None
            self._ground.close_leg(leg.number)
            self._say(name, "leg failed", f"leg {leg.number}, relief {leg.receiver}: {end}")

    # --- the loop ---

    async def run(self, ground: RelayField, stop: asyncio.Event, program: DroneProgram) -> None:
        """Runs from the first take-off until the relay is over and everybody is down. ``program``: of every drone."""
        self._ground, self._program, self._begun_s = ground, program, asyncio.get_running_loop().time()
        self._call(self.config.drones[0].name, TakeOffOrder.FIND)
        end_s = self._now_s() + 3600.0 * self.hours
        while not stop.is_set() and not self._finished():
            self.over = self._now_s() >= end_s
            self._look_after_the_ground()
            if self._leg is None and not self.over:
                self._relieve()
            await asyncio.sleep(POLL_S)
        if stop.is_set():
            self.outcome, self.detail = Outcome.INTERRUPTED, Outcome.INTERRUPTED.meaning
        flying = [drone.task for drone in self._drones.values() if drone.task is not None]
        if flying:
            await asyncio.wait(flying)
        self._say("", "end", f"{self.outcome.label}{': ' if self.detail else ''}{self.detail}")

    def _finished(self) -> bool:
        """Returns whether nobody has the target, and nobody is about to take it."""
        last = [self.holder or self.config.drones[0].name]
        if self._leg is not None:
            last.append(self._leg.receiver)
        ended = {name: self._drones[name].result for name in last}
        if any(result is None for result in ended.values()):
            return False
        for name, result in ended.items():
            if result is not None and result.outcome is not Outcome.COMMITTED:
                self.outcome, self.detail = result.outcome, f"{name}: {result.detail}"
                break
        return True

    def _look_after_the_ground(self) -> None:
        now_s = self._now_s()
        for name, drone in self._drones.items():
            if drone.where == "flying" and drone.task is not None and drone.task.done() and self._ground.landed(name):
                if self.holder == name:
                    continue  # the relay is about to end
                drone.where, drone.ready_s = "swap", now_s + self.config.swap_s
                self._say(name, "down", end_of(drone.result))
            elif drone.where == "swap" and now_s >= drone.ready_s:
                self._ground.swap(name)
                drone.where, drone.ready_s = "ready", now_s
                self._say(name, "ready", "full battery")

    def _relieve(self) -> None:
        """Call the next drone, when one is asked for, is ready, and nobody else is in the air."""
        if self._asking is None:
            return
        name, battery, wait_s = self._asking
        ready = sorted((drone.ready_s, other) for other, drone in self._drones.items() if drone.where == "ready")
        if not ready or wait_s < self.config.least_s:
            self._alarm(name, wait_s)
            return
        if any(not self._ground.landed(other) for other in self._drones if other != name):
            return
        relief = ready[0][1]
        self._leg = Leg(len(self.legs) + 1, name, relief, self._now_s(), battery)
        self.legs.append(self._leg)
        self._ground.open_leg(self._leg.number, name, relief)
        self._say(relief, "call", f"leg {self._leg.number}: relieves {name}, whose battery is at {100 * battery:.0f} %")
        self._call(relief, TakeOffOrder.RELIEVE)

    def _alarm(self, name: str, wait_s: float) -> None:
        if self._alarmed:
            return
        self._alarmed = True
        now_s = self._now_s()
        coming = [drone.ready_s for drone in self._drones.values() if drone.where == "swap"]
        soonest = f"the next one in {min(coming) - now_s:.0f} s" if coming else "and none will be"
        self._say(name, "alarm", f"no relief is ready, {soonest}; the target is given up in {wait_s:.0f} s otherwise")

    def _call(self, name: str, order: TakeOffOrder) -> None:
        drone = self._drones[name]
        drone.where, drone.order, drone.result = "flying", order, None
        drone.task = asyncio.ensure_future(self._fly(name, drone))

    async def _fly(self, name: str, drone: _BaseDrone) -> None:
        drone.result = await flown(self._ground, name, self._program)

    def _say(self, name: str, what: What, text: str) -> None:
        event = Event(round(self._now_s(), 2), name, what, text)
        self.events.append(event)
        self.tell(event)

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time() - self._begun_s


async def flown(field: RelayField, name: str, program: DroneProgram) -> RoleResult:
    """Flies one drone's program to its end; one that died, or ended as nobody foresaw, has a result too."""
    try:
        died = RoleResult(Role.RECEIVER, Outcome.CRASHED, "its program died", responsible=False, landed=False)
        return await field.begin(name, program) or died
    except Exception as error:
        end = as_end(error)  # prints what nobody foresaw
        return RoleResult(Role.RECEIVER, end.outcome, end.detail, responsible=False, landed=False)


def end_of(result: RoleResult | None) -> str:
    """Returns how a drone's flight ended, for a line to the crew."""
    if result is None:
        return "landed"
    return result.outcome.label + (f": {result.detail}" if result.detail else "")
