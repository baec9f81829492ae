"""What stands in the way in a world: what the crew measured, and what a seed puts there unknown to
it.

It hides what is behind it, and stops nothing: a drone that touches it is a violation (S11).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace
from functools import cache
from typing import Annotated, Literal, get_args

import numpy as np

from drivers.rig.obstacle import Obstacle
from hil.world.clutter import Crate, Point
from path.arrays import Array
from path.bounds import Bounds
from path.values import frozen

Kind = Literal["pillar", "tree", "vehicle", "wall"]

ASIDE_M = 0.5
"""Between an obstacle and what drives."""
HOME_M = 2.0
"""Between an obstacle and where a drone stands."""
GAP_M = 2.4
"""Between two obstacles: a drone fits through."""
REACH_M = 3.0
"""They stand within this much of the target's way and of the homes."""
TRIES = 60
TURNS_DEG = (0.0, 45.0, 90.0, 135.0)
OCTAGON_M = math.cos(math.pi / 8.0), math.sin(math.pi / 8.0)
"""Half sides of the boxes that make up a round one of radius 1: an octagon inside it."""


@frozen
class ObstaclesConfig:
    """The ``[world.obstacles]`` table of a rig.

    Attributes:
        count, kinds: of those that a seed puts beside the target's way, and that nobody knows.
        known: those of the rig's site.
    """

    count: Annotated[int, Bounds(0, 200, "obstacles")] = 0
    kinds: tuple[Kind, ...] = get_args(Kind)
    known: tuple[Obstacle, ...] = field(default_factory=tuple[Obstacle, ...])


def stand(
    config: ObstaclesConfig,
    measured_m: float,
    ways: Array,
    homes: Sequence[Point],
    seed: int,
) -> tuple[Obstacle, ...]:
    """Return what truly stands there: what is known, off by a tape's error, and what a seed adds.

    Args:
        measured_m: standard deviation of a measured place, per axis.
        ways: (n, 2), E and N of where anything drives or is parked.
    """
    if not config.count and not config.known:
        return ()
    rng = np.random.default_rng([seed, 0x6F6273])
    known: list[Obstacle] = []
    for each in config.known:
        north, east = (np.array(each.place_m) + measured_m * rng.standard_normal(2)).tolist()
        known.append(replace(each, place_m=(north, east)))
    return (*known, *_drawn(config, known, ways, homes, rng))


def _drawn(
    config: ObstaclesConfig,
    known: Sequence[Obstacle],
    ways: Array,
    homes: Sequence[Point],
    rng: np.random.Generator,
) -> list[Obstacle]:
    """Return as many obstacles as are asked for, or as there is room for."""
    around = np.vstack((ways, homes))
    low = around.min(axis=0) - REACH_M
    high = around.max(axis=0) + REACH_M
    drive = [(float(north), float(east), 0.0) for east, north in ways]
    at_homes = [(north, east, 0.0) for east, north in homes]
    firsts = list(known)
    drawn: list[Obstacle] = []
    for _ in range(TRIES * config.count):
        if len(firsts) == len(known) + config.count:
            break
        east, north = rng.uniform(low, high).tolist()
        first, *above = _made(config.kinds[int(rng.integers(len(config.kinds)))], rng)
        first = replace(first, place_m=(north, east))
        on_ways = any(first.distance_m(place) < ASIDE_M for place in drive)
        on_homes = any(first.distance_m(place) < HOME_M for place in at_homes)
        apart_m = [
            math.dist(first.place_m, other.place_m) - first.reach_m - other.reach_m
            for other in firsts
        ]
        if not on_ways and not on_homes and min(apart_m, default=GAP_M) >= GAP_M:
            firsts.append(first)
            drawn += [first, *(replace(each, place_m=first.place_m) for each in above)]
    return drawn


def _made(kind: Kind, rng: np.random.Generator) -> list[Obstacle]:
    """Return what one of a kind is made of, from the ground up: a tree is a trunk and its crown."""
    share, other = rng.uniform(0.0, 1.0, 2).tolist()
    heading_deg = float(rng.uniform(0.0, 360.0))
    if kind == "pillar":
        return [_round(0.3 + 0.3 * share, 0.0, 2.5 + 1.5 * other)]
    if kind == "tree":
        return [_round(0.2 + 0.2 * share, 0.0, 4.0), _round(1.6 + other, 4.0, 6.0)]
    if kind == "vehicle":
        size_m = (3.8 + share, 1.8)
        return [Obstacle((0.0, 0.0), size_m, 1.4 + 0.6 * other, heading_deg=heading_deg)]
    size_m = (1.5 + 2.0 * share, 0.2)
    return [Obstacle((0.0, 0.0), size_m, 2.0 + other, heading_deg=heading_deg)]


def _round(diameter_m: float, floor_m: float, top_m: float) -> Obstacle:
    return Obstacle((0.0, 0.0), (diameter_m, diameter_m), top_m, floor_m, round=True)


@cache
def crates_of(obstacles: tuple[Obstacle, ...]) -> tuple[Crate, ...]:
    """Return the boxes that obstacles are for cameras: four of a round one, which make an
    octagon.
    """
    boxes: list[Crate] = []
    for obstacle in obstacles:
        north, east = obstacle.place_m
        high_m = obstacle.top_m - obstacle.floor_m
        turns_deg = TURNS_DEG if obstacle.round else (0.0,)
        along, across = OCTAGON_M if obstacle.round else (1.0, 1.0)
        length_m = along * obstacle.size_m[0]
        width_m = across * obstacle.size_m[1]
        for turn_deg in turns_deg:
            yaw_rad = math.radians(90.0 - obstacle.heading_deg - turn_deg)
            look = len(boxes)
            size_m = (length_m, width_m, high_m)
            boxes.append(Crate((east, north), yaw_rad, size_m, look, obstacle.floor_m))
    return tuple(boxes)
