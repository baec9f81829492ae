"""The prior of the target in D2's image: its point through D2's pose, with covariance and search region.

Paper, eqs. target_d2 to d2_projection.

The pose covariance is (6, 6), translation first (m), then rotation (rad), of ``T_c2_v`` perturbed in the camera frame:
``t <- t + dt``, ``R <- exp(dw) R`` with ``t`` untouched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.rigid import Rigid, transform
from path.geometry.transforms import Matrix
from path.messages import Vec3
from path.observations import Missed, MissReason, Region

TARGET_REACH_M = 0.3
"""From the point that D1 measured, on the side of the target that it sees, to what D2 sees of it, along D2's axis."""

Covariance2 = tuple[float, float, float]
"""Variances and covariance of a pixel, ``(uu, uv, vv)`` in px^2."""


@dataclass(frozen=True, slots=True)
class Prior:
    """The expected place of the target in D2's image.

    Attributes:
        pixel: distorted pixel of the target's point.
        depth_m: its depth along D2's optical axis.
        covariance_px2: of a box centre around that pixel.
        region: what to search, for box centres; may reach beyond the image. Its depths are for all of the target.
        target_sequence: the newest Target message it rests on.
        T_c2_v: the pose it was made with.
        pose_sigma_m: standard deviation per axis of D2's position in ``v``.
    """

    pixel: tuple[float, float]
    depth_m: float
    covariance_px2: Covariance2
    region: Region
    target_sequence: int
    T_c2_v: Rigid
    pose_sigma_m: float

    def distance2(self, u: float, v: float) -> float:
        """Squared Mahalanobis distance of a pixel from the prior."""
        uu, uv, vv = self.covariance_px2
        du, dv = u - self.pixel[0], v - self.pixel[1]
        return (vv * du * du - 2.0 * uv * du * dv + uu * dv * dv) / (uu * vv - uv * uv)


@dataclass(frozen=True, slots=True)
class Ray:
    """D1's line of sight to the target: along it the range is uncertain, across it the target is better known.

    Attributes:
        direction_v: unit vector in the marker frame.
        across_sigma_m: standard deviation per axis across it, time errors included.
    """

    direction_v: Vec3
    across_sigma_m: float


def propagate(
    camera: CameraModel,
    T_c2_v: Rigid,
    point_c: Vec3,
    covariance: Matrix,
    point_sigma_m: float,
    pixel_sigma_px: float,
    ray: Ray | None = None,
) -> tuple[Covariance2, float]:
    """Covariance of the projected point, and the standard deviation per axis (m) of D2's position in ``v``.

    Args:
        point_c: the target's point in D2's camera frame, m.
        covariance: of ``T_c2_v``, (6, 6), see the module.
        point_sigma_m: of the target's point, per axis; along ``ray`` only, when there is one.
        pixel_sigma_px: of a detector's box centre.
    """
    a, b, c, d, e, f = camera.project_point_jacobian(point_c)
    tx, ty, tz = T_c2_v[9:]
    # the rotation turns the point about the marker's origin: dX = dt + dw x q with q = R p_v
    x, y, z = point_c[0] - tx, point_c[1] - ty, point_c[2] - tz
    jacobian = np.array(
        (
            a, b, c, c * y - b * z, a * z - c * x, b * x - a * y,
            d, e, f, f * y - e * z, d * z - f * x, e * x - d * y,
            # D2's position is -R^T t, in D2's own axes it moves by -(dt - dw x t)
            1.0, 0.0, 0.0, 0.0, -tz, ty,
            0.0, 1.0, 0.0, tz, 0.0, -tx,
            0.0, 0.0, 1.0, -ty, tx, 0.0,
        )
    ).reshape(5, 6)  # fmt: skip
    rows = (jacobian @ covariance @ jacobian.T).tolist()
    point, along, pixel = point_sigma_m * point_sigma_m, 0.0, pixel_sigma_px * pixel_sigma_px
    du = dv = 0.0
    if ray is not None:
        ahead = transform(T_c2_v, ray.direction_v)
        rx, ry, rz = ahead[0] - tx, ahead[1] - ty, ahead[2] - tz
        du, dv = a * rx + b * ry + c * rz, d * rx + e * ry + f * rz
        along, point = point - ray.across_sigma_m**2, ray.across_sigma_m**2
    pixel_covariance = (
        rows[0][0] + point * (a * a + b * b + c * c) + along * du * du + pixel,
        rows[0][1] + point * (a * d + b * e + c * f) + along * du * dv,
        rows[1][1] + point * (d * d + e * e + f * f) + along * dv * dv + pixel,
    )
    return pixel_covariance, math.sqrt(max(0.0, rows[2][2] + rows[3][3] + rows[4][4]) / 3.0)


