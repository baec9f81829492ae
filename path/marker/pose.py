"""From marker corners to the pose of ``v`` in a camera: both planar solutions, chosen and refined with gravity.

A square marker seen from afar has two poses that explain its corners about equally well, and reprojection error cannot
tell which is right. Both drones know which way is down: with that as a prior (Gauss-Newton on reprojection and gravity
together, started from both solutions) the wrong one costs hundreds of standard deviations.

Perturbations of a pose are ``t + dt``, ``R <- exp(dw) R``; covariances are (6, 6) in the order (dt, dw).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from path.camera import CameraModel
from path.geometry import Pose
from path.marker.kernels import cholesky, cholesky_solve, distort, exp_times, finite, inverse, lens_of, rays, whitening
from path.marker.layout import Marker, MarkerLayout
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason

Array = NDArray[np.float64]

ITERATIONS = 12
CONVERGED = 1e-9
MIN_CORNER_SIGMA_PX = 0.005
EYE = np.eye(3)
SAME_RAD = 0.05  # two solutions nearer than this are one
MAX_AMBIGUITY = 0.01  # likelihood of the other solution relative to the best, from which on neither is believed
MISFIT = 3.0  # chi-square per degree of freedom above which it enlarges the covariance
WORST_PX, WORST_SHARE = 1.0, 0.06  # rms misfit of corners, px or share of the side, that no such marker has


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What is known of the errors.

    Attributes:
        attitude_sigma_rad: of either drone's roll and pitch, biases included.
        focal_sigma: relative error of the focal length.
        max_incidence_rad: larger angles between the marker's normal and the line of sight are refused.
        max_sigma_m: position standard deviation above which a pose is no use.
    """

    attitude_sigma_rad: float = math.radians(0.6)
    focal_sigma: float = 0.002
    max_incidence_rad: float = math.radians(70.0)
    max_sigma_m: float = 0.15


@dataclass(frozen=True, slots=True)
class MarkerPose:
    """The pose of ``v`` in the camera.

    Attributes:
        T_c_v: maps ``v`` to the camera.
        covariance: (6, 6), see the module; printed size and focal length included.
        incidence_rad: between the best marker's normal and the line of sight.
        side_px: mean side of the best marker in the image.
        rms: whitened residual per corner coordinate; at most about 1 when the corners' covariance is right.
        ambiguity: likelihood of the other planar solution relative to this one, 0..1.
    """

    T_c_v: Pose
    covariance: Array
    incidence_rad: float
    side_px: float
    rms: float
    ambiguity: float


def estimate_pose(
    detections: Sequence[MarkerDetection],
    layout: MarkerLayout,
    camera: CameraModel,
    gravity_v: Vec3 | None,
    gravity_c: Vec3 | None,
    settings: PoseSettings,
) -> MarkerPose | Missed:
    """The pose from all markers of the layout seen in one frame.

    Args:
        gravity_v: unit gravity in ``v``, from the attitude of the drone that carries the marker; None when unknown.
        gravity_c: unit gravity in the camera, from the own attitude; None when unknown.

    Returns:
        Missed NO_MARKER, WRONG_MARKER, MARKER_TWICE, NON_FINITE, MARKER_OBLIQUE, or POSE_UNCERTAIN (the two solutions
        cannot be told apart, the corners do not fit, or the covariance is too large).
    """
    seen = _known(detections, layout)
    if isinstance(seen, Missed):
        return seen
    if len(seen) > 1:
        seen.sort(key=lambda item: -_side_px(item[0]))
    found, marker = seen[0]
    side_px, lens = _side_px(found), lens_of(camera)
    points = np.concatenate([marker.corners_v for _, marker in seen])
    pixels = np.concatenate([found.corners_px for found, _ in seen])
    whiteners = np.zeros((len(seen), 8, 8))
    for (each, _), whitener in zip(seen, whiteners, strict=True):
        if not whitening(np.ascontiguousarray(each.covariance_px2), MIN_CORNER_SIGMA_PX**2, whitener):
            raise np.linalg.LinAlgError(f"marker {each.marker_id}: its covariance is not positive definite")
    gravity = gravity_v is not None and gravity_c is not None
    down = np.array([*gravity_v, *gravity_c] if gravity_v is not None and gravity_c is not None else [0.0] * 6)
    weight = 0.5 / settings.attitude_sigma_rad**2 if gravity else 0.0
    solutions = [_refine(R, t, points, pixels, whiteners, lens, down, weight) for R, t in _ippe(found, marker, lens)]
    solutions = sorted((s for s in solutions if math.isfinite(s[0])), key=lambda solution: solution[0])
    if not solutions:
        return Missed(MissReason.POSE_UNCERTAIN)
    cost, R, t, information, corner_cost = solutions[0]
    T_v_m = marker.T_v_m
    incidence, centre = _facing(R, t, np.ascontiguousarray(T_v_m.R), T_v_m.t)
    if incidence > settings.max_incidence_rad:
        return Missed(MissReason.MARKER_OBLIQUE)
    misfit = cost / (2 * len(points) - (4 if gravity else 6))
    misfit = misfit if misfit > MISFIT else 1.0
    rivals = [other[0] - cost for other in solutions[1:] if _angle(R, other[1]) > SAME_RAD]
    ambiguity = math.exp(-0.5 * rivals[0] / misfit) if rivals else 0.0
    rms = math.sqrt(corner_cost / (2 * len(points)))
    rms_px = rms * math.sqrt(float(found.covariance_px2.trace()) / 8.0)
    covariance = np.empty((6, 6))
    size = marker.side_sigma_m / marker.side_m
    sigma_m = _covariance(information, misfit, centre, size, settings.focal_sigma, covariance)
    if (
        not sigma_m <= settings.max_sigma_m
        or ambiguity > MAX_AMBIGUITY
        or rms_px > max(WORST_PX, WORST_SHARE * side_px)
    ):
        return Missed(MissReason.POSE_UNCERTAIN)
    return MarkerPose(Pose(R, t), covariance, incidence, side_px, rms, ambiguity)


