"""The prior of the target in D2's image: its point through D2's pose, with covariance and search
region.

Paper, eqs. target_d2 to d2_projection.

The pose covariance is (6, 6), translation first (m), then rotation (rad), of ``T_c2_v`` perturbed
in the camera frame: ``t <- t + dt``, ``R <- exp(dw) R`` with ``t`` untouched.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from path.config import MethodConfig
from path.cycle.kernels import Array, Covariance2, projected
from path.geometry.rigid import Rigid
from path.geometry.transforms import Matrix
from path.messages import Vec3
from path.observations import Missed, MissReason, Region
from path.values import value

TARGET_REACH_M = 0.3
"""From the point that D1 measured, on the side of the target that it sees, to what D2 sees of it,
along D2's axis.
"""

AHEAD: Vec3 = (0.0, 0.0, 1.0)
EVENLY = -1.0  # a point that is known alike in all directions


class Prior(NamedTuple):
    """The expected place of the target in D2's image.

    Attributes:
        pixel: distorted pixel of the target's point.
        depth_m: its depth along D2's optical axis.
        covariance_px2: of a box centre around that pixel: variances and covariance ``(uu, uv,
            vv)``.
        region: what to search, for box centres; may reach beyond the image. Its depths are for all
            of the target.
        target_sequence: the newest Target message it rests on.
        T_c2_v: the pose it was made with.
        pose_sigma_m: standard deviation per axis of D2's position in ``v``.
        point_v_m: the target's point then.
    """

    pixel: tuple[float, float]
    depth_m: float
    covariance_px2: Covariance2
    region: Region
    target_sequence: int
    T_c2_v: Rigid
    pose_sigma_m: float
    point_v_m: Vec3

    def distance2(self, u: float, v: float) -> float:
        """Squared Mahalanobis distance of a pixel from the prior."""
        uu, uv, vv = self.covariance_px2
        du = u - self.pixel[0]
        dv = v - self.pixel[1]
        return (vv * du * du - 2.0 * uv * du * dv + uu * dv * dv) / (uu * vv - uv * uv)


@value
class Ray:
    """D1's line of sight to the target.

    Along it the range is uncertain, across it the target is better known.

    Attributes:
        direction_v: unit vector in the marker frame.
        across_sigma_m: standard deviation per axis across it, time errors included.
    """

    direction_v: Vec3
    across_sigma_m: float


def predict(
    lens: Array,
    T_c2_v: Rigid,
    covariance: Matrix,
    point_v: Vec3,
    point_sigma_m: float,
    target_sequence: int,
    config: MethodConfig,
    box_size_at_1m_px: tuple[float, float] = (0.0, 0.0),
    ray: Ray | None = None,
) -> Prior | Missed:
    """The prior of the target's box centre in D2's image.

    Args:
        lens: of D2's camera (``path.camera.kernels.lens_of``).
        covariance: of ``T_c2_v``, (6, 6), see the module.
        point_v: the target's point in the marker frame, m.
        point_sigma_m: its standard deviation per axis, time errors included.
        box_size_at_1m_px: width and height the target's box would have at a depth of 1 m, when
            known; the region grows by half of what that is at the target's depth.
        ray: D1's line of sight, when ``point_sigma_m`` is the range's alone.

    Returns:
        Missed PRIOR_OUTSIDE when D2 cannot see the point, POSE_UNCERTAIN when the pose or the prior
        is too uncertain to be a hint, NON_FINITE when an input is not a number.
    """
    sigma_m = math.hypot(point_sigma_m, config.target_center_sigma_m)
    way_v = AHEAD
    across_m = EVENLY
    if ray is not None:
        way_v = ray.direction_v
        across_m = min(sigma_m, math.hypot(ray.across_sigma_m, config.target_center_sigma_m))
    u, v, z_m, (uu, uv, vv), pose_sigma_m, range_sigma_m = projected(
        lens, T_c2_v, np.array(covariance, np.float64, order="C"), point_v, sigma_m, config.pixel_sigma_px, way_v,
        across_m,
    )  # fmt: skip
    if not math.isfinite(z_m + point_sigma_m):
        return Missed(MissReason.NON_FINITE)
    if math.isnan(u):
        return Missed(MissReason.PRIOR_OUTSIDE)
    if not (math.isfinite(pose_sigma_m + uu + uv + vv) and uu * vv > uv * uv):
        return Missed(MissReason.NON_FINITE)
    half_u = config.search_sigmas * math.sqrt(uu)
    half_v = config.search_sigmas * math.sqrt(vv)
    if pose_sigma_m > config.max_pose_sigma_m or max(half_u, half_v) > config.max_search_px:
        return Missed(MissReason.POSE_UNCERTAIN)
    half_u = max(half_u + 0.5 * box_size_at_1m_px[0] / z_m, config.min_search_px)
    half_v = max(half_v + 0.5 * box_size_at_1m_px[1] / z_m, config.min_search_px)
    body = config.evidence
    side_m = max(body.span_m, body.height_m)
    side_px = max(box_size_at_1m_px) / z_m or side_m * float(lens[0]) / z_m
    reach_m = TARGET_REACH_M + config.search_sigmas * math.hypot(range_sigma_m, point_sigma_m)
    region = Region(
        u - half_u,
        v - half_v,
        u + half_u,
        v + half_v,
        max(0.0, z_m - reach_m),
        z_m + reach_m,
        side_px=side_px,
    )
    return Prior((u, v), z_m, (uu, uv, vv), region, target_sequence, T_c2_v, pose_sigma_m, point_v)
