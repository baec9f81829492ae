"""Perception again: what a drone sees in the frames that it recorded, in place of what its log says
it saw.

The same code looks as in flight: ``flight.tracking`` on D1, ``flight.rendezvous.marker_view`` on
D2, over the perception of a rig, with its detector or another. What the camera could not tell is
the log's: where the drone believed to be, and how the vehicles moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from drivers.interfaces import Frame, View
from drivers.operator.interfaces import Chosen
from drivers.rig.parts import RoleRig
from flight.camera_pose import gravity_in
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.tracking.acquisition import Acquisition
from flight.tracking.association import Sighting, follow
from flight.tracking.largest_box import LargestBox
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from missions.ground.journal import ground_of, told_of
from missions.look.replay.logged import pose_of
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.geometry.rotation import R_from_quat
from path.marker.layout import MarkerLayout
from path.observations import Detection, Missed, MissReason

Record = Mapping[str, Any]
See = Callable[[Frame], View]


class RecordedViews:
    """The views of a drone's recorded frames, by their stamps, which are asked for in order."""

    def __init__(self, frames: Iterator[Frame], see: See) -> None:
        self._frames = frames
        self._see = see
        self._newest: Frame | None = None

    def at(self, stamp_ns: int) -> View | None:
        """None when that frame was not recorded."""
        while self._newest is None or self._newest.stamp_ns < stamp_ns:
            frame = next(self._frames, None)
            if frame is None:
                return None
            self._newest = frame
        return self._see(self._newest) if self._newest.stamp_ns == stamp_ns else None


class SenderPerceiver:
    """D1's: the target, from its acquisition on. ``missing``: frames that were not recorded."""

    def __init__(
        self,
        views: RecordedViews,
        own: RoleRig,
        camera: CameraModel,
        method: MethodConfig,
        mission: MissionConfig,
        begun_ns: int,
    ) -> None:
        """``begun_ns``: when the drone's program started."""
        self.missing = 0
        self._views = views
        self._mount = own.mount
        self._camera = camera
        self._mission = mission
        self._track: TargetTrack | None = None
        self._ranging = Ranging.of(mission, method)
        self._acquisition = Acquisition(camera, method, mission, self._ranging)
        self._largest = LargestBox.of(camera, method)
        self._seen: Sighting | MissReason | None = None
        self._gravity_v: Vec3 = (math.nan, math.nan, math.nan)

    def note_told(self, told: Record) -> None:
        """The log's ``/told``."""
        said = told_of(told)
        if isinstance(said, Chosen):
            self._acquisition.choose(said)
        else:
            self._acquisition.tell(said)

    def look(self, stamp_ns: int, frame: Record) -> None:
        """One ``/frame``. Without a pose, or its frame, the log's word stays."""
        view = None if frame["T_n_c"] is None else self._views.at(stamp_ns)
        self._seen = None
        if view is None:
            self.missing += 1
            return
        T_n_c = pose_of(frame["T_n_c"])
        R_n_b = T_n_c.R @ self._mount.T_b_c.R.T
        self._gravity_v = gravity_in(R_n_b @ self._mount.T_b_v.R)
        self._ranging.ground = ground_of(frame) or self._ranging.ground
        if self._track is not None:
            self._seen = follow(view, T_n_c, self._camera, self._track)
            return
        self._seen = MissReason.NO_TARGET
        taken = self._acquisition.look(view, T_n_c)
        if taken is not None:
            self._track = TargetTrack.of(
                self._mission,
                taken.position_n_m,
                stamp_ns,
                self._largest,
                self._ranging,
            )
            self._track.velocity_n_mps = taken.velocity_n_mps

    @property
    def seen(self) -> tuple[Sighting | MissReason, Vec3] | None:
        """The newest frame's target, and down in the marker's frame; None: as the log says."""
        return None if self._seen is None else (self._seen, self._gravity_v)


class ReceiverPerceiver:
    """D2's: the marker, and the target where the prior says. ``missing``: frames that were not
    recorded.
    """

    def __init__(
        self,
        views: RecordedViews,
        own: RoleRig,
        camera: CameraModel,
        layout: MarkerLayout,
        method: MethodConfig,
        mission: MissionConfig,
    ) -> None:
        self.missing = 0
        self.fix: MarkerFix | Missed | None = None
        self._views = views
        self._marker = MarkerView(layout, camera, own.mount, method, mission)
        self._view: View | None = None

    def look(
        self,
        stamp_ns: int,
        motion: Record,
        gravity_v: Vec3 | None,
    ) -> None:
        """One ``/motion``: the marker of its frame in ``fix``; None where the log's word stays."""
        self._view = self._views.at(stamp_ns)
        self.fix = None
        if self._view is None or motion["peer_yaw_rad"] is None:
            self.missing += 1
            return
        R_n_c = R_from_quat(tuple(motion["q_n_c"]))
        own = tuple(motion["own_n_mps"])
        peer = tuple(motion["peer_n_mps"])
        yaw_rad = motion["peer_yaw_rad"]
        self._marker.note_motion(
            VehicleMotions(motion["own_stamp_ns"], own, motion["peer_stamp_ns"], peer, yaw_rad)
        )
        self.fix = self._marker.look(self._view, R_n_c, gravity_v, gravity_in(R_n_c))

    def find(self, prior: Prior | Missed) -> Sequence[Detection] | None:
        """The detections of the newest frame that the prior asks for; None: as the log says."""
        if self._view is None:
            return None
        return self._view.targets(prior.region) if isinstance(prior, Prior) else ()
