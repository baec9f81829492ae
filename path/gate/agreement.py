"""The comparison of both boxes: D2's box in D1's image, IoU, adaptive threshold.

Paper, eqs. bbox_rescaling to instant_verification.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import NamedTuple

from path.camera.model import CameraModel
from path.config import BoxMapping, MethodConfig
from path.gate import kernels
from path.gate.window import Evidence, Offset
from path.geometry.rigid import Rigid, transform_back
from path.messages import Candidate, Vec3
from path.observations import Box, Missed
from path.timeline import Values
from path.values import frozen, value


@value
class Agreed:
    """A frame pair whose boxes overlap enough.

    ``count``: consecutive agreeing pairs, this one included; 0 when it ended a block that was too
    weak. ``evidence``: what the gate has with it, None when pairs are all that counts.
    """

    iou: float
    tau: float
    count: int
    evidence: Evidence | None = None


Verdict = Agreed | Missed


@frozen
class TwoViews:
    """The calibration from before take-off: both cameras, and the mounting ``T_v_c1`` of D1's.

    ``numbers``: all of it as the kernels take it.
    """

    camera1: CameraModel
    camera2: CameraModel
    T_v_c1: Rigid
    numbers: kernels.Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "numbers",
            kernels.numbers_of(self.camera1, self.camera2, self.T_v_c1),
        )


def map_box(
    views: TwoViews,
    T_v_c2: Rigid,
    box2: Box,
    depths_m: tuple[float, float],
    mapping: BoxMapping,
) -> Box | None:
    """D2's box in D1's image (eqs. bbox_rescaling, transformed_candidate).

    One reference point goes through the inverse of the handoff geometry at the target's depth, and
    the size is scaled by focal lengths and depths. The paper's reference is the top-left corner;
    under a relative roll of the cameras about the optical axis that corner is no longer the mapped
    box's top-left one, the centre stays the centre.

    Args:
        box2: in D2's image, px.
        depths_m: depth of the target along D1's and along D2's optical axis.

    Returns:
        None when the reference point is behind D1 or cannot be undistorted.
    """
    corner = 0.0 if mapping == "center" else 1.0
    u1, v1, w1, h1 = kernels.mapped(
        views.numbers,
        T_v_c2,
        (box2.x, box2.y, box2.w, box2.h),
        *depths_m,
        corner,
    )
    return Box(u1, v1, w1, h1) if math.isfinite(u1 + v1) else None


def plain_box(box: Box) -> Box:
    """Return the same box in Python floats.

    numpy's scalars, which detectors like to give, are three times slower here.
    """
    if type(box.x) is type(box.y) is type(box.w) is type(box.h) is float:
        return box
    return Box(float(box.x), float(box.y), float(box.w), float(box.h))


def depth_in(T_v_c: Rigid, point_v: Vec3) -> float:
    """Depth in m along a camera's optical axis of a point in ``v`` (third row of eq. target_d2)."""
    return transform_back(T_v_c, point_v)[2]


def iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes, 0..1 (eq. iou_score); 0 when either is empty."""
    return float(kernels.overlap(a.x, a.y, a.w, a.h, b.x, b.y, b.w, b.h))


def threshold(z_m: float, config: MethodConfig) -> float:
    """Return the IoU needed for a target at ``z_m`` (eqs. scale_factor, adaptive_threshold)."""
    scale = min(1.0, (config.z0_m / z_m) ** 2)
    return config.tau_min + (config.tau_max - config.tau_min) * scale


class Comparison(NamedTuple):
    """The result of a box of D2 held against D1's target.

    Attributes:
        mapped: D2's box in D1's image; None when the target is behind a camera by this geometry.
        iou: of it and D1's own; means nothing without it, as ``placed_iou`` and ``sides_m``.
        offset_m: of its middle from where the target has it; None when that cannot be told.
        placed_iou: the overlap with a box so far off, where a body of the stated size has its
            middle.
        range_m: of the target along D2's optical axis.
        sides_m: D2's box, width and height at that range.
        larger: how many times larger one of them is than the stated size allows; NaN where none is
            stated.
    """

    mapped: Box | None
    iou: float
    offset_m: Offset | None
    placed_iou: float
    range_m: float
    sides_m: tuple[float, float]
    larger: float


class Comparer:
    """Compares the boxes of a pair (eqs. bbox_rescaling to iou_score)."""

    def __init__(self, views: TwoViews, config: MethodConfig) -> None:
        self._views = views.numbers
        self._body = config.evidence.span_m, config.evidence.height_m
        self._corner = 0.0 if config.box_mapping == "center" else 1.0

    def compare(
        self,
        own: Values,
        candidate: Candidate,
        box2: Box,
    ) -> Comparison:
        """Return the outcome of ``box2``, the candidate's.

        ``own``: D1's sample at D2's capture instant.
        """
        box = box2.x, box2.y, box2.w, box2.h
        mapped, score, (dx, dy), placed, range_m, (wide_m, high_m, larger) = kernels.judged(
            self._views,
            self._body,
            self._corner,
            own,
            candidate.rotation_v_c2,
            candidate.position_v_m,
            box,
        )
        return Comparison(
            Box(*mapped) if math.isfinite(mapped[0] + mapped[1]) else None,
            score,
            None if math.isnan(dx) else (dx, dy),
            placed,
            range_m,
            (wide_m, high_m),
            larger,
        )
