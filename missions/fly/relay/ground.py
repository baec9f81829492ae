"""The words between a drone and those on the ground in a relay or a team: orders, legs, and words
to the crew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Literal, Protocol

from flight.guidance import Vec3
from flight.harness.relay import Pointed
from flight.outcome import MissionEnd
from path.values import frozen

What = Literal[
    "named", "find", "call", "holds", "leg failed", "lost", "alarm", "down", "ready", "end"
]


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


@frozen
class Event:
    """A line for the crew."""

    time_s: float
    drone: str
    what: What
    text: str


Tell = Callable[[Event], None]


@frozen
class SentTo:
    """The target that a drone of a team is sent to, where it was said to be, and the heading to
    follow it from.
    """

    target: int
    place_n_m: Vec3
    heading_deg: float


@dataclass(slots=True)
class Custody:
    """A drone had a target, from its word on until another one's, or until it was lost."""

    target: int
    drone: str
    from_s: float
    to_s: float | None = None


TurnedBack = Literal["no", "wait", "go"]
"""Of a drone on its way home: it is to fly on; to wait where it is until its way is free; to go and
find its target.
"""


class Ground(Protocol):
    """The ground as a drone's program asks and tells it: the base, or the way to it."""

    def called_home(self, name: str) -> bool:
        """Return whether this drone is to come home: nobody is called any more."""
        ...

    def order_of(self, name: str) -> TakeOffOrder: ...

    def leg_of(self, name: str) -> Leg | None:
        """The leg under way, when this drone is in it."""
        ...

    def ask(
        self,
        name: str,
        battery: float,
        wait_s: float,
    ) -> None:
        """Ask to be relieved. ``wait_s``: how long it can still wait before it has to go home."""
        ...

    def holds(self, name: str) -> None:
        """The target, from now on: it found it, or it was handed over to it."""
        ...

    def leg_failed(self, name: str, end: MissionEnd) -> None:
        """Tell the end of a leg for the drone that goes on with the target."""
        ...

    # --- of a team, whose drones speak of their targets too; None, and nothing, in a relay ---

    def sent_to(self, name: str) -> SentTo | None:
        """Return the target of a drone of a team."""
        ...

    def pointed_at(self, name: str) -> Pointed | None:
        """Return the place at which a person points, whose target this drone is sent to find."""
        ...

    def follows(self, name: str, place_n_m: Vec3) -> None:
        """Take the target's place, as a drone that has it says now and then."""
        ...

    def gave_up(self, name: str, why: str) -> None:
        """A drone that had its target has it no more, and handed it to nobody."""
        ...

    def may_find(self, name: str, wait_s: float) -> None:
        """Tell that a drone on its way home is not responsible, and could find its target again.

        Args:
            wait_s: how long its battery lets it stay.
        """
        ...

    def turned_back(self, name: str) -> TurnedBack:
        """Return whether this drone is wanted at its target again, which nobody has."""
        ...
