"""The comparison of both boxes: D2's box in D1's image, IoU, adaptive threshold.

Paper, eqs. bbox_rescaling to instant_verification.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from path.camera.model import CameraModel
from path.config import BoxMapping, MethodConfig
from path.gate.window import Evidence
from path.geometry.rigid import Rigid, transform, transform_back
from path.messages import Vec3
from path.observations import Box, Missed, MissReason
from path.target.place import back_project


@dataclass(frozen=True, slots=True)
class Agreed:
    """A frame pair whose boxes overlap enough.

    ``count``: consecutive agreeing pairs, this one included; 0 when it ended a block that was too weak.
    ``evidence``: what the gate has with it, None when pairs are all that counts.
    """

    iou: float
    tau: float
    count: int
    evidence: Evidence | None = None


Verdict = Agreed | Missed


@dataclass(frozen=True, slots=True)
class TwoViews:
    """The calibration from before take-off: both cameras, and the mounting ``T_v_c1`` of D1's."""

    camera1: CameraModel
    camera2: CameraModel
    T_v_c1: Rigid


def map_box(
    views: TwoViews, T_v_c2: Rigid, box2: Box, depths_m: tuple[float, float], mapping: BoxMapping
) -> Box | None:
    """D2's box in D1's image (eqs. bbox_rescaling, transformed_candidate).

    One reference point goes through the inverse of the handoff geometry at the target's depth, and the size is scaled
    by focal lengths and depths. The paper's reference is the top-left corner; under a relative roll of the cameras
    about the optical axis that corner is no longer the mapped box's top-left one, the centre stays the centre.

    Args:
        box2: in D2's image, px.
        depths_m: depth of the target along D1's and along D2's optical axis.

    Returns:
        None when the reference point is behind D1 or cannot be undistorted.
    """
    camera1, camera2 = views.camera1, views.camera2
    z1, z2 = depths_m
    u2, v2 = box2.center if mapping == "center" else (box2.x, box2.y)
    point_c1 = transform_back(views.T_v_c1, transform(T_v_c2, back_project(camera2, u2, v2, z2)))
    u1, v1 = camera1.project_point(point_c1)
    if not math.isfinite(u1 + v1):
        return None
    w1 = box2.w * (camera1.fx / camera2.fx) * (z2 / z1)
    h1 = box2.h * (camera1.fy / camera2.fy) * (z2 / z1)
    if mapping == "center":
        return Box(u1 - 0.5 * w1, v1 - 0.5 * h1, w1, h1)
    return Box(u1, v1, w1, h1)


def plain_box(box: Box) -> Box:
    """The same box in Python floats: numpy's scalars, which detectors like to give, are three times slower here."""
    return Box(float(box.x), float(box.y), float(box.w), float(box.h))


def depth_in(T_v_c: Rigid, point_v: Vec3) -> float:
    """Depth in m along a camera's optical axis of a point in ``v`` (third row of eq. target_d2)."""
    return transform_back(T_v_c, point_v)[2]


def iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes, 0..1 (eq. iou_score); 0 when either is empty."""
    width = min(a.x + a.w, b.x + b.w) - max(a.x, b.x)
    height = min(a.y + a.h, b.y + b.h) - max(a.y, b.y)
    if not (width > 0.0 and height > 0.0):
        return 0.0
    common = width * height
    return min(1.0, common / (a.w * a.h + b.w * b.h - common))


def threshold(z_m: float, config: MethodConfig) -> float:
    """IoU needed for a target at viewing distance ``z_m`` (eqs. scale_factor, adaptive_threshold)."""
    scale = min(1.0, (config.z0_m / z_m) ** 2)
    return config.tau_min + (config.tau_max - config.tau_min) * scale


def compare(
    views: TwoViews, T_v_c2: Rigid, own_box: Box, own_depth_m: float, point_v: Vec3, box2: Box, config: MethodConfig
) -> tuple[Verdict, Box | None]:
    """Judge one pair (eqs. bbox_rescaling to instant_verification): the verdict, and D2's box in D1's image.

    Args:
        own_box, own_depth_m, point_v: D1's target at D2's capture instant.
        box2: D2's candidate, in D2's image.

    Returns:
        Agreed (with count 0: counting is the gate's), or Missed LOW_IOU, or Missed PRIOR_OUTSIDE and no box when the
        target is behind a camera by this geometry.
    """
    z2 = depth_in(T_v_c2, point_v)
    depths = own_depth_m, z2
    mapped = map_box(views, T_v_c2, box2, depths, config.box_mapping) if z2 > 0.0 else None
    if mapped is None:
        return Missed(MissReason.PRIOR_OUTSIDE), None
    score, tau = iou(own_box, mapped), threshold(own_depth_m, config)
    return (Agreed(score, tau, 0) if score >= tau else Missed(MissReason.LOW_IOU, score)), mapped
