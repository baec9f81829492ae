"""The pose of ``v`` in a camera from marker corners: both planar solutions, chosen and refined with
gravity.

A square marker seen from afar has two poses that explain its corners about equally well, and
reprojection error cannot tell which is right. Both drones know which way is down: with that as a
prior (Gauss-Newton on reprojection and gravity together, started from both solutions) the wrong one
costs hundreds of standard deviations.

Perturbations of a pose are ``t + dt``, ``R <- exp(dw) R``; covariances are (6, 6) in the order (dt,
dw).
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

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.doubt import widen
from path.marker.kernels import finite, rays, whitening
from path.marker.layout import Marker, MarkerLayout
from path.marker.pose_kernels import MISFIT, PoseFit, PoseProblem, facing, fit, of_layout
from path.marker.turned import likely_cause
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason
from path.values import value

Array = NDArray[np.float64]

MIN_CORNER_SIGMA_PX = 0.005
MIN_GRAVITY_RAD = 1e-4  # of two directions together: better is known by none
EYE = np.eye(3)
NO_GRAVITY = np.zeros(6)
# rms misfit of corners, px or share of the side, that no such marker has
WORST_PX = 1.0
WORST_SHARE = 0.06
# chi-square per degree of freedom of errors that are all five times as large as was stated
ABSURD = 25.0
# the same of errors three times as large: a corner may be off, by dirt on it or by glare
BAD = 9.0
LEFT_OUT_PX2 = 1e4  # added to the variance of a corner that is left out


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """The expected errors of a pose's inputs, and the limits beyond which a pose is refused.

    Attributes:
        attitude_v_sigma_rad, attitude_c_sigma_rad: of gravity in ``v`` and in the camera, per axis:
            the error of roll and pitch of the drone that carries the marker, and of the one that
            carries the camera, biases included.
        focal_sigma: relative error of the focal length, of a camera whose calibration states none.
        shape_sigma: relative error of the markers' shape in the image, width against height and
            skew: of paper that stretched, and of rows that are read one after another while
                something moves.
        max_incidence_rad: larger angles between the marker's normal and the line of sight are
            refused.
        max_sigma_m: position standard deviation above which a pose is no use.
        max_ambiguity: likelihood of the other solution relative to the best above which neither is
            believed; with 1 the likelier one is always given.
    """

    attitude_v_sigma_rad: float = math.radians(0.6)
    attitude_c_sigma_rad: float = math.radians(0.6)
    focal_sigma: float = 0.002
    shape_sigma: float = 0.001
    max_incidence_rad: float = math.radians(70.0)
    max_sigma_m: float = 0.15
    max_ambiguity: float = 0.01


@value
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


@value
class MarkerPose:
    """The pose of ``v`` in the camera.

    Attributes:
        T_c_v: maps ``v`` to the camera.
        covariance: (6, 6), see the module; attitude, printed size and the camera's calibration
            included.
        incidence_rad: between the best marker's normal and the line of sight.
        side_px: mean side of the best marker in the image.
        rms: whitened residual per corner coordinate; at most about 1 when the corners' covariance
            is right.
        ambiguity: likelihood of the other solution relative to this one, 0..1; 0 when the fit has
            only one.
        candidates: this pose, and the other planar solution: where the fit ends that starts from
            it; when gravity leads that to this pose too, where the corners alone would keep it.
            Only this pose when both solutions are one, as they are near the camera's axis of a
            marker that faces it.
    """

    T_c_v: Pose
    covariance: Array
    incidence_rad: float
    side_px: float
    rms: float
    ambiguity: float
    candidates: tuple[PoseCandidate, ...]


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
        gravity_v: unit gravity in ``v``, from the attitude of the drone that carries the marker;
            None when unknown.
        gravity_c: unit gravity in the camera, from the own attitude; None when unknown. One without
            the other says nothing.

    Returns:
        Missed NO_MARKER, WRONG_MARKER, MARKER_TWICE, NON_FINITE, MARKER_OBLIQUE, MARKER_TURNED
        (gravity contradicts all that the corners allow), or POSE_UNCERTAIN (the two solutions
        cannot be told apart, the corners do not fit, or the covariance is too large).
    """
    seen = _known(detections, layout)
    if isinstance(seen, Missed):
        return seen
    if len(seen) > 1:
        seen.sort(key=lambda item: -_side_px(item[0]))
    found, marker = seen[0]
    side_px = _side_px(found)
    whole = _seen(seen, camera, gravity_v, gravity_c, settings)
    starts_R, starts_t = _ippe(found, marker, whole.lens)
    fitted = fit(starts_R, starts_t, whole)
    if not math.isfinite(fitted.cost):
        return Missed(MissReason.POSE_UNCERTAIN)
    if whole.weight > 0.0 and fitted.misfit > BAD:
        whole, fitted = _without_bad_corner(starts_R, starts_t, seen, whole, fitted)
    if whole.weight > 0.0 and fitted.misfit > ABSURD:
        cause = _contradicted(starts_R, starts_t, whole, layout, camera)
        if cause is not None:
            return Missed(MissReason.MARKER_TURNED, cause=cause)
    sigma_m = fitted.sigma_m
    if camera.doubts:
        sigma_m = widen(
            fitted.R, fitted.t, whole.points, whole.pixels, whole.whitening, whole.lens, whole.down, whole.weight,
            _doubts(camera), fitted.covariance,
        )  # fmt: skip
    incidence, _ = facing(fitted.R, fitted.t, np.ascontiguousarray(marker.T_v_m.R), marker.T_v_m.t)
    if incidence > settings.max_incidence_rad:
        return Missed(MissReason.MARKER_OBLIQUE)
    likelihood = math.exp(-0.5 * (fitted.other_cost - fitted.cost) / fitted.misfit)
    ambiguity = likelihood if fitted.rival else 0.0
    rms = math.sqrt(fitted.corner_cost / (2 * len(whole.points)))
    rms_px = rms * math.sqrt(sum(found.covariance_px2.diagonal().tolist()) / 8.0)
    if (
        not sigma_m <= settings.max_sigma_m
        or ambiguity > settings.max_ambiguity
        or rms_px > max(WORST_PX, WORST_SHARE * side_px)
    ):
        return Missed(MissReason.POSE_UNCERTAIN)
    candidates = (PoseCandidate(Pose(fitted.R, fitted.t), fitted.cost, 1.0),)
    if math.isfinite(fitted.other_cost):
        other = Pose(fitted.other_R, fitted.other_t)
        candidates += (PoseCandidate(other, fitted.other_cost, min(1.0, likelihood)),)
    return MarkerPose(
        candidates[0].T_c_v,
        fitted.covariance,
        incidence,
        side_px,
        rms,
        ambiguity,
        candidates,
    )


