"""The sender's marker as the receiver sees it: where to look, the pose, and the way there is
left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.interfaces import View
from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.guidance import Vec3
from path.camera.kernels import extent, lens_of
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.geometry.transforms import Matrix, Pose
from path.marker.layout import MarkerLayout
from path.marker.pose import PoseSettings, estimate_pose
from path.observations import MarkerDetection, Missed, MissReason, Region
from path.relative_pose.filter import Relative, RelativeFilter, RelativeSettings, Source
from path.values import value

# around the markers' corners; a plate that is turned by so much more
_ROOM_M = 0.012
_TURN_RAD = 0.1
_NEAREST_M = 0.1  # a corner that would be nearer is none
_FIXED_NS = 500_000_000  # fixes older than this do not count towards "seen"
_FIXED_FRAMES = 8
_COMMON_NS = 2_000_000_000  # so long back common views count towards "found"
_COMMON_VIEWS = 2  # that agree: one could be anywhere
_FIXES = 5
_COMMON_COAST_S = 3.0  # from a common view on: some are not known
_EXPECTED_S = 0.15  # after a fix a marker is expected at one place; later it must be searched for


@value
class MarkerFix:
    """A pose good enough to use, and the corners it came from; none where common views carry
    it.
    """

    T_c_v: Pose
    covariance: Matrix
    side_px: float
    detections: Sequence[MarkerDetection]

    @property
    def carried_by(self) -> Source:
        """Return what the pose rests on."""
        return Source.MARKER if self.detections else Source.COMMON_VIEW


@value
class VehicleMotions:
    """The motion of both vehicles as they report it. Stamps are of the receiver's clock."""

    own_stamp_ns: int
    own_n_mps: Vec3
    peer_stamp_ns: int
    peer_n_mps: Vec3
    peer_yaw_rad: float