def _known(
    detections: Sequence[MarkerDetection], layout: MarkerLayout
) -> list[tuple[MarkerDetection, Marker]] | Missed:
    """Every detection with its marker."""
    if not detections:
        return Missed(MissReason.NO_MARKER)
    seen = [(found, marker) for found in detections if (marker := layout.marker(found.marker_id)) is not None]
    if not seen:
        return Missed(MissReason.WRONG_MARKER)
    if len(seen) > 1 and len({marker.id for _, marker in seen}) < len(seen):
        return Missed(MissReason.MARKER_TWICE)
    for found, _ in seen:
        if not (finite(np.ascontiguousarray(found.corners_px)) and finite(np.ascontiguousarray(found.covariance_px2))):
            return Missed(MissReason.NON_FINITE)
    return seen


def _side_px(found: MarkerDetection) -> float:
    a, b, c, d = found.corners_px.tolist()
    return 0.25 * (math.dist(a, b) + math.dist(b, c) + math.dist(c, d) + math.dist(d, a))


def _ippe(found: MarkerDetection, marker: Marker, lens: Array) -> list[tuple[Array, Array]]:
    """Both planar solutions as poses of ``v`` in the camera."""
    half = 0.5 * marker.side_m
    corners = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    seen = rays(np.ascontiguousarray(found.corners_px), lens)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(corners, seen, EYE, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:
        return []
    R_v_m, t_v_m = np.ascontiguousarray(marker.T_v_m.R), marker.T_v_m.t
    poses: list[tuple[Array, Array]] = []
    for turn, shift in zip(turns, shifts, strict=True):
        R_c_v, t_c_v = _of_layout(_vector(turn), _vector(shift), R_v_m, t_v_m)
        if shift[2, 0] > 0.0 and finite(R_c_v):
            poses.append((R_c_v, t_c_v))
    return poses


def _vector(column: Any) -> Array:
    """OpenCV's (3, 1) as (3,)."""
    return np.asarray(column, dtype=np.float64).ravel()


@njit(cache=True, nogil=True)
def _of_layout(turn: Array, shift: Array, R_v_m: Array, t_v_m: Array) -> tuple[Array, Array]:
    """The pose of ``v`` in the camera from a marker's, given as rotation vector and translation."""
    R_c_m = exp_times(turn, np.eye(3))
    R, t = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(3):
            R[i, j] = R_c_m[i, 0] * R_v_m[j, 0] + R_c_m[i, 1] * R_v_m[j, 1] + R_c_m[i, 2] * R_v_m[j, 2]
    for i in range(3):
        t[i] = shift[i] - (R[i, 0] * t_v_m[0] + R[i, 1] * t_v_m[1] + R[i, 2] * t_v_m[2])
    return R, t


@njit(cache=True, nogil=True)
def _covariance(information: Array, misfit: float, centre: Array, size: float, focal: float, out: Array) -> float:
    """Inverse information times the misfit, with the two errors that scale the range, into ``out``.

    Returns the standard deviation of the position, mean over the axes; NaN when the information is singular.

    Args:
        centre: (3,) of the marker in the camera.
        size, focal: relative errors of the printed side and of the focal length.
    """
    if not inverse(information, out):
        return math.nan
    for i in range(6):
        for j in range(6):
            out[i, j] *= misfit
    for i in range(3):
        for j in range(3):
            out[i, j] += size * size * centre[i] * centre[j]
    out[2, 2] += (focal * centre[2]) ** 2
    return math.sqrt((out[0, 0] + out[1, 1] + out[2, 2]) / 3.0)


@njit(cache=True, nogil=True)
def _facing(R: Array, t: Array, R_v_m: Array, t_v_m: Array) -> tuple[float, Array]:
    """Angle between a marker's normal and the line of sight, and the marker's centre (3,) in the camera."""
    centre = np.empty(3)
    along = 0.0
    for i in range(3):
        centre[i] = R[i, 0] * t_v_m[0] + R[i, 1] * t_v_m[1] + R[i, 2] * t_v_m[2] + t[i]
        along -= centre[i] * (R[i, 0] * R_v_m[0, 2] + R[i, 1] * R_v_m[1, 2] + R[i, 2] * R_v_m[2, 2])
    cosine = along / math.sqrt(centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2])
    return math.acos(min(1.0, max(-1.0, cosine))), centre


