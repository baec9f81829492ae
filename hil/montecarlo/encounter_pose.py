"""The marker's pose from its corners, compiled: what ``path.marker.pose.estimate_pose`` does with one marker.

The descent and the covariance are the method's own kernels (``path.marker.pose_kernels``); the two starting points come
from a homography instead of OpenCV's planar solver, and end in the same minima. A test holds both together.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import kernel
from path.marker.kernels import undistort
from path.marker.pose import (
    MIN_CORNER_SIGMA_PX,
    MIN_GRAVITY_RAD,
    MISFIT,
    SAME_RAD,
    WORST_PX,
    WORST_SHARE,
    PoseSettings,
)
from path.marker.pose_kernels import angle, covariance, facing, refine

POSE, OBLIQUE, UNCERTAIN = 0, 1, 2


class Print(NamedTuple):
    """The marker as D2 believes it to be.

    Attributes:
        corners_v: (4, 3); R_v_m (3, 3), t_v_m (3,): where it sits in ``v``.
        side_m, side_sigma: outer side, and how well it is known, relative.
    """

    corners_v: np.ndarray
    R_v_m: np.ndarray
    t_v_m: np.ndarray
    side_m: float
    side_sigma: float


class Limits(NamedTuple):
    """``PoseSettings`` as the kernel takes them."""

    gravity_weight: float
    focal_sigma: float
    max_incidence_rad: float
    max_sigma_m: float
    max_ambiguity: float

    @classmethod
    def of(cls, settings: PoseSettings) -> Limits:
        variance = settings.attitude_v_sigma_rad**2 + settings.attitude_c_sigma_rad**2
        return cls(
            1.0 / max(variance, MIN_GRAVITY_RAD**2), settings.focal_sigma, settings.max_incidence_rad,
            settings.max_sigma_m, settings.max_ambiguity,
        )  # fmt: skip


@kernel
def estimate(corners, claimed_px, printed, lens, down, limits, R, t, spread):
    """The pose of ``v`` in the camera.

    Args:
        corners: (4, 2) px; claimed_px: standard deviation of each coordinate.
        down: (6,) gravity in ``v``, gravity in the camera; all zero when it is not known.
        R, t, spread: (3, 3), (3,), (6, 6): filled.

    Returns:
        POSE, OBLIQUE or UNCERTAIN.
    """
    weight = 0.0
    for i in range(6):
        if down[i] != 0.0:
            weight = limits.gravity_weight
    scale = 1.0 / math.sqrt(claimed_px * claimed_px + MIN_CORNER_SIGMA_PX**2)
    whitening = np.zeros((1, 8, 8))
    for i in range(8):
        whitening[0, i, i] = scale
    first_R, first_t = np.empty((3, 3)), np.empty(3)
    _from_homography(corners, printed, lens, first_R, first_t)
    second_R, second_t = np.empty((3, 3)), np.empty(3)
    mirrored(first_R, first_t, printed, second_R, second_t)
    a = refine(first_R, first_t, printed.corners_v, corners, whitening, lens, down, weight)
    b = refine(second_R, second_t, printed.corners_v, corners, whitening, lens, down, weight)
    if not a[0] <= b[0]:
        a, b = b, a
    cost, best_R, best_t, information, corner_cost = a
    if not math.isfinite(cost):
        return UNCERTAIN
    incidence, _ = facing(best_R, best_t, printed.R_v_m, printed.t_v_m)
    if incidence > limits.max_incidence_rad:
        return OBLIQUE
    misfit = cost / (4.0 if weight > 0.0 else 2.0)
    misfit = misfit if misfit > MISFIT else 1.0
    ambiguity = 0.0
    if math.isfinite(b[0]) and angle(best_R, b[1]) > SAME_RAD:
        ambiguity = math.exp(-0.5 * (b[0] - cost) / misfit)
    side = 0.0
    for k in range(4):
        n = (k + 1) % 4
        side += 0.25 * math.hypot(corners[n, 0] - corners[k, 0], corners[n, 1] - corners[k, 1])
    rms_px = math.sqrt(corner_cost / 8.0) * claimed_px
    middles, sizes = printed.t_v_m.reshape(1, 3), np.array([printed.side_sigma])
    sigma_m = covariance(
        best_R, best_t, printed.corners_v, corners, middles, sizes, limits.focal_sigma, whitening, lens, down, weight,
        information, misfit, spread,
    )  # fmt: skip
    if (
        not sigma_m <= limits.max_sigma_m
        or ambiguity > limits.max_ambiguity
        or rms_px > max(WORST_PX, WORST_SHARE * side)
    ):
        return UNCERTAIN
    R[:], t[:] = best_R, best_t
    return POSE


@kernel
def mirrored(R, t, printed, out_R, out_t):
    """The pose of ``v`` whose marker faces the other way of the line of sight: about the second planar solution."""
    # the marker's centre stays where it is, and its axes turn by pi about the line to it, then about its normal
    centre, line = np.empty(3), np.empty(3)
    for i in range(3):
        centre[i] = R[i, 0] * printed.t_v_m[0] + R[i, 1] * printed.t_v_m[1] + R[i, 2] * printed.t_v_m[2] + t[i]
    far = math.sqrt(centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    for i in range(3):
        line[i] = centre[i] / far
    turn, M = np.empty((3, 3)), printed.R_v_m
    for i in range(3):
        for j in range(3):
            # R_c_m' = (2 l l^T - 1) R_c_m diag(-1, -1, 1), R_c_m = R_c_v R_v_m; then back to v
            turn[i, j] = 2.0 * line[i] * line[j] - (1.0 if i == j else 0.0)
    flip = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            flip[i, j] = -M[i, 0] * M[j, 0] - M[i, 1] * M[j, 1] + M[i, 2] * M[j, 2]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += turn[i, k] * R[k, m] * flip[m, j]
            out_R[i, j] = total
    for i in range(3):
        moved = out_R[i, 0] * printed.t_v_m[0] + out_R[i, 1] * printed.t_v_m[1] + out_R[i, 2] * printed.t_v_m[2]
        out_t[i] = centre[i] - moved


@kernel
def _from_homography(corners, printed, lens, R, t):
    """A pose of ``v`` near one of the planar solutions, from the projective map of the square to its image."""
    x, y = np.empty(4), np.empty(4)
    for k in range(4):
        u, v = corners[k, 0], corners[k, 1]
        x[k], y[k] = undistort(u, v, lens, (u - lens[2]) / lens[0], (v - lens[3]) / lens[1])
    # the unit square (top-left, top-right, bottom-right, bottom-left) to four points
    dx1, dx2, dx3 = x[1] - x[2], x[3] - x[2], x[0] - x[1] + x[2] - x[3]
    dy1, dy2, dy3 = y[1] - y[2], y[3] - y[2], y[0] - y[1] + y[2] - y[3]
    area = dx1 * dy2 - dx2 * dy1
    g, h = (dx3 * dy2 - dx2 * dy3) / area, (dx1 * dy3 - dx3 * dy1) / area
    across = (x[1] - x[0] + g * x[1], y[1] - y[0] + g * y[1], g)
    below = (x[3] - x[0] + h * x[3], y[3] - y[0] + h * y[3], h)
    corner = (x[0], y[0], 1.0)
    # metres of the marker's own frame: x right, y up, the origin in the middle
    first, second, size = np.empty(3), np.empty(3), np.zeros(2)
    for i in range(3):
        first[i], second[i] = across[i] / printed.side_m, -below[i] / printed.side_m
        size[0] += first[i] ** 2
        size[1] += second[i] ** 2
    size[0], size[1] = math.sqrt(size[0]), math.sqrt(size[1])
    scale = math.sqrt(size[0] * size[1])
    middle, sum_2, difference_2 = np.empty(3), 0.0, 0.0
    plus, minus = np.empty(3), np.empty(3)
    for i in range(3):
        middle[i] = (corner[i] + 0.5 * across[i] + 0.5 * below[i]) / scale
        plus[i], minus[i] = first[i] / size[0] + second[i] / size[1], first[i] / size[0] - second[i] / size[1]
        sum_2 += plus[i] ** 2
        difference_2 += minus[i] ** 2
    turn = np.empty((3, 3))
    for i in range(3):
        p, m = plus[i] / math.sqrt(2.0 * sum_2), minus[i] / math.sqrt(2.0 * difference_2)
        turn[i, 0], turn[i, 1] = p + m, p - m
    turn[0, 2] = turn[1, 0] * turn[2, 1] - turn[2, 0] * turn[1, 1]
    turn[1, 2] = turn[2, 0] * turn[0, 1] - turn[0, 0] * turn[2, 1]
    turn[2, 2] = turn[0, 0] * turn[1, 1] - turn[1, 0] * turn[0, 1]
    for i in range(3):
        for j in range(3):
            R[i, j] = (
                turn[i, 0] * printed.R_v_m[j, 0] + turn[i, 1] * printed.R_v_m[j, 1] + turn[i, 2] * printed.R_v_m[j, 2]
            )
    for i in range(3):
        moved = R[i, 0] * printed.t_v_m[0] + R[i, 1] * printed.t_v_m[1] + R[i, 2] * printed.t_v_m[2]
        t[i] = middle[i] - moved
