"""The errors of D2's and the target's place from one sighting, by method, under errors of
calibration, print, attitude.

What a method is told (print, cameras, mounts, attitudes) is the truth with the errors of its
session, from the world's table; it is never told the truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import cv2
import numpy as np

from flight.harness.errors import DepthError, DrawnErrors
from missions.trials.pose.static.shots import LAYOUT, StaticMeasurement
from missions.trials.pose.static.stage import CAMERA, STANDS, Mounts
from path.arrays import Array
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews
from path.geometry import rotation
from path.geometry.rigid import rigid
from path.geometry.transforms import Matrix, Pose, Vector
from path.marker.layout import MarkerLayout
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Role, Vec3
from path.observations import MarkerDetection
from path.target.place import locate
from path.values import frozen

Method = Literal["ippe", "gravity_subpix", "photometric", "gravity_photometric"]
METHODS: tuple[Method, ...] = ("ippe", "gravity_subpix", "photometric", "gravity_photometric")
CORNERS: dict[Method, str] = {
    "ippe": "subpix",
    "gravity_subpix": "subpix",
    "photometric": "photometric",
    "gravity_photometric": "photometric",
}

SETTINGS = PoseSettings()  # as in flight
NEVER_REFUSES = replace(
    SETTINGS,
    max_incidence_rad=math.pi,
    max_sigma_m=math.inf,
    max_ambiguity=1.0,
)
FLIPPED_RAD = math.radians(10.0)
SESSION_STREAM = 2
FRAME_STREAM = 3

Error = Literal["side", "optics", "mount", "bias", "noise", "depth", "narrow"]
ALL: tuple[Error, ...] = ("side", "optics", "mount", "bias", "noise", "depth")
"""The errors of the trial: print, cameras, mounts, attitude biases, attitude noise, depth. Beside
them, for comparison: "narrow", depth from a smaller part of the target's box."""


@frozen
class MethodErrors:
    """The drones' beliefs in one measurement, and the errors of their sensors.

    Attributes:
        attitude_rad: (2, 2): errors of each drone's roll and pitch.
        depth: of D1's camera.
        narrow: depth is taken from a smaller part of the target's box.
    """

    cameras: Mapping[Role, CameraModel]
    mounts: Mounts
    layout: MarkerLayout
    attitude_rad: Matrix
    depth: DepthError
    narrow: bool = False


def session_seed(seed: int, session: int) -> int:
    """Return the seed of a session's errors, which are the same in all configurations."""
    return int(np.random.SeedSequence([seed, SESSION_STREAM, session]).generate_state(1)[0])


def errors_of(
    drawn: DrawnErrors,
    mounts: Mounts,
    frame: tuple[int, int, int],
    on: tuple[Error, ...],
) -> MethodErrors:
    """The errors of a measurement; ``on`` names those that are switched on.

    Args:
        drawn: the errors of its session; ``mounts`` the true ones.
        frame: seed, configuration and session: of the noise of its attitudes.
    """
    noise = drawn.tilt_noise_rad * np.random.default_rng(
        [frame[0], FRAME_STREAM, *frame[1:]]
    ).normal(size=(2, 2))
    bias = np.array([drawn.tilt_bias_rad[role] for role in Role])
    believed = Mounts(drawn.T_b_c[Role.SENDER], drawn.T_b_v, drawn.T_b_c[Role.RECEIVER])
    return MethodErrors(
        drawn.cameras if "optics" in on else dict.fromkeys(Role, CAMERA),
        believed if "mount" in on else mounts,
        drawn.layout if "side" in on else LAYOUT,
        bias * ("bias" in on) + noise * ("noise" in on),
        drawn.depth[Role.SENDER] if "depth" in on else DepthError(),
        "narrow" in on,
    )


@frozen
class Results:
    """Errors of one method over all measurements: each (sessions, stands), NaN where it gave no
    pose.

    Attributes:
        d2_m: of D2's camera in ``v``.
        rotation_rad: of the relative rotation.
        target_m: of the target's point in D2's camera; NaN when D1 did not see it.
        sent_m: of the target's point that D1 sends, in ``v``; the same for all methods.
        nees: squared error of the pose in units of its covariance, 6 on average when that is right;
            NaN without one.
    """

    d2_m: Array
    rotation_rad: Array
    target_m: Array
    sent_m: Array
    nees: Array

    @classmethod
    def of(cls, sessions: int) -> Results:
        """Return results of so many sessions in which there is nothing yet."""
        return cls(*np.full((5, sessions, len(STANDS)), np.nan))