@njit(cache=True, nogil=True)
def _angle(R_a: Array, R_b: Array) -> float:
    """Of the rotation from one to the other."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += R_a[i, j] * R_b[i, j]
    return math.acos(min(1.0, max(-1.0, 0.5 * (total - 1.0))))


@njit(cache=True, nogil=True)
def _residuals(
    R: Array, t: Array, points: Array, pixels: Array, whitening: Array, lens: Array, down: Array, weight: float,
    residuals: Array, jacobian: Array,
) -> float:  # fmt: skip
    """Whitened residuals (8 a marker, then 3 of gravity) and their Jacobian by (dt, dw); returns the corners' cost."""
    markers = whitening.shape[0]
    raw, slope = np.empty(8), np.empty((8, 6))
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
            x, y = (qx + t[0]) / z, (qy + t[1]) / z
            u, v, ux, uy, vx, vy = distort(x, y, lens)
            raw[2 * c], raw[2 * c + 1] = u - pixels[i, 0], v - pixels[i, 1]
            for k in range(2):
                gx, gy = (ux, uy) if k == 0 else (vx, vy)
                a, b = gx / z, gy / z
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
    root, base = math.sqrt(weight), 8 * markers
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


@njit(cache=True, nogil=True)
def _normal(jacobian: Array, residuals: Array, information: Array, gradient: Array) -> float:
    """Information ``J^T J`` (6, 6) and ``-J^T r`` (6,) into their places; returns the cost ``r^T r``."""
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


@njit(cache=True, nogil=True)
def _refine(
    start_R: Array, start_t: Array, points: Array, pixels: Array, whitening: Array, lens: Array, down: Array,
    weight: float,
) -> tuple[float, Array, Array, Array, float]:  # fmt: skip
    """Levenberg-Marquardt from one solution: cost, pose, information (6, 6) and the corners' share of the cost."""
    turn, shift = start_R, start_t
    rows = 8 * whitening.shape[0] + 3
    residuals, jacobian = np.zeros(rows), np.zeros((rows, 6))
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    tried_information, tried_gradient, factor = np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6))
    corners = _residuals(turn, shift, points, pixels, whitening, lens, down, weight, residuals, jacobian)
    cost = _normal(jacobian, residuals, information, gradient) if corners < np.inf else np.inf
    damping = 1e-6
    for _ in range(ITERATIONS):
        if not cost < np.inf:
            break
        step, shifted = gradient.copy(), shift.copy()
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
        corners_new = _residuals(turned, shifted, points, pixels, whitening, lens, down, weight, residuals, jacobian)
        cost_new = _normal(jacobian, residuals, tried_information, tried_gradient) if corners_new < np.inf else np.inf
        if cost_new <= cost:
            done = cost - cost_new < CONVERGED * (1.0 + cost)
            turn, shift, cost, corners = turned, shifted, cost_new, corners_new
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
