"""What can be said of the object that is meant, and what a drone asks back.

A statement claims no more than whoever makes it knows: where something was at an instant, to a
stated error; in which direction; within which edges. Places are north, east and down in the
mission's local frame, in m. Stamps are of the clock of the drone that is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.interfaces import Part
from path.messages import Vec3
from path.observations import Box
from path.values import value

Ground = tuple[float, float]
"""North and east, m."""


@value
class PlaceTold:
    """The object was there.

    Attributes:
        error_m: standard deviation of the place, the same on each axis.
        height_told: whether the place's height was said as well; else it is only what is usual.
        velocity_n_mps: north and east, where it was said how it moved then.
        holds_s: for so long after the stamp it is said to stand, or to go on with that velocity.
    """

    stamp_ns: int
    place_n_m: Vec3
    error_m: float
    height_told: bool = False
    velocity_n_mps: Ground | None = None
    holds_s: float = 0.0


@value
class BearingTold:
    """The object was in this direction (rad, clockwise from north) as seen from a place, to a
    standard deviation.
    """

    stamp_ns: int
    from_n_m: Ground
    bearing_rad: float
    error_rad: float


@value
class RegionTold:
    """The object was within these edges, a polygon of at least three corners."""

    stamp_ns: int
    corners_n_m: tuple[Ground, ...]


@value
class Chosen:
    """The answer to a question: the object with this number, or none of those shown (0)."""

    question: int
    number: int


Told = PlaceTold | BearingTold | RegionTold
"""A statement on where the object was."""


@value
class Shown:
    """One of the objects that a drone asks about, as it was in the frame that is shown."""

    number: int
    box: Box
    place_n_m: Vec3
    velocity_n_mps: Vec3
    share: float  # the probability, by all that was said so far, that it is the one


@value
class Question:
    """Which of these is it? ``stamp_ns``: of the frame that is shown."""

    number: int
    stamp_ns: int
    shown: tuple[Shown, ...]


class Operator(Part, Protocol):
    """Whoever knows which object is meant. Nothing here waits, and nothing that comes in raises."""

    def heard(self) -> Sequence[Told | Chosen]:
        """Return all that was said since the last call, in the order it came."""
        ...

    def ask(self, question: Question | None, picture: bytes | None) -> None:
        """Show a question, in place of the last one; None: it is settled. ``picture``: its frame as
        JPEG, if any.
        """
        ...