def _without_bad_corner(
    starts_R: Array,
    starts_t: Array,
    seen: Sequence[tuple[MarkerDetection, Marker]],
    whole: PoseProblem,
    fitted: PoseFit,
) -> tuple[PoseProblem, PoseFit]:
    """Return the problem without the one corner that is off, and its fit; as they were where no
    single corner, or more than one, explains that nothing fits.

    Three corners and gravity are two numbers more than a pose has: without the corner that is off
    they agree, and without any other they do not.
    """
    found: list[tuple[float, PoseProblem, PoseFit]] = []
    for marker, (each, _) in enumerate(seen):
        for corner in range(4):
            covariance = np.array(each.covariance_px2, np.float64)
            for row in (2 * corner, 2 * corner + 1):
                covariance[row, row] += LEFT_OUT_PX2
            whiteners = whole.whitening.copy()
            whitening(covariance, MIN_CORNER_SIGMA_PX**2, whiteners[marker])
            rest = whole._replace(whitening=whiteners)
            fit_of_rest = fit(starts_R, starts_t, rest)
            found.append((fit_of_rest.cost, rest, fit_of_rest))
    found.sort(key=lambda each: each[0])
    cost, rest, fit_of_rest = found[0]
    explains = cost <= MISFIT * (2 * len(whole.points) - 6)
    alone = found[1][0] - cost > BAD
    return (rest, fit_of_rest) if explains and alone else (whole, fitted)


def _contradicted(
    starts_R: Array,
    starts_t: Array,
    whole: PoseProblem,
    layout: MarkerLayout,
    camera: CameraModel,
) -> str | None:
    """Return the likely cause where gravity is against all that the corners alone allow; None where
    they bear it.

    Corners that fit badly allow much: by how much they are off, and what the calibration does not
    know, is in the covariance of the pose that they give alone.
    """
    corners = whole._replace(weight=0.0)
    alone = fit(starts_R, starts_t, corners)
    if not math.isfinite(alone.sigma_m):
        return None
    if camera.doubts:
        widen(
            alone.R, alone.t, corners.points, corners.pixels, corners.whitening, corners.lens, corners.down, 0.0,
            _doubts(camera), alone.covariance,
        )  # fmt: skip
    poses_R = [alone.R]
    if math.isfinite(alone.other_cost) and alone.other_cost - alone.cost < ABSURD * alone.misfit:
        poses_R.append(alone.other_R)
    down_v = whole.down[:3]
    down_c = whole.down[3:]
    turn_rad2 = float(np.linalg.eigvalsh(alone.covariance[3:, 3:])[-1])
    variance = 1.0 / whole.weight + turn_rad2
    off2 = min(float(((R @ down_v - down_c) ** 2).sum()) for R in poses_R)
    if off2 < 2.0 * ABSURD * variance:
        return None
    return likely_cause(poses_R, down_v.tolist(), down_c.tolist(), layout)


