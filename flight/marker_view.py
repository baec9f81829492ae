"""The sender's marker as the receiver sees it: where to look, the pose, and the way there is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.interfaces import View
from flight.config import MissionConfig
from flight.guidance import Vec3, subtract
from path.camera import CameraModel
from path.config import MethodConfig
from path.geometry import Matrix, Pose
from path.marker.flip import FlipGate
from path.marker.layout import MarkerLayout
from path.marker.pose import PoseSettings, estimate_pose
from path.observations import MarkerDetection, Missed, MissReason, Region
from path.prior import Prior
from path.relative import Relative, RelativeFilter

_FIXED_NS = 500_000_000  # fixes older than this do not count towards "seen"


@dataclass(frozen=True, slots=True)
class MarkerFix:
    """A pose good enough to use, and the corners it came from."""

    T_c_v: Pose
    covariance: Matrix
    side_px: float
    detections: Sequence[MarkerDetection]


class MarkerView:
    """Marker measurements of one receiver over time. Not for two cameras."""

    def __init__(self, layout: MarkerLayout, camera: CameraModel, method: MethodConfig, mission: MissionConfig) -> None:
        self._layout = layout
        self._camera = camera
        self._reach_m = 0.75 * max(float(abs(marker.corners_v).max()) for marker in layout.markers) + 0.02
        self._settings = PoseSettings(
            attitude_v_sigma_rad=math.radians(mission.attitude_sigma_deg),
            attitude_c_sigma_rad=math.radians(mission.attitude_sigma_deg),
            max_incidence_rad=math.radians(method.max_incidence_deg),
            max_sigma_m=method.max_pose_sigma_m,
        )
        self._flip = FlipGate()
        self._filter = RelativeFilter(coast_s=mission.deadlines.marker_coast_s)
        self._fixes: list[int] = []
        self._searched_ns = 0
        self._search_period_ns = round(1e9 / mission.search_hz)
        self.target_n_m: Vec3 | None = None

    def fixes(self, now_ns: int) -> int:
        """Poses found in the last half second."""
        self._fixes = [stamp_ns for stamp_ns in self._fixes if now_ns - stamp_ns < _FIXED_NS]
        return len(self._fixes)

    def set_velocities(self, peer_n_mps: Vec3, own_n_mps: Vec3) -> None:
        """What both vehicles report: how the marker moves while it is not seen."""
        self._filter.set_velocity(subtract(peer_n_mps, own_n_mps))

    def predict(self, stamp_ns: int) -> Relative | None:
        """From the camera to the marker at an instant; None when it was not seen for too long."""
        return self._filter.predict(stamp_ns)

    def unseen_s(self, stamp_ns: int) -> float:
        return self._filter.unseen_s(stamp_ns)

    def look(self, view: View, R_n_c: Matrix, gravity_v: Vec3 | None, gravity_c: Vec3) -> MarkerFix | Missed:
        """The pose of the marker in one view, or why there is none."""
        region = self._region(view.stamp_ns, R_n_c)
        if region is None:
            # a search of the whole image costs ten times a look at the right place
            if view.stamp_ns - self._searched_ns < self._search_period_ns:
                return Missed(MissReason.NO_MARKER)
            self._searched_ns = view.stamp_ns
        detections = view.markers(region)
        pose = estimate_pose(detections, self._layout, self._camera, gravity_v, gravity_c, self._settings)
        if isinstance(pose, Missed):
            return pose
        flipped = self._flip.check(R_n_c @ pose.T_c_v.R, view.stamp_ns)
        if flipped is not None:
            return flipped
        north, east, down = (R_n_c @ pose.T_c_v.t).tolist()
        variance = R_n_c @ pose.covariance[:3, :3] @ R_n_c.T
        spread = (float(variance[0, 0]), float(variance[1, 1]), float(variance[2, 2]))
        self._filter.update(view.stamp_ns, (north, east, down), spread)
        self._fixes.append(view.stamp_ns)
        return MarkerFix(pose.T_c_v, pose.covariance, pose.side_px, detections)

    def note_target(self, prior: Prior, R_n_c: Matrix) -> None:
        """Where the target is, from the camera, in ``n``: for the heading that keeps both in view."""
        x, y = self._camera.ray(*prior.pixel)
        north, east, down = (R_n_c @ (x * prior.depth_m, y * prior.depth_m, prior.depth_m)).tolist()
        self.target_n_m = (north, east, down)

    def _region(self, stamp_ns: int, R_n_c: Matrix) -> Region | None:
        """Around where the marker must be; None when that is not known: then everywhere."""
        relative = self._filter.predict(stamp_ns)
        if relative is None:
            return None
        x, y, z = (R_n_c.T @ relative.marker_n_m).tolist()
        if z <= 0.1 or not self._camera.sees((x, y, z)):
            return None
        u, v = self._camera.project_point((x, y, z))
        half_px = self._camera.fx * (self._reach_m + 3.0 * relative.sigma_m) / z + 12.0
        return Region(u - half_px, v - half_px, u + half_px, v + half_px)
