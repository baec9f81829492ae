"""Compiled parts of ``path.marker.pose``: residuals, the descent from one solution, the covariance
at its end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from path.compiled import inner, kernel
from path.marker.kernels import (
    Array,
    cholesky,
    cholesky_solve,
    distort,
    exp_times,
    finite,
    identity,
    inverse,
)

ITERATIONS = 12
CONVERGED = 1e-9
SAME_RAD = 0.05  # two solutions nearer than this are one
CAUSES = 4  # of errors that all corners share, see ``pulled``
MISFIT = 3.0  # chi-square per degree of freedom above which it enlarges the covariance


@kernel
def of_layout(turns: Array, shifts: Array, R_v_m: Array, t_v_m: Array) -> tuple[Array, Array]:
    """Poses of ``v`` in the camera, (n, 3, 3) and (n, 3), from those of a marker in it.

    Args:
        turns, shifts: (k, 3, 1), rotation vectors and translations as OpenCV gives them. What is no
            pose, or of a marker behind the camera, is left out.
    """
    many = 0
    all_R = np.empty((turns.shape[0], 3, 3))
    all_t = np.empty((turns.shape[0], 3))
    turn = np.empty(3)
    level = identity(3)
    for k in range(turns.shape[0]):
        R = all_R[many]
        t = all_t[many]
        for i in range(3):
            turn[i] = turns[k, i, 0]
        R_c_m = exp_times(turn, level)
        for i in range(3):
            for j in range(3):
                R[i, j] = (
                    R_c_m[i, 0] * R_v_m[j, 0]
                    + R_c_m[i, 1] * R_v_m[j, 1]
                    + R_c_m[i, 2] * R_v_m[j, 2]
                )
        for i in range(3):
            t[i] = shifts[k, i, 0] - (R[i, 0] * t_v_m[0] + R[i, 1] * t_v_m[1] + R[i, 2] * t_v_m[2])
        if shifts[k, 2, 0] > 0.0 and finite(R):
            many += 1
    return all_R[:many], all_t[:many]


@kernel
def facing(R: Array, t: Array, R_v_m: Array, t_v_m: Array) -> tuple[float, Array]:
    """Angle between a marker's normal and the line of sight, and the marker's centre (3,) in the
    camera.
    """
    centre = np.empty(3)
    along = 0.0
    for i in range(3):
        centre[i] = R[i, 0] * t_v_m[0] + R[i, 1] * t_v_m[1] + R[i, 2] * t_v_m[2] + t[i]
        along -= centre[i] * (R[i, 0] * R_v_m[0, 2] + R[i, 1] * R_v_m[1, 2] + R[i, 2] * R_v_m[2, 2])
    cosine = along / math.sqrt(
        centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2]
    )
    return math.acos(min(1.0, max(-1.0, cosine))), centre


@inner
def angle(R_a: Array, R_b: Array) -> float:
    """Return the angle of the rotation from one to the other, rad."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += R_a[i, j] * R_b[i, j]
    return math.acos(min(1.0, max(-1.0, 0.5 * (total - 1.0))))


