"""The ways of a team through the air, and which of them may be flown at once. Pure; (E, N) in
metres, from above.

Targets are followed low, drones go out to them at one height and come back at another. So two ways
are in each other's way where they cross at the same height, where one crosses a column in which the
other goes up or down, or where two such columns overlap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from path.values import frozen

Point = tuple[float, float]


@frozen
class AirColumn:
    """A column in which a drone goes up or down, through the ways out (``top`` 0), or those and the
    ways back (1).
    """

    middle: Point
    radius_m: float
    top: int


@frozen
class Airway:
    """From a home to a target's area (``level`` 0) or back (``level`` 1), with the columns at its
    ends.
    """

    level: int
    begin: Point
    end: Point
    columns: tuple[AirColumn, ...]


def way_out(
    home: Point,
    target: Point,
    area_m: float,
) -> Airway:
    return Airway(0, home, target, (AirColumn(home, 0.0, 0), AirColumn(target, area_m, 0)))


def way_back(
    home: Point,
    target: Point,
    area_m: float,
) -> Airway:
    return Airway(1, target, home, (AirColumn(home, 0.0, 1), AirColumn(target, area_m, 1)))


def in_the_way(
    wanted: Iterable[Airway],
    flown: Iterable[Airway],
    clear_m: float,
) -> bool:
    """True when anything of what is wanted must wait for what is flown."""
    there = tuple(flown)
    return any(conflict(one, other, clear_m) for one in wanted for other in there)


def conflict(
    one: Airway,
    other: Airway,
    clear_m: float,
) -> bool:
    """True when two ways may bring two drones together."""
    if one.level == other.level and _between(one.begin, one.end, other.begin, other.end) < clear_m:
        return True
    if any(_overlap(mine, its, clear_m) for mine in one.columns for its in other.columns):
        return True
    return _crosses(one, other, clear_m) or _crosses(other, one, clear_m)


def _overlap(
    one: AirColumn,
    other: AirColumn,
    clear_m: float,
) -> bool:
    return math.dist(one.middle, other.middle) < one.radius_m + other.radius_m + clear_m


def _crosses(
    way: Airway,
    other: Airway,
    clear_m: float,
) -> bool:
    """True when a way leads through a column of the other one."""
    return any(
        column.top >= way.level
        and _from(column.middle, way.begin, way.end) < column.radius_m + clear_m
        for column in other.columns
    )


def _from(
    point: Point,
    begin: Point,
    end: Point,
) -> float:
    """From a point to a segment."""
    (px, py), (bx, by), (ex, ey) = point, begin, end
    dx = ex - bx
    dy = ey - by
    length2 = dx * dx + dy * dy
    along = (
        0.0 if length2 == 0.0 else min(1.0, max(0.0, ((px - bx) * dx + (py - by) * dy) / length2))
    )
    return math.hypot(px - bx - along * dx, py - by - along * dy)


def _between(
    a: Point,
    b: Point,
    c: Point,
    d: Point,
) -> float:
    """From one segment to another."""
    if _cross(a, b, c) * _cross(a, b, d) < 0.0 and _cross(c, d, a) * _cross(c, d, b) < 0.0:
        return 0.0
    return min(_from(a, c, d), _from(b, c, d), _from(c, a, b), _from(d, a, b))


def _cross(
    a: Point,
    b: Point,
    c: Point,
) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
