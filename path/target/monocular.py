"""The distance of an object of known size from its box in one image: for cameras without depth.

What is known of the target is its apparent size: the geometric mean of its box's sides times the
distance over the focal length, as a mean over the headings in which it may stand. Trying to tell
the heading from the box as well made it worse: the sides' ratio depends more on a target's shape
than on its heading (docs/decisions/0229-two-tellos.md).
"""

from __future__ import annotations

import math
from typing import Annotated

from path.bounds import Bounds
from path.camera.model import CameraModel
from path.observations import Box, Depth, Extent, RangeSource
from path.values import frozen

_LEAST_PX = 4.0
_MOST_SIGMAS = 2.0  # above its mean, the apparent size is rather that of several that touch


@frozen
class TargetSize:
    """The apparent size of the target, and how well one number describes it.

    Attributes:
        apparent_m: geometric mean of the sides of its box, in m: measured box times distance over
            focal length.
        sigma: relative standard deviation of that, over its headings and the heights from which it
            is seen.
        pixel_sigma_px: of a box's width and height.
        longest_m: the longest side that its box can have, likewise in m; a longer one is of several
            that touch. 0: not known.
    """

    apparent_m: Annotated[float, Bounds(0.02, 20.0)]
    sigma: Annotated[float, Bounds(0.001, 1.0, "of 1")] = 0.10
    pixel_sigma_px: Annotated[float, Bounds(0.01, 100.0)] = 2.0
    longest_m: Annotated[float, Bounds(0.0, 50.0)] = 0.0

    def __post_init__(self) -> None:
        for name in ("apparent_m", "sigma", "pixel_sigma_px"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name}: {getattr(self, name)!r} is not above 0")


def extent_at(
    z_m: float,
    focal_px: float,
    size: TargetSize,
) -> Extent:
    """The size in px that the box of a target of known size has at a depth."""
    usual_px = size.apparent_m * focal_px / z_m
    most_px = usual_px * (1.0 + _MOST_SIGMAS * size.sigma)
    return Extent(usual_px, most_px, size.longest_m * focal_px / z_m)


def monocular_range(
    box: Box,
    camera: CameraModel,
    size: TargetSize,
) -> Depth | None:
    """Return the depth of the middle of a target of known size, and its standard deviation.

    Along the optical axis.

    Returns:
        None for a box that the image cuts or that is too small to have a size.
    """
    if not tells_size(box, camera):
        return None
    z_m = math.sqrt(camera.fx * camera.fy / (box.w * box.h)) * size.apparent_m
    of_pixels = 0.5 * math.hypot(size.pixel_sigma_px / box.w, size.pixel_sigma_px / box.h)
    return Depth(z_m, z_m * math.hypot(size.sigma, of_pixels), RangeSource.SIZE)


def tells_size(box: Box, camera: CameraModel) -> bool:
    """Return whether a box is large enough to have a size, and the image does not cut it."""
    is_large = box.w >= _LEAST_PX and box.h >= _LEAST_PX
    is_cut = (
        box.x <= 0.0
        or box.y <= 0.0
        or box.x + box.w >= camera.width - 1
        or box.y + box.h >= camera.height - 1
    )
    return is_large and not is_cut
