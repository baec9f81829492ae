"""The tilt of a drone as it hovers: wind tilts it, and with it a camera that is fixed to it."""

from __future__ import annotations

import numpy as np

from flight.guidance import Vec3, add, from_heading, limit, scale, subtract
from path.arrays import Array
from path.geometry.transforms import Matrix

_SHARE = 0.03  # of each frame
_FARTHEST_M = 1.0


class Tilt:
    """A drone's own z axis in ``n``, smoothed over a second or two: gusts pass, wind stays."""

    def __init__(self) -> None:
        self.down_n: Vec3 = (0.0, 0.0, 1.0)

    def note(self, R_n_b: Matrix) -> None:
        """Its attitude in a frame."""
        north, east, down = R_n_b[:, 2].tolist()
        self.down_n = add(scale(self.down_n, 1.0 - _SHARE), scale((north, east, down), _SHARE))

    def aim(
        self,
        axis_b: Vec3,
        heading_rad: float,
        below_m: float,
    ) -> Vec3:
        """Return how much farther to one side a drone has to be for its camera to look where a
        level one would.

        Args:
            axis_b: of the camera, in the body; it looks downward.
            below_m: how far below the drone the place is that it looks at.

        Returns:
            In ``n``, level.
        """
        level = from_heading(axis_b, heading_rad)
        north, east, down = (tilted(np.array(self.down_n)) @ level).tolist()
        # it looks at the horizon: the tilt leads to no place on the ground
        if down < 0.1 or level[2] < 0.1:
            return 0.0, 0.0, 0.0
        farther = subtract(
            scale(level, below_m / level[2]), scale((north, east, down), below_m / down)
        )
        return limit((farther[0], farther[1], 0.0), _FARTHEST_M)


def tilted(down: Array) -> Matrix:
    """The smallest rotation that takes the vertical, (0, 0, 1), to a drone's own z axis (of any
    length), (3, 3).
    """
    x, y, z = (down / np.linalg.norm(down)).tolist()
    k = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, z]]
    )
