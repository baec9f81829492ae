"""A keyframe from a colour and a depth image."""

from __future__ import annotations

import cv2
import numpy as np

from path.arrays import Array, Image, Singles
from path.camera.model import CameraModel
from path.common_view.features import corners, describe, surfaces
from path.common_view.keyframe import DepthGrid, Keyframe
from path.common_view.surface_kernels import registered, thinned
from path.geometry.transforms import Pose
from path.values import frozen

PATCH_OF_RANGE = 0.12
"""Side of a described patch as a share of the median distance."""


@frozen
class RgbdCamera:
    """An RGB-D camera: both lenses, without distortion, and where the colour camera is.

    Attributes:
        T_color_depth: from the depth camera's frame to the colour camera's; None: depth is
            registered to colour.
        depth_sigma_at_1m_m: standard deviation of depth at 1 m; it grows with its square.

    Raises:
        ValueError: for a lens with distortion.
    """

    color: CameraModel
    depth: CameraModel
    T_color_depth: Pose | None
    depth_sigma_at_1m_m: float

    def __post_init__(self) -> None:
        for name, lens in (("colour", self.color), ("depth", self.depth)):
            if any(lens.distortion):
                raise ValueError(
                    f"the {name} camera's lens bends: undistort its pictures, and give the lens without"
                )


@frozen
class Size:
    """How much of a look is kept.

    ``points``: at most so many corners. ``grid``: rows and columns of depth.
    """

    points: int
    grid: tuple[int, int]


SENT = Size(200, (36, 48))
"""For the link: at most 188 packets (``path.common_view.parts``). 150 corners gave 94.0 % where these
give 95, and 100 gave 91.5 (200 pairs of a kitchen, 15 to 30 degrees); with half of the depth fewer."""
OWN = Size(1000, (120, 160))
"""For the drone that solves."""


def lens_of(camera: CameraModel) -> Array:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def read_keyframe(
    color: Image,
    depth: Singles,
    camera: RgbdCamera,
    R_l_c: Array,
    gravity_sigma_rad: float,
    size: Size,
    patch_m: float | None = None,
) -> Keyframe:
    """Return the keyframe of a look, in the depth camera's frame.

    Args:
        color: (h, w) or (h, w, 3) BGR. ``depth``: (h, w) m, 0 where unknown.
        R_l_c: see ``Keyframe``; of the depth camera.
        patch_m: of the keyframe that it is to be compared with; None: by the median distance.
    """
    grey = color
    if color.ndim == 3:
        grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY), np.uint8)
    grid = DepthGrid(thinned(depth, *size.grid), grid_lens(camera.depth, size.grid))
    lens = lens_of(camera.color)
    known = grid.depth[grid.depth > 0.0]
    if patch_m is None:
        patch_m = PATCH_OF_RANGE * (float(np.median(known)) if len(known) else 1.0)
    T = camera.T_color_depth or Pose(np.eye(3), np.zeros(3))
    over = depth
    if camera.T_color_depth is not None:
        over = np.empty(grey.shape, np.float32)
        registered(depth, lens_of(camera.depth), T.R, T.t, lens, over)
    pixels = corners(grey, 2 * size.points)
    points, normals = surfaces(over, lens, pixels)
    on_surface = np.flatnonzero(points[:, 2] > 0.0)[: size.points]
    points = points[on_surface]
    normals = normals[on_surface]
    bits = (
        describe(grey, lens, R_l_c @ T.R.T, points, normals, patch_m)
        if len(points)
        else np.zeros((0, 32), np.uint8)
    )
    return Keyframe(
        R_l_c,
        grid,
        (points - T.t) @ T.R,
        bits,
        patch_m,
        camera.depth_sigma_at_1m_m,
        gravity_sigma_rad,
    )


def grid_lens(camera: CameraModel, shape: tuple[int, int]) -> Array:
    """Return the lens (4,) of a grid of depth, rows and columns, over a camera's image."""
    height, width = shape
    x = width / camera.width
    y = height / camera.height
    return np.array(
        [camera.fx * x, camera.fy * y, (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5]
    )
