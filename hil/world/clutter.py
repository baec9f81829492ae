"""Crates that lie about in a world that is drawn: something for cameras to see besides the ground.

They are in nobody's way: not on the target's loop, not where drones stand, and low.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from path.messages import Vec3
from path.values import value

Point = tuple[float, float]

REACH_M = 3.0
"""They lie within this much of the target's loop."""
ASIDE_M = 0.3
"""Between a crate and what drives."""
CLEAR_M = 1.0
"""Between crates and where something stands."""
SIDES_M = (0.12, 0.5)
TRIES = 40


@value
class Crate:
    """A box with a print: east and north of its middle, its turn, its sides, and how far it is
    above the ground, m. ``look``: number of its print.
    """

    place_m: Point
    yaw_rad: float
    size_m: Vec3
    look: int
    floor_m: float = 0.0

    @property
    def half_m(self) -> float:
        """Return how far it reaches from its middle along the ground."""
        return 0.5 * math.hypot(self.size_m[0], self.size_m[1])


def crates(
    count: int,
    middle_m: Point,
    from_loop_m: Callable[[Point], float],
    standing: Sequence[Point],
    rng: np.random.Generator,
) -> tuple[Crate, ...]:
    """Return as many crates as are asked for, or as there is room for.

    Args:
        middle_m: of the target's loop. ``from_loop_m``: how far a point is from it.
        standing: where drones and parked objects are.
    """
    placed: list[Crate] = []
    for _ in range(TRIES * count):
        if len(placed) == count:
            break
        reach_m = REACH_M + from_loop_m(middle_m)
        east, north = rng.uniform(-reach_m, reach_m, 2).tolist()
        length, width, height = rng.uniform(*SIDES_M, 3).tolist()
        yaw_rad = float(rng.uniform(0.0, math.tau))
        place = (middle_m[0] + east, middle_m[1] + north)
        half_m = 0.5 * math.hypot(length, width)
        room_m = from_loop_m(place) - half_m - ASIDE_M
        free = all(math.dist(place, each) > half_m + CLEAR_M for each in standing)
        apart = all(math.dist(place, each.place_m) > half_m + each.half_m for each in placed)
        if 0.0 < room_m < REACH_M and free and apart:
            # Nothing that drives is hidden behind one from 45 degrees above.
            low_m = min(height, ASIDE_M + room_m)
            placed.append(Crate(place, yaw_rad, (length, width, low_m), len(placed)))
    return tuple(placed)
