"""Observations of a camera view: boxes, marker corners, depths, and the reasons when there are
none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

from path.arrays import Array
from path.values import value


@value
class Box:
    """An axis-aligned box ``(x, y, w, h)`` in px; ``x, y`` is the top-left corner, floats
    allowed.
    """

    x: float
    y: float
    w: float
    h: float

    @property
    def center(self) -> tuple[float, float]:
        return self.x + self.w / 2.0, self.y + self.h / 2.0

    @property
    def area(self) -> float:
        return self.w * self.h


def around(boxes: Sequence[Box]) -> Box:
    """The smallest box that holds them all; at least one."""
    x = min(each.x for each in boxes)
    y = min(each.y for each in boxes)
    return Box(
        x,
        y,
        max(each.x + each.w for each in boxes) - x,
        max(each.y + each.h for each in boxes) - y,
    )


def common_area(a: Box, b: Box) -> float:
    """The area in px2 that two boxes share; 0 for those that only touch."""
    wide = min(a.x + a.w, b.x + b.w) - max(a.x, b.x)
    high = min(a.y + a.h, b.y + b.h) - max(a.y, b.y)
    return wide * high if wide > 0.0 and high > 0.0 else 0.0


@value
class Extent:
    """The size that the box of one object has at some distance, in px.

    ``usual_px``, ``most_px``: of the geometric mean of its sides, as a rule and at most;
    ``longest_px``: of its longer side, at most.
    """

    usual_px: float = 0.0
    most_px: float = math.inf
    longest_px: float = math.inf


UNKNOWN = Extent()


@value
class Region:
    """A part of an image in px: ``x0 <= x < x1``, ``y0 <= y < y1``. May reach beyond the image.

    ``near_m, far_m``: how far away along the optical axis what is looked for can be.
    ``extent``: the size that the box of one such object has there, for a detector that can tell
    apart what touches. ``side_px``: the longer side that its box is expected to have, for one that
    is good at some sizes only; 0 where nobody knows.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    near_m: float = 0.0
    far_m: float = math.inf
    extent: Extent = UNKNOWN
    side_px: float = 0.0

    @property
    def any_depth(self) -> bool:
        return self.near_m <= 0.0 and self.far_m == math.inf

    def clipped(self, width: int, height: int) -> Region | None:
        """The part inside a ``width`` x ``height`` image, or None when nothing is left."""
        x0 = max(self.x0, 0.0)
        y0 = max(self.y0, 0.0)
        x1 = min(self.x1, float(width))
        y1 = min(self.y1, float(height))
        if not (x1 > x0 and y1 > y0):
            return None
        return Region(x0, y0, x1, y1, self.near_m, self.far_m, self.extent, self.side_px)

    def contains(self, u: float, v: float) -> bool:
        return self.x0 <= u < self.x1 and self.y0 <= v < self.y1


@value
class Detection:
    """A target-like object found in an image. ``score`` in 0..1."""

    box: Box
    score: float


@value
class MarkerDetection:
    """One fiducial found in an image.

    Attributes:
        marker_id: id in the dictionary of the layout.
        corners_px: shape (4, 2), distorted pixel coordinates, in the marker's own corner order
            (top-left, top-right, bottom-right, bottom-left as printed).
        covariance_px2: shape (8, 8), covariance of the corners in the order u0 v0 u1 v1 ...
    """

    marker_id: int
    corners_px: Array
    covariance_px2: Array


class RangeSource(Enum):
    """What a range rests on. Values are stable: they are logged.

    Attributes:
        DEPTH: registered depth over the box.
        SIZE: the size of the box, of an object whose size is known.
        GROUND: where the line of sight comes down to the ground, by the drone's own height.
        RANGEFINDER: the same, by a rangefinder that looks down.
        VIEWS: the other drone's line of sight and range.
    """

    DEPTH = "depth"
    SIZE = "size"
    GROUND = "ground"
    RANGEFINDER = "rangefinder"
    VIEWS = "views"


@value
class Depth:
    """The range of what is in a box: ``z_m`` along the optical axis, ``sigma_m`` its standard
    deviation.

    ``source``: what most of it rests on; robust registered depth unless it says otherwise.
    """

    z_m: float
    sigma_m: float
    source: RangeSource = RangeSource.DEPTH


class MissReason(Enum):
    """The reason why a frame pair does not count.

    Values are stable: they are logged, counted and sent over the link.
    """

    NO_TARGET = "no_target"
    AMBIGUOUS_TARGET = "ambiguous_target"
    NO_DEPTH = "no_depth"
    NO_MARKER = "no_marker"
    WRONG_MARKER = "wrong_marker"
    MARKER_TWICE = "marker_twice"
    MARKER_OBLIQUE = "marker_oblique"
    MARKER_FLIPPED = "marker_flipped"
    MARKER_TURNED = "marker_turned"
    POSE_UNCERTAIN = "pose_uncertain"
    PRIOR_OUTSIDE = "prior_outside"
    NO_CANDIDATE = "no_candidate"
    LOW_IOU = "low_iou"
    STALE = "stale"
    DUPLICATE = "duplicate"
    CLOCK = "clock"
    NO_TRACK = "no_track"
    LINK_SILENT = "link_silent"
    NON_FINITE = "non_finite"
    OCCLUDED = "occluded"  # by something nearer, as depth shows


@value
class Missed:
    """A frame, or a pair of frames, that does not count, and why.

    Attributes:
        iou: what the boxes gave, when it came to comparing them.
        ignored: the input was no new evidence at all (an old or repeated frame or packet, or a
            broken one): it leaves the count of consecutive agreements as it was, while every other
            miss restarts it.
        cause: a sentence for the crew about what is likely wrong, where that can be told.
    """

    reason: MissReason
    iou: float | None = None
    ignored: bool = False
    cause: str | None = None
