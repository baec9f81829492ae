"""What both drones of a pair must have alike, as each tells the other.

The marker that one drone carries is measured by the other: a side that is written wrongly in one of
two rigs scales every distance between the drones. So each says digests of what both must have
alike, and a pair that differs is refused before anything moves. Pure.
"""

from __future__ import annotations

from dataclasses import fields

from path.values import frozen

BITS = 16
SIDE_UNIT_M = 0.0001


@frozen
class Alike:
    """Digests of 16 bits, none of them 0.

    Attributes:
        dialect: the messages' layout.
        code: the program.
        origin: of the mission's local frame.
        markers: dictionary and ids.
        sides: of the markers.
        places: of the markers in ``v``.
        method: its settings.
        separation: what is kept between the drones.
        first_side: of the marker with the lowest id, in 0.1 mm: no digest, so that both can be
            told.
    """

    dialect: int
    code: int
    origin: int
    markers: int
    sides: int
    places: int
    method: int
    separation: int
    first_side: int


_WHAT = {
    "dialect": "the messages between the drones (path.xml)",
    "code": "the version of PATH",
    "origin": "[origin]",
    "markers": "[[markers]]: the dictionary or the ids",
    "sides": "[[markers]]: side_m",
    "places": "[[markers]]: position_v_m or rpy_deg",
    "method": "[method]",
    "separation": "[mission.separation]",
}
"""In the order in which they are told: what explains others stands before them."""


def differing(own: Alike, other: Alike | None) -> list[str]:
    """Name what the two drones have not alike, the first cause first; empty when they agree.

    ``other``: None when the other drone does not say what it has.
    """
    if other is None:
        return [
            "the version of PATH (the other drone's is older: it does not say what its rig has)"
        ]
    found = [what for name, what in _WHAT.items() if getattr(own, name) != getattr(other, name)]
    sides = own.first_side, other.first_side
    if own.sides != other.sides and sides[0] != sides[1]:
        here, there = (f"{1000.0 * SIDE_UNIT_M * side:.1f} mm" for side in sides)
        place = found.index(_WHAT["sides"])
        found[place] += f" ({here} here, {there} there)"
    return found


assert set(_WHAT) == {each.name for each in fields(Alike)} - {"first_side"}
