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

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from path.camera import CameraModel
from path.geometry import Pose
from path.marker.kernels import cholesky, cholesky_solve, distort, lens_of, rays
from path.marker.layout import Marker, MarkerLayout
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason

Array = NDArray[np.float64]

ITERATIONS = 12
CONVERGED = 1e-9
MIN_CORNER_SIGMA_PX = 0.005
FLOOR_PX2 = MIN_CORNER_SIGMA_PX**2 * np.eye(8)
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
    seen.sort(key=lambda item: -_side_px(item[0]))
    found, marker = seen[0]
    side_px, lens = _side_px(found), lens_of(camera)
    points = np.concatenate([marker.corners_v for _, marker in seen])
    pixels = np.concatenate([found.corners_px for found, _ in seen])
    whitening = np.stack([_whitening(found.covariance_px2) for found, _ in seen])
    gravity = gravity_v is not None and gravity_c is not None
    down = np.array([*gravity_v, *gravity_c] if gravity_v is not None and gravity_c is not None else [0.0] * 6)
    weight = 0.5 / settings.attitude_sigma_rad**2 if gravity else 0.0
    solutions = [_refine(R, t, points, pixels, whitening, lens, down, weight) for R, t in _ippe(found, marker, lens)]
    solutions = sorted((s for s in solutions if math.isfinite(s[0])), key=lambda solution: solution[0])
    if not solutions:
        return Missed(MissReason.POSE_UNCERTAIN)
    cost, R, t, information, corner_cost = solutions[0]
    incidence = _incidence(R @ marker.T_v_m.R, R @ marker.T_v_m.t + t)
    if incidence > settings.max_incidence_rad:
        return Missed(MissReason.MARKER_OBLIQUE)
    misfit = cost / (2 * len(points) - (4 if gravity else 6))
    misfit = misfit if misfit > MISFIT else 1.0
    rivals = [other[0] - cost for other in solutions[1:] if _angle(R, other[1]) > SAME_RAD]
    ambiguity = math.exp(-0.5 * rivals[0] / misfit) if rivals else 0.0
    rms = math.sqrt(corner_cost / (2 * len(points)))
    rms_px = rms * math.sqrt(float(np.trace(found.covariance_px2)) / 8.0)
    covariance = _covariance(information, R, t, marker, misfit, settings)
    if (
        covariance is None
        or ambiguity > MAX_AMBIGUITY
        or rms_px > max(WORST_PX, WORST_SHARE * side_px)
        or math.sqrt(np.trace(covariance[:3, :3]) / 3.0) > settings.max_sigma_m
    ):
        return Missed(MissReason.POSE_UNCERTAIN)
    return MarkerPose(Pose(R, t), covariance, incidence, side_px, rms, ambiguity)


def _known(
    detections: Sequence[MarkerDetection], layout: MarkerLayout
) -> list[tuple[MarkerDetection, Marker]] | Missed:
    """Every detection with its marker."""
    if not detections:
        return Missed(MissReason.NO_MARKER)
    markers = {marker.id: marker for marker in layout.markers}
    seen = [(found, markers[found.marker_id]) for found in detections if found.marker_id in markers]
    if not seen:
        return Missed(MissReason.WRONG_MARKER)
    if len({marker.id for _, marker in seen}) < len(seen):
        return Missed(MissReason.MARKER_TWICE)
    if not all(np.isfinite(found.corners_px).all() and np.isfinite(found.covariance_px2).all() for found, _ in seen):
        return Missed(MissReason.NON_FINITE)
    return seen


def _side_px(found: MarkerDetection) -> float:
    a, b, c, d = found.corners_px.tolist()
    return 0.25 * (math.dist(a, b) + math.dist(b, c) + math.dist(c, d) + math.dist(d, a))


def _whitening(covariance_px2: Array) -> Array:
    """Inverse Cholesky factor, so that whitened residuals have unit variance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance_px2 + FLOOR_PX2)), dtype=np.float64)


def _ippe(found: MarkerDetection, marker: Marker, lens: Array) -> list[tuple[Array, Array]]:
    """Both planar solutions as poses of ``v`` in the camera."""
    half = 0.5 * marker.side_m
    corners = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    seen = rays(np.ascontiguousarray(found.corners_px), lens)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(corners, seen, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:
        return []
    T_m_v = marker.T_v_m.inverse()
    poses: list[tuple[Array, Array]] = []
    for turn, shift in zip(turns, shifts, strict=True):
        R_c_m, t_c_m = cv2.Rodrigues(turn)[0], shift.ravel()
        if np.all(np.isfinite(R_c_m)) and t_c_m[2] > 0.0:
            poses.append((np.ascontiguousarray(R_c_m @ T_m_v.R), R_c_m @ T_m_v.t + t_c_m))
    return poses


def _covariance(
    information: Array, R: Array, t: Array, marker: Marker, misfit: float, settings: PoseSettings
) -> Array | None:
    """Inverse information times the misfit, with the two errors that scale the range; None when it is singular."""
    try:
        covariance = np.asarray(np.linalg.inv(information) * misfit, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    if not covariance.diagonal().min() > 0.0:
        return None
    centre = R @ marker.T_v_m.t + t
    size = marker.side_sigma_m / marker.side_m
    covariance[:3, :3] += size * size * np.outer(centre, centre)
    covariance[2, 2] += (settings.focal_sigma * centre[2]) ** 2
    return covariance


def _incidence(R_c_m: Array, t_c_m: Array) -> float:
    cosine = -float(R_c_m[:, 2] @ t_c_m) / float(np.linalg.norm(t_c_m))
    return math.acos(min(1.0, max(-1.0, cosine)))


def _angle(R_a: Array, R_b: Array) -> float:
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.sum(R_a * R_b)) - 1.0))))


@njit(cache=True, nogil=True)
def _exp_times(w: Array, R: Array) -> Array:
    """``exp(w) R`` by Rodrigues' formula."""
    angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a = 1.0 - angle * angle / 6.0 if angle < 1e-6 else math.sin(angle) / angle
    b = 0.5 if angle < 1e-6 else (1.0 - math.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for j in range(3):
        x, y, z = R[0, j], R[1, j], R[2, j]
        cx, cy, cz = w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
        out[0, j] = x + a * cx + b * (w[1] * cz - w[2] * cy)
        out[1, j] = y + a * cy + b * (w[2] * cx - w[0] * cz)
        out[2, j] = z + a * cz + b * (w[0] * cy - w[1] * cx)
    return out


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
        turned = _exp_times(step[3:], turn)
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
