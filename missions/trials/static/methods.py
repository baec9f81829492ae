"""The errors of D2's and the target's place from one sighting, by method, under errors of calibration, print, attitude.

What a method is told (print, cameras, mounting, attitudes) is the truth with the errors of its session; it is never
told the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.trials.static.shots import StaticMeasurement
from missions.trials.static.stage import CAMERA, SIDE_M, STANDS, Mounts
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry import rotation
from path.geometry.rigid import rigid
from path.geometry.transforms import Matrix, Pose, Vector
from path.marker.layout import MarkerLayout, single_marker
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Vec3
from path.observations import MarkerDetection
from path.target.place import locate

Method = Literal["ippe", "gravity_subpix", "photometric", "gravity_photometric"]
METHODS: tuple[Method, ...] = ("ippe", "gravity_subpix", "photometric", "gravity_photometric")
CORNERS: dict[Method, str] = {
    "ippe": "subpix",
    "gravity_subpix": "subpix",
    "photometric": "photometric",
    "gravity_photometric": "photometric",
}

SIDE_SIGMA, FOCAL_SIGMA = 0.005, 0.002  # relative
MOUNT_SIGMA_RAD, MOUNT_SIGMA_M = math.radians(0.2), 0.0015  # root mean square of angle and length, of T_v_c1
BIAS_SIGMA_RAD, NOISE_SIGMA_RAD = math.radians(0.5), math.radians(0.2)  # per axis, of each drone's roll and pitch
SETTINGS = PoseSettings(focal_sigma=FOCAL_SIGMA)  # attitude sigmas as in flight
NEVER_REFUSES = replace(SETTINGS, max_incidence_rad=math.pi, max_sigma_m=math.inf, max_ambiguity=1.0)
FLIPPED_RAD = math.radians(10.0)
SESSION_STREAM, FRAME_STREAM = 2, 3

DEPTH_SIGMA_AT_1M_M = 0.005  # common to the whole target, in a comparison only; grows with the square of the depth

Error = Literal["side", "focal", "mount", "bias", "noise", "depth", "wide"]
ALL: tuple[Error, ...] = ("side", "focal", "mount", "bias", "noise")
"""The errors of the trial: print, focal lengths, mounting, attitude biases, attitude noise. Beside them, for
comparison: "depth", wrong over the whole target, and "wide", depth from a larger part of its box."""


@dataclass(frozen=True, slots=True)
class MethodErrors:
    """The errors of one measurement.

    Attributes:
        side: of the marker's printed side, relative.
        focal: of each camera's focal length, relative.
        mount_rad, mount_m: of ``T_v_c1``.
        attitude_rad: (2, 2): of each drone's roll and pitch.
        depth_m: of the target's depth at 1 m.
        wide: depth is taken from a larger part of the target's box.
    """

    side: float
    focal: tuple[float, float]
    mount_rad: Vector
    mount_m: Vector
    attitude_rad: Matrix
    depth_m: float
    wide: bool


def errors_of(seed: int, configuration: int, session: int, on: tuple[Error, ...]) -> MethodErrors:
    """The errors of a measurement; ``on`` names those that are switched on.

    Print, focal lengths, mounting and attitude biases are those of the session, the same in all configurations.
    """
    rng = np.random.default_rng([seed, SESSION_STREAM, session])
    side, focal = SIDE_SIGMA * rng.normal(), FOCAL_SIGMA * rng.normal(size=2)
    turned, moved = MOUNT_SIGMA_RAD * rng.normal(size=3), MOUNT_SIGMA_M * rng.normal(size=3)
    turned, moved = turned / math.sqrt(3.0), moved / math.sqrt(3.0)
    bias = BIAS_SIGMA_RAD * rng.normal(size=(2, 2))
    frame = np.random.default_rng([seed, FRAME_STREAM, configuration, session])
    noise = NOISE_SIGMA_RAD * frame.normal(size=(2, 2))
    return MethodErrors(
        float(side) * ("side" in on),
        (float(focal[0]) * ("focal" in on), float(focal[1]) * ("focal" in on)),
        turned * ("mount" in on),
        moved * ("mount" in on),
        bias * ("bias" in on) + noise * ("noise" in on),
        DEPTH_SIGMA_AT_1M_M * float(frame.normal()) * ("depth" in on),
        "wide" in on,
    )


@dataclass(frozen=True, slots=True)
class MethodResult:
    """Errors of one method in one measurement.

    Attributes:
        d2_m: of D2's camera in ``v``.
        rotation_rad: of the relative rotation.
        target_m: of the target's point in D2's camera; NaN when D1 did not see it.
        sent_m: of the target's point that D1 sends, in ``v``; the same for all methods.
        nees: squared error of the pose in units of its covariance, 6 on average when that is right; NaN without one.
    """

    d2_m: float
    rotation_rad: float
    target_m: float
    sent_m: float
    nees: float


@dataclass(frozen=True, slots=True)
class Results:
    """One method over all measurements: each (sessions, stands), NaN where it gave no pose."""

    d2_m: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]
    target_m: NDArray[np.float64]
    sent_m: NDArray[np.float64]
    nees: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Judging:
    """A method, on some sightings, under some errors."""

    sightings: Sequence[StaticMeasurement]
    mounts: Mounts
    seed: int
    method: Method
    on: tuple[Error, ...] = ALL


def measure(judging: Judging) -> Results:
    """A piece of work."""
    sessions = 1 + max(sighting.session for sighting in judging.sightings)
    table = np.full((5, sessions, len(STANDS)), np.nan)
    for sighting in judging.sightings:
        errors = errors_of(judging.seed, sighting.configuration, sighting.session, judging.on)
        outcome = judge(sighting, judging.mounts, judging.method, errors)
        table[:, sighting.session, sighting.configuration] = (
            outcome.d2_m, outcome.rotation_rad, outcome.target_m, outcome.sent_m, outcome.nees,
        )  # fmt: skip
    return Results(*table)


def judge(sighting: StaticMeasurement, mounts: Mounts, method: Method, errors: MethodErrors) -> MethodResult:
    """One method on one sighting, told what its session believes."""
    truth, found = sighting.T_c2_v, sighting.markers[CORNERS[method]]
    sent_v, true_v = sent_point(sighting, mounts, errors), _true_point(sighting, mounts)
    sent_m = math.nan if sent_v is None or true_v is None else float(np.linalg.norm(sent_v - true_v))
    refused = MethodResult(math.nan, math.nan, math.nan, sent_m, math.nan)
    if found is None:
        return refused
    layout, camera, nees = believed_layout(errors), focused(CAMERA, errors.focal[1]), math.nan
    if method == "ippe":
        pose = first_ippe(found, layout, camera)
    else:
        estimate = estimated(sighting, mounts, method, errors, found)
        if estimate is None:
            return refused
        pose = estimate.T_c_v
        e = np.concatenate([pose.t - truth.t, rotation.log(pose.R @ truth.R.T)])
        nees = float(e @ np.linalg.solve(estimate.covariance, e))
    target_m = math.nan
    if sent_v is not None and true_v is not None:
        target_m = float(np.linalg.norm(pose.apply(sent_v) - truth.apply(true_v)))
    d2_m = float(np.linalg.norm(pose.inverse().t - truth.inverse().t))
    return MethodResult(d2_m, rotation.angle_between(pose.R, truth.R), target_m, sent_m, nees)


def _true_point(sighting: StaticMeasurement, mounts: Mounts) -> Vector | None:
    """The target's point in ``v`` as it truly is."""
    return None if sighting.target is None else mounts.T_v_c1.apply(sighting.target.point_c1_m)


