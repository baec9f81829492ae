"""Depth in another unit than millimetres: a target that is much farther off by its depth than by
its size says so.

RGB-D data of others have 5000 steps a metre (TUM, BONN), 0.1 mm a step (a D405), metres; all are
16-bit PNGs.
"""

from __future__ import annotations

import numpy as np

from drivers.interfaces import Framed, View
from path.arrays import Depths
from path.camera.model import CameraModel
from path.observations import Box
from path.values import frozen

# times as far: sizes are known no better, and a box may show a target's narrow side
MOST = 2.5
LEAST = 0.3
REMEDY = "say depth_unit_mm of the film (0.2 with 5000 steps a metre, 0.1 of a D405), or correct the rig's sizes"


@frozen
class DepthAgainstSize:
    """How far a target is by its depth and by its size, m."""

    by_depth_m: float
    by_size_m: float

    @property
    def is_contradiction(self) -> bool:
        return not LEAST <= self.times <= MOST

    @property
    def times(self) -> float:
        return self.by_depth_m / self.by_size_m

    @property
    def text(self) -> str:
        ranges = f"its depth says {self.by_depth_m:.2f} m and its size {self.by_size_m:.2f} m"
        return f"{ranges}: {self.times:.2g} times as far; are these millimetres?"


def depth_against_size(
    view: View,
    box: Box,
    camera: CameraModel,
    side_m: float,
) -> DepthAgainstSize | None:
    """Return how far a target is by each; None where there is no depth at all.

    Args:
        side_m: how large it is across, about.
    """
    if not isinstance(view, Framed) or view.frame.depth_mm is None:
        return None
    depth_mm = view.frame.depth_mm
    left = max(round(box.x + 0.25 * box.w), 0)
    top = max(round(box.y + 0.25 * box.h), 0)
    right = round(box.x + 0.75 * box.w) + 1
    bottom = round(box.y + 0.75 * box.h) + 1
    inner = depth_mm[top:bottom, left:right]
    measured = inner[inner > 0]
    if not measured.size:
        return None
    across_px = max(box.w / camera.fx, box.h / camera.fy)
    return DepthAgainstSize(float(np.median(measured)) / 1000.0, side_m / max(across_px, 1e-9))


def in_millimetres(depth: Depths | None, unit_mm: float) -> Depths | None:
    """Return depth in mm, 0 where there is none or where it is farther than can be said."""
    if depth is None or unit_mm == 1.0:
        return depth
    millimetres = np.round(depth.astype(np.float64) * unit_mm)
    return np.where(millimetres < 65536.0, millimetres, 0.0).astype(np.uint16)