def measure(
    sightings: Sequence[StaticMeasurement],
    mounts: Mounts,
    sessions: Sequence[DrawnErrors],
    seed: int,
    method: Method,
    on: tuple[Error, ...] = ALL,
) -> Results:
    """Try a method on some sightings, under some errors; ``sessions`` are those of each session."""
    results = Results.of(1 + max(sighting.session for sighting in sightings))
    for sighting in sightings:
        frame = seed, sighting.configuration, sighting.session
        errors = errors_of(sessions[sighting.session], mounts, frame, on)
        judge(results, sighting, mounts, method, errors)
    return results


def judge(
    results: Results,
    sighting: StaticMeasurement,
    mounts: Mounts,
    method: Method,
    errors: MethodErrors,
) -> None:
    """Put one method's errors on one sighting into its results, told what its session believes."""
    at = sighting.session, sighting.configuration
    truth = sighting.T_c2_v
    found = sighting.markers[CORNERS[method]]
    sent_v = sent_point(sighting, errors)
    true_v = _true_point(sighting, mounts)
    if sent_v is not None and true_v is not None:
        results.sent_m[at] = np.linalg.norm(sent_v - true_v)
    if found is None:
        return
    if method == "ippe":
        pose = first_ippe(found, errors.layout, errors.cameras[Role.RECEIVER])
    else:
        estimate = estimated(sighting, method, errors, found)
        if estimate is None:
            return
        pose = estimate.T_c_v
        e = np.concatenate([pose.t - truth.t, rotation.log(pose.R @ truth.R.T)])
        results.nees[at] = e @ np.linalg.solve(estimate.covariance, e)
    if sent_v is not None and true_v is not None:
        results.target_m[at] = np.linalg.norm(pose.apply(sent_v) - truth.apply(true_v))
    results.d2_m[at] = np.linalg.norm(pose.inverse().t - truth.inverse().t)
    results.rotation_rad[at] = rotation.angle_between(pose.R, truth.R)


def _true_point(sighting: StaticMeasurement, mounts: Mounts) -> Vector | None:
    """The target's point in ``v`` as it truly is."""
    return None if sighting.target is None else mounts.T_v_c1.apply(sighting.target.point_c1_m)


def estimated(
    sighting: StaticMeasurement,
    method: Method,
    errors: MethodErrors,
    found: MarkerDetection,
) -> MarkerPose | None:
    """The project's pose, with or without gravity; None when it is refused."""
    down_v = down_c = None
    if method != "photometric":
        down_v = _felt(sighting.gravity_b1, errors.attitude_rad[0], errors.mounts.T_b_v)
        down_c = _felt(sighting.gravity_b2, errors.attitude_rad[1], errors.mounts.T_b_c2)
    settings = NEVER_REFUSES if method == "photometric" else SETTINGS
    pose = estimate_pose(
        (found,),
        errors.layout,
        errors.cameras[Role.RECEIVER],
        down_v,
        down_c,
        settings,
    )
    return pose if isinstance(pose, MarkerPose) else None


def sent_point(sighting: StaticMeasurement, errors: MethodErrors) -> Vector | None:
    """The target in ``v`` as D1 sends it (eqs. target_backprojection, target_virtual)."""
    seen = sighting.target
    depth = None if seen is None else seen.narrow_depth if errors.narrow else seen.depth
    if seen is None or depth is None:
        return None
    measured = replace(depth, z_m=errors.depth.measured_m(depth.z_m))
    views = TwoViews(
        errors.cameras[Role.SENDER],
        errors.cameras[Role.RECEIVER],
        rigid(errors.mounts.T_v_c1),
    )
    return np.array(locate(views, seen.box, measured, MethodConfig()).point_v_m)


def first_ippe(
    found: MarkerDetection,
    layout: MarkerLayout,
    camera: CameraModel,
) -> Pose:
    """The first of OpenCV's two solutions, the one with the smaller reprojection error."""
    solved: Any = cv2.solvePnPGeneric(
        layout.markers[0].corners_v,
        camera.rays(found.corners_px),
        np.eye(3),
        None,
        flags=cv2.SOLVEPNP_IPPE_SQUARE,
    )
    _, turns, shifts, _ = solved
    return Pose(rotation.exp(turns[0].ravel()), shifts[0].ravel())


def _felt(
    gravity_b: Vector,
    error_rad: Vector,
    T_b_x: Pose,
) -> Vec3:
    """Gravity in a frame on a body whose roll and pitch are wrong."""
    turned = rotation.exp(np.array([error_rad[0], error_rad[1], 0.0])) @ gravity_b
    x, y, z = (T_b_x.R.T @ turned).tolist()
    return x, y, z
