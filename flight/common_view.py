"""Common views in flight: keyframes of a drone's frames, and the marker's pose by two of them.

D1 makes a keyframe of a frame every ``KEYFRAME_S`` and sends it in parts, which takes as long. D2
compares its own newest frames with it (``path.common_view``): the ground does not move, and how far
D1 has flown since, D1 reports. Who does that when is ``missions.fly.leg.keyframes``.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.interfaces import Frame
from flight.config import MissionConfig
from path.arrays import Array
from path.camera.model import CameraModel
from path.common_view.estimate import (
    ERROR_OF_YAW_RAD,
    CommonView,
    Settings,
    common_view,
)
from path.common_view.keyframe import Keyframe
from path.common_view.parts import KeyframeSource, part_count
from path.common_view.read import SENT, RgbdCamera, Size, read_keyframe
from path.common_view.search import Prior
from path.common_view.straight import Straightened, straight
from path.config import MethodConfig
from path.geometry.transforms import Matrix, Pose
from path.relative_pose.filter import Relative
from path.values import frozen

KEYFRAME_S = 2.05
"""From one keyframe of D1 to the next, over which its parts are spread."""
HEADINGS_SIGMA_RAD = math.radians(5.0)
"""Between what both drones take for north."""
REPORTED_MPS = 0.015
"""By how much a drone's reported place is off where it was, in a second, besides."""
FLOWN = Settings(least_corners=8)
"""In flight, over floors: those that were off by 0.9 to 3.2 m had two corners at the most."""
COMMON_SHARE = 0.03
"""Of the range: what lasts in a common view, of both depths and of D1's reported places."""
SURE_TIMES = 3.0
"""Of the filter's standard deviation, that of a prior."""
WITHIN_SIGMAS = 2.0
"""Of a position, ``rendezvous.positions_within_m`` and ``heights_within_m`` are so many."""


def parts_hz() -> float:
    """Return how many parts of keyframes D1 sends a second, at the most."""
    return part_count(SENT.points, SENT) / KEYFRAME_S


def keyframe_source(
    camera: CameraModel, method: MethodConfig, mission: MissionConfig
) -> KeyframeSource:
    """Return what D2 knows of the keyframes of D1's camera."""
    gravity_rad = math.radians(mission.attitude_sigma_deg)
    return KeyframeSource(straight(camera), SENT, method.depth_sigma_at_1m_m, gravity_rad)


class KeyframeReader:
    """Makes keyframes of one camera's frames, whose depth is registered to their colour."""

    def __init__(self, source: KeyframeSource, camera: CameraModel) -> None:
        self._source = source
        lens = source.camera
        self._camera = RgbdCamera(lens, lens, None, source.depth_sigma_at_1m_m)
        self._straightened = Straightened(camera)

    def read(
        self, frame: Frame, R_n_c: Matrix, size: Size, patch_m: float | None = None
    ) -> Keyframe:
        """Return the keyframe of a frame that has depth.

        Args:
            R_n_c: the camera's attitude, by its drone.
            patch_m: of the keyframe that it is to be compared with.
        """
        assert frame.depth_mm is not None, "a camera without depth is refused before"
        color, depth = self._straightened.pictures(frame.color, frame.depth_mm)
        metres = np.asarray(depth, np.float32) * np.float32(0.001)
        gravity_rad = self._source.gravity_sigma_rad
        return read_keyframe(color, metres, self._camera, R_n_c, gravity_rad, size, patch_m)


def prior_of(way_n_m: Array, mission: MissionConfig) -> Prior:
    """Return what reports say of D2's camera in the levelled frame of D1's.

    ``way_n_m``: from D1's camera to D2's, by both reported positions.
    """
    rendezvous = mission.rendezvous
    across_m = rendezvous.positions_within_m / WITHIN_SIGMAS
    sigma = np.array([across_m, across_m, rendezvous.heights_within_m / WITHIN_SIGMAS])
    return Prior(0.0, HEADINGS_SIGMA_RAD, way_n_m, sigma)


