"""The shortest way along the ground around what stands there: over the corners of grown shapes,
whose ways to each other are worked out once. Pure.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from flight.obstacles.shapes import COLUMNS, corners, crossed, level_m
from path.arrays import Array

_SLACK_M = 1e-6
_THERE_M = 0.01
Place = tuple[float, float]


def first_leg(
    rows: Array, here_m: Place, there_m: Place, clear_m: float, site: Array | None = None
) -> tuple[Place, float]:
    """Return where the way's first leg leads, and the length of the whole way.

    A drone, or a place, that is nearer to a shape than its clearance already keeps the distance
    that it has. Where there is no way it is the one to the corner that is nearest to the goal.

    Args:
        rows: shapes in the way, (m, COLUMNS).
        site: rows of the walls of a site, which are crossed nowhere.
    """
    walls = rows if site is None else np.concatenate((rows, site))
    ends = np.array([here_m, there_m])
    kept_m = np.clip(level_m(walls, ends).min(axis=0) - _SLACK_M, 0.0, clear_m)
    if not crossed(walls, kept_m, ends[:1], ends[1:])[0]:
        return there_m, math.dist(here_m, there_m)
    turns, between_m = _corner_ways(walls.tobytes(), clear_m)
    if not len(turns):
        return here_m, 0.0
    first_m = _seen_m(walls, kept_m, ends[0], turns)
    last_m = _seen_m(walls, kept_m, ends[1], turns)
    way_m = first_m[:, None] + between_m + last_m
    if not np.isfinite(way_m).any():
        left_m = np.hypot(*(turns - ends[1]).T)
        reached = np.isfinite(first_m[:, None] + between_m).any(axis=0)
        if not reached.any():
            return here_m, 0.0
        goal = int(np.argmin(np.where(reached, left_m, np.inf)))
        way_m = first_m[:, None] + between_m[:, goal : goal + 1]
    turn = int(np.argmin(way_m.min(axis=1)))
    north, east = turns[turn].tolist()
    return (north, east), float(way_m.min())


def _seen_m(walls: Array, kept_m: Array, place: Array, turns: Array) -> Array:
    """Return how far corners (v, 2) are from a place; infinite where something is between, and for
    one where it is already.
    """
    far_m = np.hypot(*(turns - place).T)
    between = crossed(walls, kept_m, np.broadcast_to(place, turns.shape), turns)
    return np.where(between | (far_m < _THERE_M), np.inf, far_m)


@lru_cache(16)
def _corner_ways(walls: bytes, clear_m: float) -> tuple[Array, Array]:
    """Return the corners at which ways bend, (v, 2), and the shortest ways between them, (v, v);
    infinite where there is none.
    """
    rows = np.frombuffer(walls).reshape(-1, COLUMNS)
    turns = corners(rows, clear_m)
    turns = turns[np.all(level_m(rows, turns) >= clear_m, axis=1)]
    kept_m = np.full(len(rows), clear_m)
    ways_m = np.zeros((len(turns), len(turns)))
    for turn, row in zip(turns, ways_m, strict=True):
        row[:] = _seen_m(rows, kept_m, turn, turns)
    np.fill_diagonal(ways_m, 0.0)
    for over in range(len(turns)):
        ways_m = np.minimum(ways_m, ways_m[:, over : over + 1] + ways_m[over])
    return turns, ways_m
