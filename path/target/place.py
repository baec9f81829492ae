"""The target's place as D1 sees it: registered depth over the box, then its point.

Paper, eqs. target_backprojection, target_virtual.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from path.arrays import Depths
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews
from path.gate.kernels import located
from path.messages import Vec3
from path.observations import Box, Depth
from path.target.kernels import middle

ENOUGH_PIXELS = 1024  # more are thinned out: neighbours share one stereo window and say the same
CORRELATED_PIXELS = 49.0  # pixels of one stereo matching window, about 7 x 7
MEDIAN_TO_MEAN = 1.2533  # standard error of a median against that of a mean


def depth_sigma(z_m: float, config: MethodConfig) -> float:
    """Return the standard deviation of stereo depth at a distance, m.

    Quadratic in it, ``depth_sigma_at_1m_m`` at 1 m.
    """
    return config.depth_sigma_at_1m_m * z_m * z_m


def registered_depth(
    depth_mm: Depths,
    box: Box,
    config: MethodConfig,
) -> Depth | None:
    """Robust depth of the target over the central part of its box.

    The median over valid pixels (not 0, within the limits), refined by the median of those near it,
    so that less than half of holes, flying pixels and background do not move it.

    Args:
        depth_mm: registered depth image, shape (h, w), z along the optical axis in millimetres, 0 =
            no measurement.
        box: the target in the same image.

    Returns:
        None when too few pixels are valid, or when they are so spread that they are not one
        surface.
    """
    patch = _central_part(depth_mm, box, config.depth_center_fraction)
    if patch is None:
        return None
    depths_mm = patch.flatten()
    limits_mm = config.min_depth_m * 1000.0, config.max_depth_m * 1000.0
    valid, spread, z_mm = middle(
        depths_mm,
        *limits_mm,
        config.depth_sigma_at_1m_m,
        np.empty(depths_mm.size),
    )
    if valid < max(config.min_depth_pixels, config.min_depth_valid * patch.size):
        return None
    if spread > 1000.0 * config.max_depth_spread_m:
        return None
    z_m = z_mm / 1000.0
    asked = box.area * config.depth_center_fraction**2 * valid / patch.size
    independent = max(1.0, asked / CORRELATED_PIXELS)
    return Depth(
        z_m,
        math.hypot(
            depth_sigma(z_m, config), MEDIAN_TO_MEAN * spread / 1000.0 / math.sqrt(independent)
        ),
    )


def _central_part(
    depth_mm: Depths,
    box: Box,
    fraction: float,
) -> Depths | None:
    """Return the pixels of the middle ``fraction`` of a box per side, thinned.

    None when the box is none or outside the image.
    """
    if not (math.isfinite(box.x + box.y + box.w + box.h) and box.w > 0.0 and box.h > 0.0):
        return None
    height, width = depth_mm.shape
    u, v = box.center
    half_w = 0.5 * fraction * box.w
    half_h = 0.5 * fraction * box.h
    left = max(0, math.ceil(u - half_w))
    right = min(width, math.floor(u + half_w) + 1)
    top = max(0, math.ceil(v - half_h))
    bottom = min(height, math.floor(v + half_h) + 1)
    if right <= left or bottom <= top:
        return None
    step = max(1, math.isqrt((right - left) * (bottom - top) // ENOUGH_PIXELS))
    return depth_mm[top:bottom:step, left:right:step]


class TargetPoint(NamedTuple):
    """Where the target is.

    In the marker frame (m), its distance along D1's optical axis (m), and its standard
    deviation (m).
    """

    point_v_m: Vec3
    z_m: float
    sigma_m: float


def back_project(
    camera: CameraModel,
    u: float,
    v: float,
    z_m: float,
) -> Vec3:
    """Return the point in the camera frame of a distorted pixel at depth ``z_m``.

    Eq. target_backprojection; NaN off the lens.
    """
    x, y = camera.ray(u, v)
    return z_m * x, z_m * y, z_m


def locate(
    views: TwoViews,
    box: Box,
    depth: Depth,
    config: MethodConfig,
) -> TargetPoint:
    """Return the target's point in ``v`` from its box and depth (eq. target_virtual).

    The box is of plain floats. NaN off the lens.
    """
    point_v_m, distance_m = located(views.numbers, *box.center, depth.z_m)
    return TargetPoint(point_v_m, depth.z_m, _point_sigma(views.camera1, distance_m, depth, config))


def across_sigma(
    camera: CameraModel,
    distance_m: float,
    config: MethodConfig,
) -> float:
    """Return the standard deviation of a target across the line of sight, m.

    Pixel noise, and the mounting's angle.
    """
    pixels = config.pixel_sigma_px / min(camera.fx, camera.fy)
    return distance_m * math.hypot(pixels, math.radians(config.mount_sigma_deg))


def _point_sigma(
    camera: CameraModel,
    distance_m: float,
    depth: Depth,
    config: MethodConfig,
) -> float:
    """Standard deviation in m of the point in ``v`` in its least certain direction.

    Along the ray there is depth noise, across it pixel noise and the mounting's angle with the
    target as its lever, and the mounting's position in both: the message carries one number, and D2
    may look from any side.
    """
    along = depth.sigma_m * distance_m / depth.z_m
    pixels_m = depth.z_m * config.pixel_sigma_px / min(camera.fx, camera.fy)
    across = math.hypot(pixels_m, math.radians(config.mount_sigma_deg) * distance_m)
    return math.hypot(max(along, across), config.mount_sigma_m)