class MarkerView:
    """Marker measurements of one receiver over time. Not for two cameras."""

    def __init__(
        self,
        layout: MarkerLayout,
        camera: CameraModel,
        mount: Mount,
        method: MethodConfig,
        mission: MissionConfig,
    ) -> None:
        self._layout = layout
        self._camera = camera
        self._lens = lens_of(camera)
        self._R_b_v = mount.T_b_v.R
        self._corners_v = np.concatenate([marker.corners_v for marker in layout.markers])
        self._room_m = _ROOM_M + _TURN_RAD * float(np.linalg.norm(self._corners_v, axis=1).max())
        self._settings = PoseSettings(
            attitude_v_sigma_rad=math.radians(mission.attitude_sigma_deg),
            attitude_c_sigma_rad=math.radians(mission.attitude_sigma_deg),
            max_incidence_rad=math.radians(method.max_incidence_deg),
            max_sigma_m=method.max_pose_sigma_m,
        )
        self._filter = RelativeFilter(
            _relative_settings(mission, method.common_view),
            lever_c_m=mount.T_b_c.R.T @ mount.T_b_c.t,
            lever_v_m=mount.T_b_v.R.T @ mount.T_b_v.t,
        )
        self._motion: VehicleMotions | None = None
        self._fixes: list[int] = []
        self._common: list[int] = []
        self._looked_ns = 0
        self._frame_ns = 0  # between the two newest views
        self._searched_ns = 0
        self._search_period_ns = round(1e9 / mission.search_hz)
        # times as rarely as the mission says, on a computer that does not keep up
        self.search_every = 1
        self.target_n_m: Vec3 | None = None
        # the marker's attitude at the newest look, as its drone reports it
        self.R_n_v: Matrix | None = None

    def fixes(self, now_ns: int) -> int:
        """Return the number of poses found in the last half second, or in the last eight frames if
        that is longer.
        """
        lately_ns = max(_FIXED_NS, _FIXED_FRAMES * self._frame_ns)
        self._fixes = [stamp_ns for stamp_ns in self._fixes if now_ns - stamp_ns < lately_ns]
        return len(self._fixes)

    def found(self, now_ns: int) -> bool:
        """Return whether the marker's pose is known, by the marker or by common views."""
        if self.fixes(now_ns) >= _FIXES:
            return True
        self._common = [stamp_ns for stamp_ns in self._common if now_ns - stamp_ns < _COMMON_NS]
        return len(self._common) >= _COMMON_VIEWS

    def note_common_view(
        self, stamp_ns: int, T_c_v: Pose, covariance: Matrix, R_n_c: Matrix, R_n_v: Matrix
    ) -> Missed | None:
        """Take the marker's pose at an earlier instant by a common view; return why it is not
        used.
        """
        refused = self._filter.update(stamp_ns, T_c_v, covariance, R_n_c, R_n_v, Source.COMMON_VIEW)
        if refused is None:
            self._common.append(stamp_ns)
        return refused

    def carried(self, stamp_ns: int, R_n_c: Matrix) -> MarkerFix | None:
        """Return the pose in a frame without a marker, where common views carry it."""
        if self._filter.source is not Source.COMMON_VIEW:
            return None
        relative = self._filter.predict(stamp_ns, R_n_c, self.R_n_v)
        if relative is None:
            return None
        return MarkerFix(relative.T_c_v, relative.covariance, 0.0, ())

    def note_motion(self, motion: VehicleMotions) -> None:
        """Take both vehicles' reported motion.

        It says how the marker moves between two looks, and while it is not seen.
        """
        self._filter.set_own_velocity(motion.own_stamp_ns, motion.own_n_mps)
        self._filter.set_peer_velocity(motion.peer_stamp_ns, motion.peer_n_mps)
        self._motion = motion

    def predict(
        self, stamp_ns: int, R_n_c: Matrix | None = None, R_n_v: Matrix | None = None
    ) -> Relative | None:
        """The marker at an instant; None when it was not seen for too long. Attitudes: as of the
        filter.
        """
        return self._filter.predict(stamp_ns, R_n_c, R_n_v)

    def unseen_s(self, stamp_ns: int) -> float:
        return self._filter.unseen_s(stamp_ns)

    def searched(self, stamp_ns: int) -> bool:
        """Return whether the look at this instant was one at the whole image."""
        return self._searched_ns == stamp_ns

    def look(
        self, view: View, R_n_c: Matrix, gravity_v: Vec3 | None, gravity_c: Vec3
    ) -> MarkerFix | Missed:
        """The pose of the marker in one view, or why there is none."""
        if self._looked_ns:
            self._frame_ns = view.stamp_ns - self._looked_ns
        self._looked_ns = view.stamp_ns
        R_n_v = None
        if gravity_v is not None and self._motion is not None:
            R_n_v = levelled(gravity_v, self._R_b_v, self._motion.peer_yaw_rad)
        self.R_n_v = R_n_v
        region, expected = self._where(view.stamp_ns, R_n_c, R_n_v)
        if region is None:
            # a search of the whole image costs ten times a look at the right place
            if view.stamp_ns - self._searched_ns < self.search_every * self._search_period_ns:
                return Missed(MissReason.NO_MARKER)
            self._searched_ns = view.stamp_ns
        detections = view.markers(region, expected)
        pose = estimate_pose(
            detections, self._layout, self._camera, gravity_v, gravity_c, self._settings
        )
        if isinstance(pose, Missed):
            return pose
        refused = self._filter.update(view.stamp_ns, pose.T_c_v, pose.covariance, R_n_c, R_n_v)
        if refused is not None:
            return refused
        self._fixes.append(view.stamp_ns)
        return MarkerFix(pose.T_c_v, pose.covariance, pose.side_px, detections)

    def note_target(self, prior: Prior, R_n_c: Matrix) -> None:
        """Take the target's place from the camera, in ``n``, for the heading that keeps both in
        view.
        """
        x, y = self._camera.ray(*prior.pixel)
        north, east, down = (R_n_c @ (x * prior.depth_m, y * prior.depth_m, prior.depth_m)).tolist()
        self.target_n_m = (north, east, down)

    def _where(
        self, stamp_ns: int, R_n_c: Matrix, R_n_v: Matrix | None
    ) -> tuple[Region | None, Pose | None]:
        """Around where the markers must be, None when that is not known: then everywhere; and where
        they are expected, shortly after a fix."""
        relative = self._filter.predict(stamp_ns, R_n_c, R_n_v)
        if relative is None:
            return None, None
        u0, v0, u1, v1, near_m = extent(
            self._lens, relative.T_c_v.apply(self._corners_v), _NEAREST_M
        )
        if math.isinf(near_m):
            return None, None
        room_px = self._camera.fx * (self._room_m + 3.0 * relative.sigma_m) / near_m + 12.0
        known = self._filter.unseen_s(stamp_ns) <= _EXPECTED_S
        return Region(
            u0 - room_px, v0 - room_px, u1 + room_px, v1 + room_px
        ), relative.T_c_v if known else None


def _relative_settings(mission: MissionConfig, common_view: bool = False) -> RelativeSettings:
    usual = RelativeSettings()
    wander_rad = math.radians(mission.attitude_wander_deg)
    return RelativeSettings(
        tilt_wander_rad=wander_rad,
        yaw_wander_rad=max(usual.yaw_wander_rad, wander_rad),
        coast_s=max(mission.deadlines.marker_coast_s, _COMMON_COAST_S if common_view else 0.0),
        late=common_view,
    )


def levelled(gravity_v: Vec3, R_b_v: Matrix, yaw_rad: float = 0.0) -> Matrix:
    """Marker frame to the levelled heading frame (forward, right, down) of the drone that carries
    it, ``R_h_v``.

    With that drone's heading it is ``R_n_v``.
    """
    x, y, z = (R_b_v @ gravity_v).tolist()
    across = math.hypot(y, z)
    ahead_y = -x * y / across
    ahead_z = -x * z / across
    right_y = z / across
    right_z = -y / across
    c = math.cos(yaw_rad)
    s = math.sin(yaw_rad)
    rows = (
        (c * across, c * ahead_y - s * right_y, c * ahead_z - s * right_z),
        (s * across, s * ahead_y + c * right_y, s * ahead_z + c * right_z),
        (x, y, z),
    )
    return np.array(rows) @ R_b_v
