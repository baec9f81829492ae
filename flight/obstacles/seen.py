"""What a drone's own depth camera sees standing about: a rolling grid of columns. Pure.

A cell is hit by what is seen well above the ground, and freed by the ground that is seen in it: what
stands there is taken to reach from the ground to any height. The grid is a torus, so that its memory
is bounded: a cell that the drone comes to again from the other side is begun anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.interfaces import View
from drivers.rig.obstacle import Obstacle
from path.arrays import Array
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box

_CELLS = 96  # along and across
_HIT = 0.9
_FREE = 0.4
_LEAST = -1.5
_MOST = 3.0
_STANDS = 1.5  # two hits
_ACROSS = 12  # boxes of an image that are asked for their depth
_DOWN = 8
_GROUND_PERCENT = 70.0  # of how low points are: most of what a camera that looks down sees
_TOP_M = 120.0  # as high as any obstacle may be
_MOST_BOXES = 20  # with more a plan takes longer than 20 ms of a core


@dataclass(slots=True)
class SeenObstacles:
    """The map of one drone, in its own coordinates.

    Attributes:
        cell_m: side of a cell.
        tall_m: what is seen so much above the ground stands in the way.
    """

    cell_m: float
    tall_m: float
    _odds: Array = field(default_factory=lambda: np.zeros((_CELLS, _CELLS)))
    _keys: Array = field(default_factory=lambda: np.full((_CELLS, _CELLS, 2), np.nan))

    def note(self, points_n_m: Array, others: Sequence[tuple[float, float, float]] = ()) -> None:
        """Take points (k, 3) of one image.

        Args:
            others: north, east and radius of what moves, whose points are no obstacles.
        """
        if not len(points_n_m):
            return
        ground_m = float(np.percentile(points_n_m[:, 2], _GROUND_PERCENT))
        above_m = ground_m - points_n_m[:, 2]
        tall = above_m > self.tall_m
        flat = np.abs(above_m) < 0.5 * self.tall_m
        for north, east, radius_m in others:
            away = np.hypot(points_n_m[:, 0] - north, points_n_m[:, 1] - east)
            tall &= away > radius_m
        keys = np.floor(points_n_m[:, :2] / self.cell_m)
        rows, columns = (keys % _CELLS).astype(int).T
        anew = np.any(self._keys[rows, columns] != keys, axis=1)
        self._odds[rows[anew], columns[anew]] = 0.0
        self._keys[rows, columns] = keys
        np.add.at(self._odds, (rows[tall], columns[tall]), _HIT)
        np.add.at(self._odds, (rows[flat], columns[flat]), -_FREE)
        np.clip(self._odds, _LEAST, _MOST, out=self._odds)

    def obstacles(self, near_m: tuple[float, float]) -> tuple[Obstacle, ...]:
        """Return what stands, as boxes of cells, those that are nearest to a place."""
        cells = {(int(n), int(e)) for n, e in self._keys[self._odds >= _STANDS].tolist()}
        boxes: list[Obstacle] = []
        while cells:
            n, e = min(cells)
            wide = 1
            while (n, e + wide) in cells:
                wide += 1
            deep = 1
            while all((n + deep, e + k) in cells for k in range(wide)):
                deep += 1
            cells -= {(n + j, e + k) for j in range(deep) for k in range(wide)}
            middle = (n + 0.5 * deep) * self.cell_m, (e + 0.5 * wide) * self.cell_m
            boxes.append(Obstacle(middle, (deep * self.cell_m, wide * self.cell_m), _TOP_M))
        boxes.sort(key=lambda box: box.distance_m((*near_m, -1.0)))
        return tuple(boxes[:_MOST_BOXES])


def points_seen(view: View, camera: CameraModel, T_n_c: Pose) -> Array:
    """Return the places (k, 3) in ``n`` of what a view's depth camera measures, box by box."""
    wide_px = camera.width / _ACROSS
    high_px = camera.height / _DOWN
    pixels: list[tuple[float, float]] = []
    depths_m: list[float] = []
    for row in range(_DOWN):
        for column in range(_ACROSS):
            box = Box(column * wide_px, row * high_px, wide_px, high_px)
            depth = view.depth(box)
            if depth is not None:
                pixels.append(box.center)
                depths_m.append(depth.z_m)
    if not pixels:
        return np.empty((0, 3))
    rays = camera.rays(np.array(pixels))
    z = np.array(depths_m)
    return T_n_c.apply(np.column_stack((rays[:, 0] * z, rays[:, 1] * z, z)))