def range_sigma(T_c2_v: Rigid, point_c: Vec3, covariance: Matrix, point_sigma_m: float) -> float:
    """Standard deviation (m) of the point's depth along D2's optical axis; arguments as ``propagate``."""
    x, y = point_c[0] - T_c2_v[9], point_c[1] - T_c2_v[10]
    row = np.array((0.0, 0.0, 1.0, y, -x, 0.0))  # dX = dt + dw x q, as in ``propagate``
    return math.hypot(math.sqrt(max(0.0, float(row @ covariance @ row))), point_sigma_m)


def predict(
    camera: CameraModel,
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
        covariance: of ``T_c2_v``, (6, 6), see the module.
        point_v: the target's point in the marker frame, m.
        point_sigma_m: its standard deviation per axis, time errors included.
        box_size_at_1m_px: width and height the target's box would have at a depth of 1 m, when known; the region grows
            by half of what that is at the target's depth.
        ray: D1's line of sight, when ``point_sigma_m`` is the range's alone.

    Returns:
        Missed PRIOR_OUTSIDE when D2 cannot see the point, POSE_UNCERTAIN when the pose or the prior is too uncertain to
        be a hint, NON_FINITE when an input is not a number.
    """
    point_c = transform(T_c2_v, point_v)
    if not math.isfinite(point_c[0] + point_c[1] + point_c[2] + point_sigma_m):
        return Missed(MissReason.NON_FINITE)
    if not camera.sees(point_c):
        return Missed(MissReason.PRIOR_OUTSIDE)
    sigma_m = math.hypot(point_sigma_m, config.target_center_sigma_m)
    if ray is not None:
        ray = Ray(ray.direction_v, min(sigma_m, math.hypot(ray.across_sigma_m, config.target_center_sigma_m)))
    (uu, uv, vv), pose_sigma_m = propagate(camera, T_c2_v, point_c, covariance, sigma_m, config.pixel_sigma_px, ray)
    if not (math.isfinite(pose_sigma_m + uu + uv + vv) and uu * vv > uv * uv):
        return Missed(MissReason.NON_FINITE)
    half_u, half_v = config.search_sigmas * math.sqrt(uu), config.search_sigmas * math.sqrt(vv)
    if pose_sigma_m > config.max_pose_sigma_m or max(half_u, half_v) > config.max_search_px:
        return Missed(MissReason.POSE_UNCERTAIN)
    half_u = max(half_u + 0.5 * box_size_at_1m_px[0] / point_c[2], config.min_search_px)
    half_v = max(half_v + 0.5 * box_size_at_1m_px[1] / point_c[2], config.min_search_px)
    u, v = camera.project_point(point_c)
    reach_m = TARGET_REACH_M + config.search_sigmas * range_sigma(T_c2_v, point_c, covariance, point_sigma_m)
    region = Region(
        u - half_u, v - half_v, u + half_u, v + half_v, max(0.0, point_c[2] - reach_m), point_c[2] + reach_m
    )
    return Prior((u, v), point_c[2], (uu, uv, vv), region, target_sequence, T_c2_v, pose_sigma_m)
