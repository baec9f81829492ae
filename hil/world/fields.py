"""Many targets on one field, each with look-alikes of its own, and what of it one place can see.

The targets are look-alikes of each other. The ``k``-th has the numbers from ``k * NUMBERS`` on,
itself the first. Only what is near a place is worked out for it: a field of any size costs a camera
the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.world.clutter import Crate
from hil.world.snapshot import ObjectTruth
from hil.world.targets import GroundVehicles, LookAlikeConfig, Point, TargetConfig
from path.arrays import Array

NUMBERS = 100
# a car farther off is a few pixels at most, above what a camera that looks down has in its image
SIGHT_M = 15.0
CELL_M = 10.0


class TargetField:
    """The traffic around each of several targets. Pure functions of time, but for the look-alikes
    sent so far.

    Args:
        starts: of each target its place (E, N), in m, and how many seconds later than the others it
            drives off.
        seeds: one for each.
    """

    def __init__(
        self,
        target: TargetConfig,
        look_alikes: LookAlikeConfig,
        starts: Sequence[tuple[Point, float]],
        keep_clear: Sequence[Point],
        seeds: Sequence[np.random.SeedSequence],
    ) -> None:
        """Raise ValueError when there is no room."""
        reach_m = target.radius_m + look_alikes.max_distance_m
        self._reach_m = reach_m + SIGHT_M + CELL_M
        near_m = math.inf if len(starts) == 1 else reach_m + CELL_M
        self.starts = [start for start, _ in starts]
        self._traffic = [
            GroundVehicles(
                replace(target, start_m=start, start_time_s=target.start_time_s + later_s),
                look_alikes,
                [home for home in keep_clear if math.dist(home, start) <= near_m],
                own,
                number * NUMBERS,
            )
            for number, ((start, later_s), own) in enumerate(zip(starts, seeds, strict=True))
        ]
        self._now: list[tuple[float, tuple[ObjectTruth, ...]]] = [(-1.0, ())] * len(starts)
        self._cells: dict[tuple[int, int], tuple[int, ...]] = {}

    def crates(self, count: int, homes: Sequence[Point], seed: int) -> tuple[Crate, ...]:
        """Return crates beside the way of the first target."""
        return self._traffic[0].crates(count, homes, seed)

    @property
    def ways(self) -> Array:
        """Return places (n, 2), E and N, of where anything drives or is parked."""
        return np.vstack([each.ways for each in self._traffic])

    def target(self, number: int, time_s: float) -> ObjectTruth:
        return self._at(number, time_s)[0]

    def near(self, place_m: Point, time_s: float) -> tuple[ObjectTruth, ...]:
        """Everything that may be seen from above a place (E, N)."""
        cell = math.floor(place_m[0] / CELL_M), math.floor(place_m[1] / CELL_M)
        there = self._cells.get(cell)
        if there is None:
            middle = ((cell[0] + 0.5) * CELL_M, (cell[1] + 0.5) * CELL_M)
            there = tuple(
                k
                for k, start in enumerate(self.starts)
                if math.dist(start, middle) <= self._reach_m
            )
            self._cells[cell] = there
        return tuple(thing for k in there for thing in self._at(k, time_s))

    def all(self, time_s: float) -> tuple[ObjectTruth, ...]:
        """Everything on the whole field."""
        return tuple(thing for k in range(len(self.starts)) for thing in self._at(k, time_s))

    def send_lookalike(self, number: int, now_s: float) -> None:
        """Past one of the targets."""
        self._traffic[number].send_lookalike(now_s)
        self._now[number] = (-1.0, ())

    def _at(self, number: int, time_s: float) -> tuple[ObjectTruth, ...]:
        known_s, things = self._now[number]
        if known_s != time_s:
            things = self._traffic[number].at(time_s)
            self._now[number] = time_s, things
        return things
