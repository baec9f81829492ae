"""Those on the ground of a relay or a team: who is called, lands and stands ready again, and what
the crew is told.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

from flight.guidance import Vec3
from flight.harness.fleet import RelayConfig
from flight.harness.flights import RoleResult
from flight.harness.relay import DroneProgram, Pointed, RelayField
from flight.outcome import Outcome
from missions.fly.leg.session import as_end
from missions.fly.relay.ground import (
    Custody,
    Event,
    Leg,
    SentTo,
    TakeOffOrder,
    Tell,
    TurnedBack,
    What,
)
from path.messages import Role

POLL_S = 0.5
_NOT_FLOWN = 0.99  # of the charge: its leg was over before it took off
_BY_OTHERS = frozenset(
    {
        Outcome.NO_AGREEMENT, Outcome.TARGET_NOT_FOUND, Outcome.MARKER_NOT_FOUND, Outcome.MARKER_LOST,
        Outcome.NO_VIEWPOINT, Outcome.PEER_LOST, Outcome.PEER_ABORTED, Outcome.APPROACH_FAILED, Outcome.TOO_CLOSE,
    }
)  # fmt: skip
"""Ends of a leg that say nothing against the drone itself."""

Where = Literal["ready", "flying", "swap"]


@dataclass(slots=True, kw_only=True)
class CalledDrone:
    """The ground's knowledge of one drone. ``ready_s``: since when it stands ready, or when it
    will.
    """

    name: str
    battery: float
    where: Where = "ready"
    ready_s: float = 0.0
    order: TakeOffOrder = TakeOffOrder.RELIEVE
    task: asyncio.Task[None] | None = None
    result: RoleResult | None = None


Config = TypeVar("Config", bound=RelayConfig)
Called = TypeVar("Called", bound=CalledDrone)


@dataclass
class Crew(ABC, Generic[Config, Called]):
    """Knows what the drones say, and acts on the field: a ``missions.fly.relay.ground.Ground``.
    One loop, in ``run``. Times are from its beginning.

    Attributes:
        spells: who had which target when, as far as it was said.
        over: the time is; nobody is called any more.
    """

    config: Config
    tell: Tell = lambda _: None
    hours: float = 8.0
    legs: list[Leg] = field(default_factory=list[Leg])
    events: list[Event] = field(default_factory=list[Event])
    spells: list[Custody] = field(default_factory=list[Custody])
    outcome: Outcome = Outcome.COMMITTED
    detail: str = ""
    over: bool = False
    drones: dict[str, Called] = field(init=False)
    _program: DroneProgram = field(init=False)
    _field: RelayField = field(init=False)
    _begun_s: float = 0.0

    # --- what the drones' programs ask and say; what is said of targets is for a team's base ---

    def order_of(self, name: str) -> TakeOffOrder:
        return self.drones[name].order

    def called_home(self, name: str) -> bool:
        del name
        return self.over

    def sent_to(self, name: str) -> SentTo | None: ...

    def pointed_at(self, name: str) -> Pointed | None: ...

    def follows(self, name: str, place_n_m: Vec3) -> None: ...

    def gave_up(self, name: str, why: str) -> None: ...

    def may_find(self, name: str, wait_s: float) -> None: ...

    def turned_back(self, name: str) -> TurnedBack:
        del name
        return "no"

    # --- the loop ---

    async def run(
        self,
        where: RelayField,
        stop: asyncio.Event,
        program: DroneProgram,
    ) -> None:
        """Runs from the first take-off until all is over and everybody is down. ``program``: of
        every drone.
        """
        self._field = where
        self._program = program
        self._begun_s = asyncio.get_running_loop().time()
        self._begin()
        while not stop.is_set() and not self._finished():
            self._step(self._now_s() >= 3600.0 * self.hours)
            await asyncio.sleep(POLL_S)
        if stop.is_set():
            self.outcome = Outcome.INTERRUPTED
            self.detail = Outcome.INTERRUPTED.meaning
        flying = self._flying()
        if flying:
            await asyncio.wait(flying)
        self._say("", "end", f"{self.outcome.label}{': ' if self.detail else ''}{self.detail}")

    # --- what a relay and a team do in their own ways ---

    def _begin(self) -> None:
        """Call whoever is to be in the air before the first step."""

    @abstractmethod
    def _step(self, time_is_over: bool) -> None:
        """Call whom there is to call, and look after the others."""

    @abstractmethod
    def _finished(self) -> bool: ...

    @abstractmethod
    def _program_over(self, drone: Called) -> bool:
        """True for a drone that is to be swapped once it has landed."""

    def _landed(self, drone: Called) -> None:
        """It is down, for its swap."""

    # --- what both do ---

    def _look_after_the_ground(self) -> None:
        now_s = self._now_s()
        for name, drone in self.drones.items():
            if drone.where == "flying" and drone.task is not None and drone.task.done():
                if self._program_over(drone) and self._field.landed(name):
                    drone.where = "swap"
                    drone.ready_s = now_s + self._until_ready_s(drone)
                    self._landed(drone)
                    self._say(name, "down", end_of(drone.result))
            elif drone.where == "swap" and now_s >= drone.ready_s:
                self._field.swap(name, drone.battery)
                drone.where = "ready"
                drone.ready_s = now_s
                full = drone.battery == 1.0
                self._say(
                    name,
                    "ready",
                    "full battery"
                    if full
                    else f"battery at {100 * drone.battery:.0f} %, as it was",
                )

    def _until_ready_s(self, drone: Called) -> float:
        """Return how long a drone that has landed is seen to, and decide whether it keeps its
        battery.
        """
        left = self._field.battery(drone.name)
        unhurt = drone.result is not None and drone.result.outcome in _BY_OTHERS
        keeps = unhurt and left >= self.config.keep_battery
        drone.battery = left if keeps else 1.0
        if not keeps:
            return self.config.swap_s
        return 0.0 if left >= _NOT_FLOWN else self.config.check_s

    def _call(self, drone: Called, order: TakeOffOrder) -> None:
        drone.where = "flying"
        drone.order = order
        drone.result = None
        drone.task = asyncio.ensure_future(self._fly(drone))

    async def _fly(self, drone: Called) -> None:
        """One drone's program to its end; one that died, or ended as nobody foresaw, has a result
        too.
        """
        try:
            died = RoleResult(
                Role.RECEIVER,
                Outcome.CRASHED,
                "its program died",
                responsible=False,
                landed=False,
            )
            drone.result = await self._field.begin(drone.name, self._program) or died
        except Exception as error:
            end = as_end(error)  # prints what nobody foresaw
            drone.result = RoleResult(
                Role.RECEIVER,
                end.outcome,
                end.detail,
                responsible=False,
                landed=False,
            )

    def _flying(self) -> list[asyncio.Task[None]]:
        return [
            drone.task
            for drone in self.drones.values()
            if drone.task is not None and not drone.task.done()
        ]

    def _soonest(self) -> str:
        """The time at which a drone will stand ready, for a line to the crew."""
        coming = [drone.ready_s for drone in self.drones.values() if drone.where == "swap"]
        return (
            f"the next one in {min(coming) - self._now_s():.0f} s" if coming else "and none will be"
        )

    def _begin_spell(self, target: int, name: str) -> None:
        self._end_spell(target)
        self.spells.append(Custody(target, name, self._now_s()))

    def _end_spell(self, target: int) -> None:
        for spell in reversed(self.spells):
            if spell.target == target:
                spell.to_s = self._now_s() if spell.to_s is None else spell.to_s
                return

    def _say(
        self,
        name: str,
        what: What,
        text: str,
    ) -> None:
        event = Event(round(self._now_s(), 2), name, what, text)
        self.events.append(event)
        self.tell(event)

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time() - self._begun_s


def end_of(result: RoleResult | None) -> str:
    """Return how a drone's flight ended, for a line to the crew."""
    if result is None:
        return "landed"
    return result.outcome.label + (f": {result.detail}" if result.detail else "")
