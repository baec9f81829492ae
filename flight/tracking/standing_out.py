"""A body that stands out from what is behind it, by depth alone: it is still there when a detector
misses it.

Depth says that something as wide as the tracked object is where that is expected, alone, with
nothing at its depth or nearer on either side. It does not say what it is: this carries a track
between detections, and is no sighting. What lies on the ground does not stand out: the ground
beside it is as far.
"""

from __future__ import annotations

import math
from statistics import median

from drivers.interfaces import View
from flight.tracking.objects import Pixel
from path.observations import Box

NEAR = 0.12  # of the expected depth: the body's, which leans across the depths of a view from above
ESTIMATED = 0.09  # of a depth: one that is no better is of a size, and of nothing at the sample
# of the body's height in the image, above its middle: there a person is in one piece, and wide
ABOVE = 0.15
STEPS = 5  # samples across the body
LEAST_PX = 20.0  # side of a box that is asked for depth
# of its box's width: a body that is narrower one way than the other turns
_NARROWEST = 0.25
_WIDEST = 1.4
_AROUND = 2  # samples on either side, beyond where the body may be


def standing_out(
    view: View,
    expected: Pixel,
    z_m: float,
    wide: float,
    reach_px: float,
) -> tuple[Pixel, float] | None:
    """A pixel of the one body in the row of an expected pixel, in its middle from left to right,
    and the depth there.

    None where there is none, or another one near it, or it is not as wide, or what is beside it is
    not behind it.

    Args:
        z_m: depth at which it is expected.
        wide: width of its box in px, when it was seen.
        reach_px: how far it may be from where it is expected.
    """
    step = wide / STEPS
    if not step > 1.0:
        return None
    row = expected[1]
    beyond = int((0.5 * wide + reach_px) / step) + _AROUND
    side = max(LEAST_PX, 2.0 * step)
    columns = [expected[0] + k * step for k in range(-beyond, beyond + 1)]
    depths = [_depth(view, Box(u - 0.5 * side, row - 0.5 * side, side, side)) for u in columns]
    if any(each < (1.0 - NEAR) * z_m for each in depths):
        return None
    body = [k for k, each in enumerate(depths) if each <= (1.0 + NEAR) * z_m]
    if not body:
        return None
    first = body[0]
    last = body[-1]
    alone = len(body) == last - first + 1 and first > 0 and last < len(depths) - 1
    middle = 0.5 * (columns[first] + columns[last])
    if not (
        alone
        and _NARROWEST <= len(body) * step / wide <= _WIDEST
        and abs(middle - expected[0]) <= reach_px
    ):
        return None
    return (middle, row), median(depths[first : last + 1])


def _depth(view: View, box: Box) -> float:
    """The depth of a sample; infinity where the camera gives none, as of what is far."""
    depth = view.depth(box)
    return math.inf if depth is None or depth.sigma_m > ESTIMATED * depth.z_m else depth.z_m
