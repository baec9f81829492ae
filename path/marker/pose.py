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
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera import CameraModel
from path.geometry import Pose
from path.marker.kernels import finite, lens_of, rays, whitening
from path.marker.layout import Marker, MarkerLayout
from path.marker.pose_kernels import angle, covariance, facing, of_layout, refine
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason

Array = NDArray[np.float64]

MIN_CORNER_SIGMA_PX = 0.005
MIN_GRAVITY_RAD = 1e-4  # of two directions together: better is known by none
EYE = np.eye(3)
NO_GRAVITY = np.zeros(6)
SAME_RAD = 0.05  # two solutions nearer than this are one
MISFIT = 3.0  # chi-square per degree of freedom above which it enlarges the covariance
WORST_PX, WORST_SHARE = 1.0, 0.06  # rms misfit of corners, px or share of the side, that no such marker has


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What is known of the errors, and what is too uncertain to be a pose.

    Attributes:
        attitude_v_sigma_rad, attitude_c_sigma_rad: of gravity in ``v`` and in the camera, per axis: the error of roll
            and pitch of the drone that carries the marker, and of the one that carries the camera, biases included.
        focal_sigma: relative error of the focal length.
        max_incidence_rad: larger angles between the marker's normal and the line of sight are refused.
        max_sigma_m: position standard deviation above which a pose is no use.
        max_ambiguity: likelihood of the other solution relative to the best above which neither is believed; with 1
            the likelier one is always given.
    """

    attitude_v_sigma_rad: float = math.radians(0.6)
    attitude_c_sigma_rad: float = math.radians(0.6)
    focal_sigma: float = 0.002
    max_incidence_rad: float = math.radians(70.0)
    max_sigma_m: float = 0.15
    max_ambiguity: float = 0.01


@dataclass(frozen=True, slots=True)
class PoseCandidate:
    """One of the two poses a planar marker may have.

    Attributes:
        T_c_v: maps ``v`` to the camera.
        cost: chi-square of corners and gravity there.
        likelihood: relative to the best candidate, 0..1.
    """

    T_c_v: Pose
    cost: float
    likelihood: float


@dataclass(frozen=True, slots=True)
class MarkerPose:
    """The pose of ``v`` in the camera.

    Attributes:
        T_c_v: maps ``v`` to the camera.
        covariance: (6, 6), see the module; attitude, printed size and focal length included.
        incidence_rad: between the best marker's normal and the line of sight.
        side_px: mean side of the best marker in the image.
        rms: whitened residual per corner coordinate; at most about 1 when the corners' covariance is right.
        ambiguity: likelihood of the other solution relative to this one, 0..1; 0 when the fit has only one.
        candidates: this pose, and the other planar solution: where the fit ends that starts from it; when gravity
            leads that to this pose too, where the corners alone would keep it. Only this pose when both solutions are
            one, as they are near the camera's axis of a marker that faces it.
    """

    T_c_v: Pose
    covariance: Array
    incidence_rad: float
    side_px: float
    rms: float
    ambiguity: float
    candidates: tuple[PoseCandidate, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """All corners seen (n, 3) in ``v`` and (n, 2) px, a whitener (8, 8) a marker, lens, and both gravities."""

    points: Array
    pixels: Array
    whiteners: Array
    lens: Array
    down: Array
    weight: float  # of gravity's misfit; 0 without gravity

    def descend(self, R: Array, t: Array, weight: float) -> _Solution:
        return _Solution(*refine(R, t, self.points, self.pixels, self.whiteners, self.lens, self.down, weight))


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Where a descent ended; ``cost`` is that of corners and gravity, ``corner_cost`` the corners' share."""

    cost: float
    R: Array
    t: Array
    information: Array
    corner_cost: float


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
        gravity_c: unit gravity in the camera, from the own attitude; None when unknown. One without the other says
            nothing.

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
    side_px = _side_px(found)
    problem = _problem(seen, camera, gravity_v, gravity_c, settings)
    starts = _ippe(found, marker, problem.lens)
    solutions = [problem.descend(R, t, problem.weight) for R, t in starts]
    solutions = sorted((s for s in solutions if math.isfinite(s.cost)), key=lambda solution: solution.cost)
    if not solutions:
        return Missed(MissReason.POSE_UNCERTAIN)
    best = solutions[0]
    incidence, _ = facing(best.R, best.t, np.ascontiguousarray(marker.T_v_m.R), marker.T_v_m.t)
    if incidence > settings.max_incidence_rad:
        return Missed(MissReason.MARKER_OBLIQUE)
    coordinates = 2 * len(problem.points)
    misfit = best.cost / (coordinates - (4 if problem.weight else 6))
    misfit = misfit if misfit > MISFIT else 1.0
    rivals = [other for other in solutions[1:] if angle(best.R, other.R) > SAME_RAD]
    ambiguity = math.exp(-0.5 * (rivals[0].cost - best.cost) / misfit) if rivals else 0.0
    rms = math.sqrt(best.corner_cost / coordinates)
    rms_px = rms * math.sqrt(sum(found.covariance_px2.diagonal().tolist()) / 8.0)
    spread, sigma_m = _covariance(problem, best, seen, settings.focal_sigma, misfit)
    if (
        not sigma_m <= settings.max_sigma_m
        or ambiguity > settings.max_ambiguity
        or rms_px > max(WORST_PX, WORST_SHARE * side_px)
    ):
        return Missed(MissReason.POSE_UNCERTAIN)
    candidates = _candidates(best, rivals or _mirrored(problem, best, starts), misfit)
    return MarkerPose(candidates[0].T_c_v, spread, incidence, side_px, rms, ambiguity, candidates)


