"""The ground's knowledge of each drone and each target of a team."""

from __future__ import annotations

from dataclasses import dataclass, field

from flight.guidance import Vec3
from flight.harness.fleet import NamedTarget
from missions.fly.relay.crew import CalledDrone
from missions.fly.relay.ground import Leg, TurnedBack
from missions.fly.team.airways import Airway, Point


@dataclass(slots=True, kw_only=True)
class TeamDrone(CalledDrone):
    """The ground's knowledge of one drone.

    Attributes:
        ways: those that are kept free for it.
        has_nothing: it said that it is not responsible for its target any more.
        turned_back: on its way home it was asked to find its target again.
    """

    home_m: Point
    target: int | None = None
    heading_deg: float = 0.0
    leg: Leg | None = None
    called_home: bool = False
    has_nothing: bool = False
    turned_back: TurnedBack = "no"
    ways: list[Airway] = field(default_factory=list[Airway])


@dataclass(slots=True)
class TeamTarget:
    """The ground's knowledge of one target.

    Attributes:
        holder, leg, finder: who has it, who is about to take it over, who was sent to find it.
        asking: battery of the holder, and until when it can wait, once it has asked for its relief.
        place_n_m: where it was last said to be.
        lost_s: since when nobody has it.
    """

    number: int
    named: NamedTarget
    known: bool = False
    holder: str | None = None
    finder: str | None = None
    leg: Leg | None = None
    asking: tuple[float, float] | None = None
    heading_deg: float | None = None
    place_n_m: Vec3 = (0.0, 0.0, 0.0)
    lost_s: float = 0.0
    alarmed: bool = False

    @property
    def place_m(self) -> Point:
        north, east, _ = self.place_n_m
        return east, north
