"""How much of the ground two cameras have in common from a place. Pure.

Common views (``path.common_view``) carry D2's pose where both cameras show the same ground. Rays
through a grid over each image meet a level floor, and are looked for in the other image.
"""

from __future__ import annotations

import math

import numpy as np

from path.arrays import Array, Flags
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

COLUMNS = 8
ROWS = 6


@frozen(eq=False)
class CommonGround:
    """What D1 shows of the ground, in ``h`` (``flight.rendezvous.viewpoint``).

    Attributes:
        T_h_c: of D1's camera when it took its keyframe. ``down_m``: of the ground.
        farthest_m: beyond which depth is not used.
    """

    camera: CameraModel
    T_h_c: Pose
    down_m: float
    farthest_m: float

    def seen_by(self, camera: CameraModel, places_h: Array, R_h_c: Array) -> Array:
        """Return the share of both views that is in the other too, shape (n, k).

        In pairs of drawn views over crates, common views were found at 4 of 24 places below 0.3, at
        24 of 28 from there to 0.4, and at all of 90 above.

        Args:
            places_h: of D2's camera, (n, 3). ``R_h_c``: its attitudes at each, (n, k, 3, 3).
        """
        eyes = places_h[:, None, None]
        shown = self._met(self.T_h_c.t, _grid(self.camera) @ self.T_h_c.R.T)
        found = _within(camera, (shown - eyes) @ R_h_c, self.farthest_m)
        own = self._met(eyes, _grid(camera) @ R_h_c.swapaxes(-1, -2))
        back = _within(self.camera, (own - self.T_h_c.t) @ self.T_h_c.R, self.farthest_m)
        return np.asarray(0.5 * (found.mean(axis=-1) + back.mean(axis=-1)))

    def _met(self, eyes_h: Array, rays_h: Array) -> Array:
        """Return where rays meet the ground; NaN where they do not, or too far away.

        ``rays_h``: 1 m of depth long.
        """
        drop_m = self.down_m - eyes_h[..., 2]
        sinking = np.where(rays_h[..., 2] > 0.0, rays_h[..., 2], math.nan)
        depth = drop_m / sinking
        reached = (depth > 0.0) & (depth <= self.farthest_m)
        return np.asarray(eyes_h + np.where(reached, depth, math.nan)[..., None] * rays_h)


def _grid(camera: CameraModel) -> Array:
    """Return rays (m, 3) of depth 1 through the middles of a grid's cells."""
    across = (np.arange(COLUMNS) + 0.5) / COLUMNS * camera.width
    along = (np.arange(ROWS) + 0.5) / ROWS * camera.height
    pixels = np.stack(np.meshgrid(across, along), axis=-1).reshape(-1, 2)
    return np.column_stack([camera.rays(pixels), np.ones(len(pixels))])


def _within(camera: CameraModel, points_c: Array, farthest_m: float) -> Flags:
    """Return which points are in an image, whose lens is taken to bend nothing; NaN is in none."""
    depth = points_c[..., 2]
    u = camera.fx * points_c[..., 0] + camera.cx * depth
    v = camera.fy * points_c[..., 1] + camera.cy * depth
    beside = (u >= 0.0) & (u <= camera.width * depth)
    below = (v >= 0.0) & (v <= camera.height * depth)
    return np.asarray(beside & below & (depth > 0.0) & (depth <= farthest_m))