@inner
def linearize(
    R: Array, t: Array, points: Array, pixels: Array, whitening: Array, lens: Array, down: Array, weight: float,
    residuals: Array, jacobian: Array,
) -> float:  # fmt: skip
    """Whitened residuals (8 a marker, then 3 of gravity) and their Jacobian by (dt, dw); returns
    the corners' cost.
    """
    markers = whitening.shape[0]
    raw = np.empty(8)
    slope = np.empty((8, 6))
    cost = 0.0
    for m in range(markers):
        for c in range(4):
            i = 4 * m + c
            qx = R[0, 0] * points[i, 0] + R[0, 1] * points[i, 1] + R[0, 2] * points[i, 2]
            qy = R[1, 0] * points[i, 0] + R[1, 1] * points[i, 1] + R[1, 2] * points[i, 2]
            qz = R[2, 0] * points[i, 0] + R[2, 1] * points[i, 1] + R[2, 2] * points[i, 2]
            z = qz + t[2]
            if z < 1e-3:
                return np.inf
            x = (qx + t[0]) / z
            y = (qy + t[1]) / z
            u, v, ux, uy, vx, vy = distort(x, y, lens)
            raw[2 * c], raw[2 * c + 1] = u - pixels[i, 0], v - pixels[i, 1]
            for k in range(2):
                gx, gy = (ux, uy) if k == 0 else (vx, vy)
                a = gx / z
                b = gy / z
                d = -(gx * x + gy * y) / z
                row = slope[2 * c + k]
                row[0], row[1], row[2] = a, b, d
                # dX = dw x q
                row[3], row[4], row[5] = d * qy - b * qz, a * qz - d * qx, b * qx - a * qy
        for r in range(8):
            value = 0.0
            for s in range(r + 1):
                value += whitening[m, r, s] * raw[s]
            residuals[8 * m + r] = value
            cost += value * value
            for k in range(6):
                total = 0.0
                for s in range(r + 1):
                    total += whitening[m, r, s] * slope[s, k]
                jacobian[8 * m + r, k] = total
    root = math.sqrt(weight)
    base = 8 * markers
    gx = R[0, 0] * down[0] + R[0, 1] * down[1] + R[0, 2] * down[2]
    gy = R[1, 0] * down[0] + R[1, 1] * down[1] + R[1, 2] * down[2]
    gz = R[2, 0] * down[0] + R[2, 1] * down[1] + R[2, 2] * down[2]
    residuals[base], residuals[base + 1], residuals[base + 2] = (
        root * (gx - down[3]), root * (gy - down[4]), root * (gz - down[5]),
    )  # fmt: skip
    jacobian[base, 4], jacobian[base, 5] = root * gz, -root * gy
    jacobian[base + 1, 3], jacobian[base + 1, 5] = -root * gz, root * gx
    jacobian[base + 2, 3], jacobian[base + 2, 4] = root * gy, -root * gx
    return cost


@inner
def normal(jacobian: Array, residuals: Array, information: Array, gradient: Array) -> float:
    """Information ``J^T J`` (6, 6) and ``-J^T r`` (6,) into their places; returns the cost ``r^T
    r``.
    """
    cost = 0.0
    for i in range(6):
        gradient[i] = 0.0
        for j in range(6):
            information[i, j] = 0.0
    for r in range(residuals.shape[0]):
        cost += residuals[r] * residuals[r]
        for i in range(6):
            gradient[i] -= jacobian[r, i] * residuals[r]
            for j in range(6):
                information[i, j] += jacobian[r, i] * jacobian[r, j]
    return cost


@inner
def refine(
    start_R: Array, start_t: Array, points: Array, pixels: Array, whitening: Array, lens: Array, down: Array,
    weight: float,
) -> tuple[float, Array, Array, Array, float]:  # fmt: skip
    """Levenberg-Marquardt from one solution: cost, pose, information (6, 6) and the corners' share
    of the cost.
    """
    turn = start_R
    shift = start_t
    rows = 8 * whitening.shape[0] + 3
    residuals = np.zeros(rows)
    jacobian = np.zeros((rows, 6))
    information = np.zeros((6, 6))
    gradient = np.zeros(6)
    tried_information = np.zeros((6, 6))
    tried_gradient = np.zeros(6)
    factor = np.zeros((6, 6))
    corners = linearize(
        turn, shift, points, pixels, whitening, lens, down, weight, residuals, jacobian
    )
    cost = normal(jacobian, residuals, information, gradient) if corners < np.inf else np.inf
    damping = 1e-6
    for _ in range(ITERATIONS):
        if not cost < np.inf:
            break
        step = gradient.copy()
        shifted = shift.copy()
        for i in range(6):
            for j in range(6):
                factor[i, j] = information[i, j]
            factor[i, i] += damping * information[i, i] + 1e-12
        if not cholesky(factor):
            break
        cholesky_solve(factor, step)
        for i in range(3):
            shifted[i] += step[i]
        turned = exp_times(step[3:], turn)
        corners_new = linearize(
            turned, shifted, points, pixels, whitening, lens, down, weight, residuals, jacobian
        )
        cost_new = (
            normal(jacobian, residuals, tried_information, tried_gradient)
            if corners_new < np.inf
            else np.inf
        )
        if cost_new <= cost:
            done = cost - cost_new < CONVERGED * (1.0 + cost)
            turn = turned
            shift = shifted
            cost = cost_new
            corners = corners_new
            information, tried_information = tried_information, information
            gradient, tried_gradient = tried_gradient, gradient
            damping = max(1e-9, 0.1 * damping)
            if done:
                break
        else:
            damping = 1e-4 if damping < 1e-5 else 10.0 * damping
            if damping > 1e8:
                break
    return cost, turn, shift, information, corners