def estimated(
    sighting: StaticMeasurement, mounts: Mounts, method: Method, errors: MethodErrors, found: MarkerDetection
) -> MarkerPose | None:
    """The project's pose, with or without gravity; None when it is refused."""
    down_v = down_c = None
    if method != "photometric":
        down_v = _felt(sighting.gravity_b1, errors.attitude_rad[0], mounts.T_b_v)
        down_c = _felt(sighting.gravity_b2, errors.attitude_rad[1], mounts.T_b_c2)
    settings = NEVER_REFUSES if method == "photometric" else SETTINGS
    layout, camera = believed_layout(errors), focused(CAMERA, errors.focal[1])
    pose = estimate_pose((found,), layout, camera, down_v, down_c, settings)
    return pose if isinstance(pose, MarkerPose) else None


def believed_layout(errors: MethodErrors) -> MarkerLayout:
    """Returns the layout as the print is believed to be; ``side`` is by how much that is too large."""
    return single_marker(SIDE_M * (1.0 + errors.side), SIDE_M * SIDE_SIGMA)


def focused(camera: CameraModel, error: float) -> CameraModel:
    return replace(camera, fx=camera.fx * (1.0 + error), fy=camera.fy * (1.0 + error))


def believed_mounting(mounts: Mounts, errors: MethodErrors) -> Pose:
    true = mounts.T_v_c1
    return Pose(rotation.exp(errors.mount_rad) @ true.R, true.t + errors.mount_m)


def sent_point(sighting: StaticMeasurement, mounts: Mounts, errors: MethodErrors) -> Vector | None:
    """The target in ``v`` as D1 sends it (eqs. target_backprojection, target_virtual)."""
    seen = sighting.target
    depth = None if seen is None else seen.wide_depth if errors.wide else seen.depth
    if seen is None or depth is None:
        return None
    measured = replace(depth, z_m=depth.z_m + errors.depth_m * depth.z_m**2)
    camera, T_v_c1 = focused(CAMERA, errors.focal[0]), rigid(believed_mounting(mounts, errors))
    return np.array(locate(camera, T_v_c1, seen.box, measured, MethodConfig()).point_v_m)


def first_ippe(found: MarkerDetection, layout: MarkerLayout, camera: CameraModel) -> Pose:
    """The first of OpenCV's two solutions, the one with the smaller reprojection error."""
    solved: Any = cv2.solvePnPGeneric(
        layout.markers[0].corners_v, camera.rays(found.corners_px), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    _, turns, shifts, _ = solved
    return Pose(rotation.exp(turns[0].ravel()), shifts[0].ravel())


def _felt(gravity_b: Vector, error_rad: Vector, T_b_x: Pose) -> Vec3:
    """Gravity in a frame on a body whose roll and pitch are wrong."""
    turned = rotation.exp(np.array([error_rad[0], error_rad[1], 0.0])) @ gravity_b
    x, y, z = (T_b_x.R.T @ turned).tolist()
    return x, y, z
