"""Where things are on the ground, as one drone believes it: what the live page's map is drawn from.

Places are north and east in m, in the crew's frame: a drone's own, less what its position was off
where it was put down. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from path.camera.model import CameraModel
from path.geometry.rotation import Quat, rotate
from path.messages import Vec3
from path.values import frozen


@frozen
class Stand:
    """Where a drone is and how it is turned, at an instant of UTC; north, east, down in m."""

    utc_ns: int
    position_n_m: Vec3
    q_n_b: Quat

    def of_body(self, point_b_m: Sequence[float]) -> Vec3:
        """Return a point of the body in the drone's own north-east-down frame."""
        turned = rotate(self.q_n_b, (point_b_m[0], point_b_m[1], point_b_m[2]))
        north, east, down = (at + by for at, by in zip(self.position_n_m, turned, strict=True))
        return north, east, down


def through(rows: Sequence[float], point: Sequence[float]) -> Vec3:
    """Return a point through a pose that is logged as the upper three rows of its matrix."""
    x, y, z = (
        rows[k] * point[0] + rows[k + 1] * point[1] + rows[k + 2] * point[2] + rows[k + 3]
        for k in (0, 4, 8)
    )
    return x, y, z


def along(rows: Sequence[float], direction: Sequence[float]) -> Vec3:
    """Return a direction through the same."""
    x, y, z = (
        rows[k] * direction[0] + rows[k + 1] * direction[1] + rows[k + 2] * direction[2]
        for k in (0, 4, 8)
    )
    return x, y, z


@frozen
class Sight:
    """A line of sight through a pixel: from where, and a unit direction, north-east-down."""

    from_n_m: Vec3
    direction_n: Vec3

    @classmethod
    def of(
        cls,
        camera: CameraModel,
        T_b_c: Sequence[float],
        stand: Stand,
        pixel: tuple[float, float],
    ) -> Sight | None:
        """Return the one of a pixel; None where the lens has none."""
        # not ``ray``, which loads a compiler
        x, y = camera.rays(np.array([pixel], np.float64))[0].tolist()
        if not math.isfinite(x + y):
            return None
        length = math.hypot(x, y, 1.0)
        direction_b = along(T_b_c, (x / length, y / length, 1.0 / length))
        from_n = stand.of_body((T_b_c[3], T_b_c[7], T_b_c[11]))
        return cls(from_n, rotate(stand.q_n_b, direction_b))

    @property
    def bearing_rad(self) -> float:
        """Clockwise from north."""
        return math.atan2(self.direction_n[1], self.direction_n[0])

    def at(self, range_m: float) -> tuple[float, float]:
        """Return north and east of the place at that distance along it."""
        return (
            self.from_n_m[0] + range_m * self.direction_n[0],
            self.from_n_m[1] + range_m * self.direction_n[1],
        )

    def range_to(self, down_m: float) -> float | None:
        """Return the distance along it to where it comes down to a height; None when it does
        not.
        """
        if self.direction_n[2] <= 1e-3:
            return None
        range_m = (down_m - self.from_n_m[2]) / self.direction_n[2]
        return range_m if range_m > 0.0 else None