def _problem(
    seen: Sequence[tuple[MarkerDetection, Marker]],
    camera: CameraModel,
    gravity_v: Vec3 | None,
    gravity_c: Vec3 | None,
    settings: PoseSettings,
) -> _Problem:
    points = np.array([marker.corners_v for _, marker in seen]).reshape(-1, 3)
    pixels = np.array([found.corners_px for found, _ in seen]).reshape(-1, 2)
    whiteners = np.zeros((len(seen), 8, 8))
    for (each, _), whitener in zip(seen, whiteners, strict=True):
        if not whitening(np.ascontiguousarray(each.covariance_px2), MIN_CORNER_SIGMA_PX**2, whitener):
            raise np.linalg.LinAlgError(f"marker {each.marker_id}: its covariance is not positive definite")
    if gravity_v is None or gravity_c is None:
        return _Problem(points, pixels, whiteners, lens_of(camera), NO_GRAVITY, 0.0)
    # the misfit of one direction turned into the other has the errors of both
    variance = settings.attitude_v_sigma_rad**2 + settings.attitude_c_sigma_rad**2
    weight = 1.0 / max(variance, MIN_GRAVITY_RAD**2)
    return _Problem(points, pixels, whiteners, lens_of(camera), np.array([*gravity_v, *gravity_c]), weight)


def _covariance(
    problem: _Problem,
    best: _Solution,
    seen: Sequence[tuple[MarkerDetection, Marker]],
    focal_sigma: float,
    misfit: float,
) -> tuple[Array, float]:
    """Covariance (6, 6) of a solution, and the standard deviation of its position in m."""
    out = np.empty((6, 6))
    middles = np.array([marker.T_v_m.t for _, marker in seen])
    sizes = np.array([marker.side_sigma_m / marker.side_m for _, marker in seen])
    sigma_m = covariance(
        best.R, best.t, problem.points, problem.pixels, middles, sizes, focal_sigma, problem.whiteners, problem.lens,
        problem.down, problem.weight, best.information, misfit, out,
    )  # fmt: skip
    return out, sigma_m


def _mirrored(problem: _Problem, best: _Solution, starts: Sequence[tuple[Array, Array]]) -> list[_Solution]:
    """The planar solution that gravity excluded, where the corners alone keep it; none when there is only one."""
    if not problem.weight:
        return []
    R, t = max(starts, key=lambda start: angle(best.R, start[0]))
    other = problem.descend(R, t, 0.0)
    if not math.isfinite(other.cost) or angle(best.R, other.R) <= SAME_RAD:
        return []
    misfit = other.R @ problem.down[:3] - problem.down[3:]
    cost = other.cost + problem.weight * float(misfit @ misfit)
    return [_Solution(cost, other.R, other.t, other.information, other.corner_cost)]


def _candidates(best: _Solution, others: Sequence[_Solution], misfit: float) -> tuple[PoseCandidate, ...]:
    return tuple(
        PoseCandidate(Pose(s.R, s.t), s.cost, min(1.0, math.exp(-0.5 * (s.cost - best.cost) / misfit)))
        for s in (best, *others)
    )


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
    seen = rays(np.ascontiguousarray(found.corners_px), lens)
    square = _square(marker.side_m)
    try:
        solved: Any = cv2.solvePnPGeneric(square, seen, EYE, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:
        return []
    _, turns, shifts, _ = solved
    R_v_m, t_v_m = np.ascontiguousarray(marker.T_v_m.R), marker.T_v_m.t
    poses: list[tuple[Array, Array]] = []
    for turn, shift in zip(turns, shifts, strict=True):
        in_front, R_c_v, t_c_v = of_layout(turn, shift, R_v_m, t_v_m)
        if in_front:
            poses.append((R_c_v, t_c_v))
    return poses


@lru_cache(maxsize=8)
def _square(side_m: float) -> Array:
    """Corners of a marker in its own frame, shape (4, 3). Shared: do not change it."""
    h = 0.5 * side_m
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