@inner
def pulled(
    R: Array, t: Array, points: Array, pixels: Array, middles: Array, sizes: Array, focal: float, shape: float,
    whitening: Array, lens: Array, jacobian: Array, pulls: Array,
) -> None:  # fmt: skip
    """Compute how corners pull the pose, ``J^T W du``, when all of them are wrong together; into
    ``pulls`` (4, 6).

    By one standard deviation each: the print's size, the focal length, the image's width against
    its height, its skew.

    Args:
        middles, sizes: (m, 3) centre of each marker in ``v``, (m,) standard deviation of its side,
            relative. All prints err together: they come from one printer.
        focal, shape: relative standard deviations, of the focal length, and of width against height
            and of skew.
        jacobian: of ``linearize``, at this pose.
    """
    moved = np.empty((CAUSES, 8))
    u0 = 0.0
    v0 = 0.0
    for i in range(pixels.shape[0]):
        u0 = u0 + pixels[i, 0] / pixels.shape[0]
        v0 = v0 + pixels[i, 1] / pixels.shape[0]
    for cause in range(CAUSES):
        for k in range(6):
            pulls[cause, k] = 0.0
    for m in range(whitening.shape[0]):
        for c in range(4):
            p = points[4 * m + c]
            qx = R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0]
            qy = R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1]
            qz = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
            x = qx / qz
            y = qy / qz
            u, v, ux, uy, vx, vy = distort(x, y, lens)
            ox = p[0] - middles[m, 0]
            oy = p[1] - middles[m, 1]
            oz = p[2] - middles[m, 2]
            z = R[2, 0] * ox + R[2, 1] * oy + R[2, 2] * oz
            dx = (R[0, 0] * ox + R[0, 1] * oy + R[0, 2] * oz - x * z) / qz
            dy = (R[1, 0] * ox + R[1, 1] * oy + R[1, 2] * oz - y * z) / qz
            i = 2 * c
            j = 2 * c + 1
            moved[0, i], moved[0, j] = (
                sizes[m] * (ux * dx + uy * dy),
                sizes[m] * (vx * dx + vy * dy),
            )
            moved[1, i], moved[1, j] = focal * (u - lens[2]), focal * (v - lens[3])
            moved[2, i], moved[2, j] = shape * (u - u0), shape * (v0 - v)
            moved[3, i], moved[3, j] = shape * (v - v0), shape * (u - u0)
        for cause in range(CAUSES):
            for r in range(8):
                white = 0.0
                for s in range(r + 1):
                    white += whitening[m, r, s] * moved[cause, s]
                for k in range(6):
                    pulls[cause, k] += jacobian[8 * m + r, k] * white


@inner
def covariance(
    R: Array, t: Array, points: Array, pixels: Array, middles: Array, sizes: Array, focal: float, shape: float,
    whitening: Array, lens: Array, down: Array, weight: float, information: Array, misfit: float, out: Array,
) -> float:  # fmt: skip
    """Inverse information times the misfit, and what print, focal length and shape add, into
    ``out`` (6, 6).

    Returns the standard deviation of the position, mean over the axes; NaN when the information is
    singular.

    Args: as in ``pulled`` and ``linearize``.
    """
    if not inverse(information, out):
        return math.nan
    rows = 8 * whitening.shape[0] + 3
    left = np.zeros(rows)
    jacobian = np.zeros((rows, 6))
    linearize(R, t, points, pixels, whitening, lens, down, weight, left, jacobian)
    pulls = np.empty((CAUSES, 6))
    moved = np.zeros((CAUSES, 6))
    pulled(R, t, points, pixels, middles, sizes, focal, shape, whitening, lens, jacobian, pulls)
    for cause in range(CAUSES):
        for i in range(6):
            for j in range(6):
                moved[cause, i] += out[i, j] * pulls[cause, j]
    for i in range(6):
        for j in range(6):
            out[i, j] *= misfit
            for cause in range(CAUSES):
                out[i, j] += moved[cause, i] * moved[cause, j]
    return math.sqrt((out[0, 0] + out[1, 1] + out[2, 2]) / 3.0)


