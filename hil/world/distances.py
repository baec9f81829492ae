"""Distances in the world: of a drone from a target that it could hit, from what stands in the way,
and between any number of bodies.

A person, or what flies, can be hit; a car is below every drone. Of many bodies no two are compared
that are far apart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hil.world.snapshot import TargetKind
from path.arrays import Array
from path.values import frozen

if TYPE_CHECKING:
    from hil.world.world import Fleet  # which asks how near its drones are to each other

FEW = 8  # bodies, which are compared without a tree
# Half width, half height and height of the middle above the frame's origin, m.
_BODIES: dict[TargetKind, tuple[float, float, float]] = {
    "person": (0.35, 0.875, 0.875),
    "drone": (0.16, 0.05, 0.0),
}
DRONE_M = 0.16  # around the middle of a body
LEAST_M = 0.4  # between the bodies


def clearance(world: Fleet) -> float:
    """Return the least distance between the target's body and that of a drone in the air, m;
    infinite without any.

    Look-alikes are not looked at: nobody tells the drones to keep away from them.
    """
    body = _BODIES.get(world.config.target.kind)
    if body is None:
        return math.inf
    longer, wider, higher = world.config.target.stretch
    half_m = max(longer, wider) * body[0]
    high_m = higher * body[1]
    middle_m = higher * body[2]
    nearest_m = math.inf
    for drone in map(world.drone, world.names):
        if not drone.on_ground:
            north, east, down = drone.true_position_n_m
            x, y, z = world.target().position_w_m
            across = max(0.0, math.hypot(x - east, y - north) - half_m)
            above = max(0.0, abs(-down - z - middle_m) - high_m)
            nearest_m = min(nearest_m, math.hypot(across, above) - DRONE_M)
    return nearest_m


def obstacles_m(world: Fleet) -> dict[str, float]:
    """Return the distance of each body in the air to the nearest obstacle, m; empty without
    obstacles.
    """
    if not world.obstacles:
        return {}
    places = {name: world.drone(name).true_position_n_m for name in world.airborne}
    return {
        name: min(each.distance_m(place) for each in world.obstacles) - DRONE_M
        for name, place in places.items()
    }


@frozen
class Nearness:
    """
    Attributes:
        closest_m: between the two that are nearest to each other; infinite for fewer than two.
        pair: their names, as the others' in the order in which they were given.
        too_near: every pair that is nearer than was asked for.
    """

    closest_m: float
    pair: tuple[str, ...]
    too_near: tuple[tuple[str, str, float], ...]


def nearness(names: tuple[str, ...], places_m: Array, within_m: float) -> Nearness:
    """Of bodies at places, (n, 3) in m. A pair is too near when it is nearer than ``within_m``."""
    places = [tuple(place) for place in places_m.tolist()]
    if len(names) <= FEW:
        pairs = [(j, i) for i in range(len(names)) for j in range(i)]
    else:
        from scipy.spatial import KDTree  # noqa: PLC0415 (a few are compared without)

        tree = KDTree(places_m)
        to_next, _ = tree.query(places_m, k=2)
        reach_m = max(float(to_next[:, 1].min()), within_m) + 1e-9
        pairs = sorted(tree.query_pairs(reach_m))
    closest_m = math.inf
    closest = ()
    too_near: list[tuple[str, str, float]] = []
    for j, i in pairs:
        apart_m = math.dist(places[j], places[i])
        if apart_m < closest_m:
            closest_m = apart_m
            closest = (names[j], names[i])
        if apart_m < within_m:
            too_near.append((names[j], names[i], apart_m))
    return Nearness(closest_m, closest, tuple(too_near))
