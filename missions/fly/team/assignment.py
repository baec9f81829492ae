"""The assignment of drones that stand ready to targets that need one, and of the headings from
which they follow. Pure.

Every pair that is possible has a cost in seconds, and ``scipy.optimize.linear_sum_assignment``
finds the pairs whose costs add up to the least. (E, N) in metres, headings clockwise from north.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from missions.fly.team.airways import Airway, Point, in_the_way
from path.arrays import Array
from path.values import frozen

EMPTY_S = 240.0  # what an empty battery costs more than a full one: it comes back as much sooner
CLUTTER_S = 60.0  # another target right behind this one, in the same image
CLUTTER_M = 8.0
IN_IMAGE_DEG = 35.0  # to either side of where a camera looks
HEADINGS = 8
MOST = 12  # drones that are looked at for one target
NEVER = 1e9
LOST_S = 500.0  # what a target that nobody has is worth, where there are fewer drones than needs
# less the time that is left: a target about to be given up is worth more than one that is lost
SOON_S = 700.0


@frozen
class ReadyDrone:
    """A drone that stands ready."""

    name: str
    home_m: Point
    battery: float


@frozen
class Need:
    """A target that needs a drone.

    Attributes:
        place_m: where it is.
        heading_deg: from which it is followed; None: whoever finds it chooses.
        others: where other objects are that look like it.
        may: the drones that may take it; None: all.
        urgent_s: in how many seconds it is given up otherwise; 0: nobody has it.
    """

    target: int
    place_m: Point
    heading_deg: float | None
    others: tuple[Point, ...] = ()
    may: frozenset[str] | None = None
    urgent_s: float = 0.0


@frozen
class Assignment:
    """One assignment: the drone, and the heading from which it follows."""

    target: int
    drone: str
    heading_deg: float
    cost_s: float


@frozen
class Airspace:
    """The ways that are flown already, and those of a pair.

    Attributes:
        flown: ways that are in use.
        clear_m, entry_m, speed_mps: between two ways; how far behind a target's follower a drone
            goes down; on a way.
    """

    flown: Sequence[Airway]
    clear_m: float
    entry_m: float
    speed_mps: float


Ways = Callable[[Need, ReadyDrone], Sequence[Airway]]


def assign(
    needs: Sequence[Need],
    drones: Sequence[ReadyDrone],
    ways: Ways,
    air: Airspace,
) -> list[Assignment]:
    """The pairs of the least cost in all; a need for which there is nobody is left out.

    Args:
        ways: what a pair would fly; one that is in the way of others waits.
    """
    if not needs or not drones:
        return []
    costs = np.full((len(needs), len(drones)), NEVER)
    headings = np.zeros_like(costs)
    homes = np.array([drone.home_m for drone in drones])
    for i, need in enumerate(needs):
        for j in _nearest(
            need,
            homes,
            [need.may is None or drone.name in need.may for drone in drones],
        ):
            if not in_the_way(ways(need, drones[j]), air.flown, air.clear_m):
                cost_s, headings[i, j] = cost_of(need, drones[j], air)
                costs[i, j] = cost_s - worth_s(need)
    rows, columns = linear_sum_assignment(costs)
    return [
        Assignment(needs[i].target, drones[j].name, float(headings[i, j]), float(costs[i, j]))
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True)
        if costs[i, j] < NEVER
    ]


def _nearest(
    need: Need,
    homes: Array,
    may: Sequence[bool],
) -> list[int]:
    """The drones that are worth looking at: in a large field those from its other end are not."""
    away_m = np.hypot(*(homes - np.array(need.place_m)).T)
    away_m[~np.array(may)] = np.inf
    order = np.argsort(away_m, kind="stable")[:MOST]
    return [j for j in order.tolist() if math.isfinite(away_m[j])]


def worth_s(need: Need) -> float:
    """Return what it is worth to serve a need now, in seconds; the same for every drone."""
    return max(0.0, SOON_S - need.urgent_s) if need.urgent_s > 0.0 else LOST_S


def cost_of(
    need: Need,
    drone: ReadyDrone,
    air: Airspace,
) -> tuple[float, float]:
    """In seconds, and the heading at which it is that: the way there, the battery, what else is in
    the image.
    """
    if need.heading_deg is not None:
        choices = (need.heading_deg,)
    else:
        choices = tuple(360.0 * k / HEADINGS for k in range(HEADINGS))
    battery_s = EMPTY_S * (1.0 - drone.battery)
    return min((_way_s(need, drone, air, h) + clutter_s(need, h) + battery_s, h) for h in choices)


def clutter_s(need: Need, heading_deg: float) -> float:
    """The cost of others in the image, beyond the target as it is seen at a heading: the nearer the
    more.
    """
    worst = 0.0
    for east, north in need.others:
        away_m = math.hypot(east - need.place_m[0], north - need.place_m[1])
        if 0.0 < away_m < CLUTTER_M:
            bearing = math.degrees(math.atan2(east - need.place_m[0], north - need.place_m[1]))
            if abs((bearing - heading_deg + 180.0) % 360.0 - 180.0) < IN_IMAGE_DEG:
                worst = max(worst, CLUTTER_S * (1.0 - away_m / CLUTTER_M))
    return worst


def _way_s(
    need: Need,
    drone: ReadyDrone,
    air: Airspace,
    heading_deg: float,
) -> float:
    """To where it goes down behind the target."""
    turn = math.radians(heading_deg)
    entry = (
        need.place_m[0] - air.entry_m * math.sin(turn),
        need.place_m[1] - air.entry_m * math.cos(turn),
    )
    return math.dist(drone.home_m, entry) / air.speed_mps
