"""The order of a relay's legs: who is called, when, and what those on the ground do.

The responsible drone asks to be relieved, by its own battery; the base calls the drone that has
waited longest. When none is ready it says so at once: the responsible drone knows by itself when it
has to go home.
"""

from __future__ import annotations

from dataclasses import dataclass

from flight.harness.fleet import RelayConfig
from flight.outcome import MissionEnd, Outcome
from missions.fly.relay.crew import CalledDrone, Crew
from missions.fly.relay.ground import Leg, TakeOffOrder


@dataclass
class Base(Crew[RelayConfig, CalledDrone]):
    """The ground of a relay: one target, one leg at a time."""

    holder: str | None = None
    # who, its battery, how long it can still wait, s
    _asking: tuple[str, float, float] | None = None
    _leg: Leg | None = None
    _alarmed: bool = False

    def __post_init__(self) -> None:
        self.drones = {
            drone.name: CalledDrone(name=drone.name, battery=drone.battery, ready_s=float(k))
            for k, drone in enumerate(self.config.drones)
        }

    # --- what the drones' programs ask and say ---

    def leg_of(self, name: str) -> Leg | None:
        leg = self._leg
        return leg if leg is not None and name in (leg.sender, leg.receiver) else None

    def ask(
        self,
        name: str,
        battery: float,
        wait_s: float,
    ) -> None:
        if name == self.holder:
            self._asking = name, battery, wait_s

    def holds(self, name: str) -> None:
        leg = self.leg_of(name)
        if leg is not None:
            leg.held_s = self._now_s()
            leg.outcome = Outcome.COMMITTED.label
            self._leg = None
            self._field.close_leg(leg.number)
        self.holder = name
        self._begin_spell(0, name)
        self._asking = None
        self._alarmed = False
        self._say(
            name,
            "holds",
            "responsible" if leg is None else f"responsible, relieved {leg.sender}",
        )

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        leg = self.leg_of(name)
        if leg is not None:
            leg.outcome = end.outcome.label
            leg.detail = end.detail
            self._leg = None
            self._asking = None
            self._field.close_leg(leg.number)
            self._say(name, "leg failed", f"leg {leg.number}, relief {leg.receiver}: {end}")

    # --- the loop ---

    def _begin(self) -> None:
        self._call(self.drones[self.config.drones[0].name], TakeOffOrder.FIND)

    def _step(self, time_is_over: bool) -> None:
        self._look_after_the_ground()
        self.over = time_is_over and self._is_alone_up(self.holder or self.config.drones[0].name)
        if self._leg is None and not self.over:
            self._relieve()

    def _finished(self) -> bool:
        """Return whether nobody has the target, and nobody is about to take it."""
        last = [self.holder or self.config.drones[0].name]
        if self._leg is not None:
            last.append(self._leg.receiver)
        ended = {name: self.drones[name].result for name in last}
        if any(result is None for result in ended.values()):
            return False
        for name, result in ended.items():
            if result is not None and result.outcome is not Outcome.COMMITTED:
                self.outcome = result.outcome
                self.detail = f"{name}: {result.detail}"
                break
        return True

    def _program_over(self, drone: CalledDrone) -> bool:
        return drone.name != self.holder  # with the holder's the relay is about to end

    def _relieve(self) -> None:
        """Call the next drone, when one is asked for, is ready, and nobody else is in the air."""
        if self._asking is None:
            return
        name, battery, wait_s = self._asking
        ready = sorted(
            (drone.ready_s, other) for other, drone in self.drones.items() if drone.where == "ready"
        )
        if not ready or wait_s < self.config.least_s:
            self._alarm(name, wait_s)
            return
        if not self._is_alone_up(name):
            return
        relief = ready[0][1]
        self._leg = Leg(len(self.legs) + 1, name, relief, self._now_s(), battery)
        self.legs.append(self._leg)
        self._field.open_leg(self._leg.number, name, relief)
        self._say(
            relief,
            "call",
            f"leg {self._leg.number}: relieves {name}, whose battery is at {100 * battery:.0f} %",
        )
        self._call(self.drones[relief], TakeOffOrder.RELIEVE)

    def _is_alone_up(self, name: str) -> bool:
        """Return whether nobody else is in the air: ways home are flown at one height."""
        return all(self._field.landed(other) for other in self.drones if other != name)

    def _alarm(self, name: str, wait_s: float) -> None:
        if not self._alarmed:
            self._alarmed = True
            until = f"the target is given up in {wait_s:.0f} s otherwise"
            self._say(name, "alarm", f"no relief is ready, {self._soonest()}; {until}")