def prior_by(
    relative: Relative, marker_l1: Array, R_n_c: Matrix, R_n_v: Matrix, range_m: float
) -> Prior:
    """Return the same by where the filter has the marker: wide enough not to count it twice, and
    for a common view that errs more than a marker.

    Args:
        range_m: of what is looked at.
        marker_l1: from D1's camera, when its keyframe was taken, to the marker now, in ``n``.
        R_n_c, R_n_v: attitudes of D2's camera and of the marker, by their drones.
    """
    T_c_v = relative.T_c_v
    R_l1_l2 = R_n_v @ T_c_v.R.T @ R_n_c.T
    way = marker_l1 - R_n_v @ (T_c_v.R.T @ T_c_v.t)
    sigma = np.full(3, SURE_TIMES * math.hypot(relative.sigma_m, COMMON_SHARE * range_m))
    turn2 = float(np.trace(relative.covariance[3:, 3:])) / 3.0
    turn_rad = math.sqrt(turn2 + ERROR_OF_YAW_RAD**2)
    yaw_rad = math.atan2(R_l1_l2[1, 0], R_l1_l2[0, 0])
    return Prior(yaw_rad, min(HEADINGS_SIGMA_RAD, SURE_TIMES * turn_rad), way, sigma)


@frozen(eq=False)
class MeasuredPose:
    """The marker's frame as D2 measured it: ``T_c_v``, with the covariance (6, 6) of
    ``path.marker.pose``.
    """

    T_c_v: Pose
    covariance: Array


def marker_pose(found: CommonView, first: Keyframe, second: Keyframe, T_c1_v: Pose) -> MeasuredPose:
    """Return D1's marker in D2's camera, by where that is in D1's levelled frame.

    What is known only to gravity's errors, the tilt between both levelled frames, is so many
    independent errors of the pose.

    Args:
        first, second: D1's keyframe and D2's. ``T_c1_v``: D1's marker in D1's camera.
    """
    R_c2_l1 = second.R_l_c.T @ found.R_l1_l2.T
    v_l1 = first.R_l_c @ T_c1_v.t
    R_c2_v = R_c2_l1 @ first.R_l_c @ T_c1_v.R
    t = R_c2_l1 @ (v_l1 - found.t_m)

    # A turn w of the second levelled frame from the left, and dt: R_c2_l1 turns by -w, and with it
    # the way to the marker.
    way = v_l1 - found.t_m
    crossed = np.array([[0.0, -way[2], way[1]], [way[2], 0.0, -way[0]], [-way[1], way[0], 0.0]])
    tilt2 = first.gravity_sigma_rad**2 + second.gravity_sigma_rad**2
    error = np.zeros((6, 6))
    error[np.ix_((0, 1, 2, 5), (0, 1, 2, 5))] = found.covariance
    error[3, 3] = tilt2
    error[4, 4] = tilt2
    J = np.zeros((6, 6))
    J[:3, :3] = -R_c2_l1
    J[:3, 3:] = R_c2_l1 @ crossed
    J[3:, 3:] = -R_c2_l1
    return MeasuredPose(Pose(R_c2_v, t), J @ error @ J.T)


def flown_on(
    seen: MeasuredPose, then: Matrix, now: Matrix, flown_n_m: Array, since_s: float
) -> MeasuredPose:
    """Return the marker's pose after D1 has flown on.

    Args:
        then, now: ``R_n_v``, as D1 reports it. ``flown_n_m``: how far the marker has come, by D1's
            reports.
    """
    R_c_n = seen.T_c_v.R @ then.T
    covariance = seen.covariance.copy()
    covariance[:3, :3] += (REPORTED_MPS * since_s) ** 2 * np.eye(3)
    return MeasuredPose(Pose(R_c_n @ now, seen.T_c_v.t + R_c_n @ flown_n_m), covariance)


def warm_up() -> None:
    """Compile, or load from numba's cache, what a common view computes, before a flight needs
    it.
    """
    rng = np.random.default_rng(0)
    lens = CameraModel(160, 120, 150.0, 150.0, 80.0, 60.0, (0.01, 0.0, 0.0, 0.0, 0.0))
    source = KeyframeSource(straight(lens), SENT, 0.005, math.radians(0.5))
    grey = np.kron(rng.integers(0, 256, (30, 40)), np.ones((4, 4)))
    color = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    depth = np.full((120, 160), 2000, np.uint16)
    depth[40:80, 60:120] = 1500
    reader = KeyframeReader(source, lens)
    frame = Frame(1, 1, color, depth)
    first = reader.read(frame, np.eye(3), SENT)
    second = reader.read(frame, np.eye(3), SENT, first.patch_m)
    common_view(first, second, prior_of(np.zeros(3), MissionConfig()))