class PoseProblem(NamedTuple):
    """The inputs of a pose's estimate.

    Attributes:
        points, pixels: (n, 3) corners in ``v``, (n, 2) in the image.
        whitening: (m, 8, 8), of each marker's corners.
        lens: of ``path.camera.kernels``.
        down, weight: (6,) gravity in ``v`` and in the camera; what its misfit counts, 0 when it is
            not known.
        middles, sizes, focal, shape: of ``pulled``.
    """

    points: Array
    pixels: Array
    whitening: Array
    lens: Array
    down: Array
    weight: float
    middles: Array
    sizes: Array
    focal: float
    shape: float


class PoseFit(NamedTuple):
    """The best pose, and the other planar solution.

    Attributes:
        cost, corner_cost: chi-square of corners and gravity there, and the corners' share; infinite
            without a pose.
        misfit: by how much the chi-square enlarges the covariance, at least 1.
        R, t, covariance, sigma_m: the pose, its covariance (6, 6), and the standard deviation of
            its position.
        rival: whether a descent with gravity ended in the other solution.
        other_cost, other_R, other_t: the other solution; its cost is infinite when there is none.
    """

    cost: float
    corner_cost: float
    misfit: float
    R: Array
    t: Array
    covariance: Array
    sigma_m: float
    rival: bool
    other_cost: float
    other_R: Array
    other_t: Array


@kernel
def fit(start_R: Array, start_t: Array, seen: PoseProblem) -> PoseFit:
    """Descend from every start, (k, 3, 3) and (k, 3): the lowest end, and the other one when it is
    another.

    Where gravity leads all of them to one end, the other solution is the one that the corners alone
    keep.
    """
    best_cost = np.inf
    best_corners = np.inf
    other_cost = np.inf
    rival = False
    best_R = identity(3)
    best_t = np.zeros(3)
    best_information = identity(6)
    other_R = identity(3)
    other_t = np.zeros(3)
    for k in range(start_R.shape[0]):
        cost, R, t, information, corners = refine(
            start_R[k],
            start_t[k],
            seen.points,
            seen.pixels,
            seen.whitening,
            seen.lens,
            seen.down,
            seen.weight,
        )
        if cost < best_cost:
            other_cost = best_cost
            other_R = best_R
            other_t = best_t
            best_cost = cost
            best_R = R
            best_t = t
            best_information = information
            best_corners = corners
        elif cost < np.inf:
            other_cost = cost
            other_R = R
            other_t = t
    spread = np.empty((6, 6))
    if not best_cost < np.inf:
        return PoseFit(
            np.inf, np.inf, 1.0, best_R, best_t, spread, np.inf, False, np.inf, other_R, other_t
        )
    misfit = best_cost / (2 * seen.points.shape[0] - (4 if seen.weight > 0.0 else 6))
    misfit = misfit if misfit > MISFIT else 1.0
    sigma_m = covariance(
        best_R, best_t, seen.points, seen.pixels, seen.middles, seen.sizes, seen.focal, seen.shape, seen.whitening,
        seen.lens, seen.down, seen.weight, best_information, misfit, spread,
    )  # fmt: skip
    if other_cost < np.inf and angle(best_R, other_R) > SAME_RAD:
        rival = True
    else:
        other_cost, other_R, other_t = _mirrored(start_R, start_t, best_R, seen)
    return PoseFit(
        best_cost,
        best_corners,
        misfit,
        best_R,
        best_t,
        spread,
        sigma_m,
        rival,
        other_cost,
        other_R,
        other_t,
    )


@inner
def _mirrored(
    start_R: Array, start_t: Array, best_R: Array, seen: PoseProblem
) -> tuple[float, Array, Array]:
    """The planar solution that gravity excluded, where the corners alone keep it; else with an
    infinite cost.
    """
    farthest = 0
    far = -1.0
    for k in range(start_R.shape[0]):
        turned = angle(best_R, start_R[k])
        if turned > far:
            farthest = k
            far = turned
    if not seen.weight > 0.0:
        return np.inf, start_R[farthest], start_t[farthest]
    cost, R, t, _, _ = refine(
        start_R[farthest],
        start_t[farthest],
        seen.points,
        seen.pixels,
        seen.whitening,
        seen.lens,
        seen.down,
        0.0,
    )
    if not cost < np.inf or angle(best_R, R) <= SAME_RAD:
        return np.inf, R, t
    off2 = 0.0
    for i in range(3):
        down = R[i, 0] * seen.down[0] + R[i, 1] * seen.down[1] + R[i, 2] * seen.down[2]
        off2 += (down - seen.down[3 + i]) ** 2
    return cost + seen.weight * off2, R, t