def _seen(
    seen: Sequence[tuple[MarkerDetection, Marker]],
    camera: CameraModel,
    gravity_v: Vec3 | None,
    gravity_c: Vec3 | None,
    settings: PoseSettings,
) -> PoseProblem:
    points, middles, sizes = _prints(tuple([marker for _, marker in seen]))
    corners = [np.asarray(found.corners_px, np.float64) for found, _ in seen]
    pixels = np.ascontiguousarray(corners[0] if len(corners) == 1 else np.concatenate(corners))
    whiteners = np.zeros((len(seen), 8, 8))
    for (each, _), whitener in zip(seen, whiteners, strict=True):
        if not whitening(
            np.ascontiguousarray(each.covariance_px2),
            MIN_CORNER_SIGMA_PX**2,
            whitener,
        ):
            raise np.linalg.LinAlgError(
                f"marker {each.marker_id}: its covariance is not positive definite"
            )
    down = NO_GRAVITY
    weight = 0.0
    if gravity_v is not None and gravity_c is not None:
        # the misfit of one direction turned into the other has the errors of both
        variance = settings.attitude_v_sigma_rad**2 + settings.attitude_c_sigma_rad**2
        down = np.array([*gravity_v, *gravity_c])
        weight = 1.0 / max(variance, MIN_GRAVITY_RAD**2)
    focal = 0.0 if camera.doubts else settings.focal_sigma
    return PoseProblem(
        points,
        pixels,
        whiteners,
        lens_of(camera),
        down,
        weight,
        middles,
        sizes,
        focal,
        settings.shape_sigma,
    )


@lru_cache(maxsize=8)
def _doubts(camera: CameraModel) -> Array:
    """Return ``CameraModel.doubts`` as the kernel takes them, (k, 9). Shared: do not change it."""
    return np.array(camera.doubts, np.float64).reshape(-1, 9)


@lru_cache(maxsize=64)
def _prints(markers: tuple[Marker, ...]) -> tuple[Array, Array, Array]:
    """Corners (4 m, 3) and centres (m, 3) in ``v`` of some markers, and how well their sides are
    known, relative (m,).

    Shared: do not change them.
    """
    points = np.array([marker.corners_v for marker in markers]).reshape(-1, 3)
    middles = np.array([marker.T_v_m.t for marker in markers])
    return points, middles, np.array([marker.side_sigma_m / marker.side_m for marker in markers])


def _known(
    detections: Sequence[MarkerDetection], layout: MarkerLayout
) -> list[tuple[MarkerDetection, Marker]] | Missed:
    """Every detection with its marker."""
    if not detections:
        return Missed(MissReason.NO_MARKER)
    seen = [
        (found, marker)
        for found in detections
        if (marker := layout.marker(found.marker_id)) is not None
    ]
    if not seen:
        return Missed(MissReason.WRONG_MARKER)
    if len(seen) > 1 and len({marker.id for _, marker in seen}) < len(seen):
        return Missed(MissReason.MARKER_TWICE)
    for found, _ in seen:
        if not (
            finite(np.ascontiguousarray(found.corners_px))
            and finite(np.ascontiguousarray(found.covariance_px2))
        ):
            return Missed(MissReason.NON_FINITE)
    return seen


def _side_px(found: MarkerDetection) -> float:
    a, b, c, d = found.corners_px.tolist()
    return 0.25 * (math.dist(a, b) + math.dist(b, c) + math.dist(c, d) + math.dist(d, a))


def _ippe(
    found: MarkerDetection,
    marker: Marker,
    lens: Array,
) -> tuple[Array, Array]:
    """Return both planar solutions as poses of ``v`` in the camera, (n, 3, 3) and (n, 3)."""
    seen = rays(np.ascontiguousarray(found.corners_px), lens)
    square = _square(marker.side_m)
    try:
        solved: Any = cv2.solvePnPGeneric(square, seen, EYE, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    _, turns, shifts, _ = solved
    return of_layout(
        np.array(turns),
        np.array(shifts),
        np.ascontiguousarray(marker.T_v_m.R),
        marker.T_v_m.t,
    )


@lru_cache(maxsize=8)
def _square(side_m: float) -> Array:
    """Corners of a marker in its own frame, shape (4, 3). Shared: do not change it."""
    h = 0.5 * side_m
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
