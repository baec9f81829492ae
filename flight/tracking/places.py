"""From a pixel and a depth to a place in the local frame, and from a pixel alone to where its ray
meets a height.
"""

from __future__ import annotations

import numpy as np

from flight.guidance import Vec3
from flight.tracking.objects import Pixel
from flight.tracking.ranging import COARSE
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth
from path.target.range import LEAST_DESCENT


def point_in_camera(
    box: Box,
    z_m: float,
    camera: CameraModel,
) -> Vec3:
    """The point at a box's centre and a depth, in the camera frame (eq. target_backprojection)."""
    x, y = camera.ray(*box.center)
    return x * z_m, y * z_m, z_m


def to_local(point_c: Vec3, T_n_c: Pose) -> Vec3:
    """Camera coordinates to local NED."""
    north, east, down = T_n_c.apply(np.asarray(point_c)).tolist()
    return north, east, down


def place(
    box: Box,
    depth: Depth,
    camera: CameraModel,
    T_n_c: Pose,
    down_m: float,
) -> Vec3:
    """Return the place of a box's object in ``n``: by its depth, or where its ray meets a height
    if that is better.

    Args:
        down_m: of the object, when it stands on the ground that the drone measures its own height
            from.
    """
    if depth.sigma_m > COARSE * depth.z_m:
        on_ground = at_height(box.center, camera, T_n_c, down_m)
        if on_ground is not None:
            return on_ground
    return to_local(point_in_camera(box, depth.z_m, camera), T_n_c)


def at_height(
    pixel: Pixel,
    camera: CameraModel,
    T_n_c: Pose,
    down_m: float,
) -> Vec3 | None:
    """Return the point at which a pixel's ray comes down to a height; None for a ray that hardly
    does.
    """
    x, y = camera.ray(*pixel)
    ray = T_n_c.R @ (x, y, 1.0)
    if ray[2] < LEAST_DESCENT:
        return None
    north, east, down = (T_n_c.t + (down_m - T_n_c.t[2]) / ray[2] * ray).tolist()
    return north, east, down
