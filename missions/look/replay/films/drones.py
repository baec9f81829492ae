"""Both drones' cycles over the frames of their films, as in flight, and the records that a flight
would have left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.interfaces import Log, PartError, View
from drivers.rig.parts import Mount
from flight.camera_pose import gravity_in
from flight.config import MissionConfig
from flight.frame.receiver import ReceiverSide
from flight.frame.records import (
    AttemptId,
    attempt_record,
    candidate_record,
    heard_candidate_record,
    heard_target_record,
    marker_record,
    motion_record,
    target_record,
)
from flight.frame.sender import PairCameras, SenderSide
from flight.rendezvous.marker_view import MarkerView, VehicleMotions
from flight.tracking.association import follow
from flight.tracking.objects import MIN_SCORE, is_cut
from flight.tracking.places import point_in_camera, to_local
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from missions.ground.journal import frame_record, setup_record
from missions.ground.shown import tell_line
from missions.look.replay.films.config import Films, PlayedFilm
from missions.look.replay.films.depth_unit import REMEDY as UNIT
from missions.look.replay.films.depth_unit import depth_against_size
from missions.look.replay.films.trajectory import HANGING, BodyState
from path.geometry.rotation import R_from_quat, yaw_of
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Role, Target
from path.observations import Box
from path.values import frozen

EPOCH = 1
PICK_S = 0.5  # within which the target has to be seen where it was picked


@frozen
class FilmingBody:
    """A drone as it was while it filmed, by its trajectory if there is one."""

    film: PlayedFilm
    mount: Mount

    def at(self, stamp_ns: int) -> BodyState:
        return HANGING if self.film.flown is None else self.film.flown.at(stamp_ns)

    def camera(self, stamp_ns: int) -> tuple[Pose, Matrix]:
        """``T_n_c`` and ``R_n_b``."""
        body = self.at(stamp_ns)
        R_n_b = R_from_quat(body.q_n_b)
        T_b_c = self.mount.T_b_c
        return Pose(R_n_b @ T_b_c.R, R_n_b @ T_b_c.t + np.array(body.position_n_m)), R_n_b


class FilmedSender:
    """D1: picks the target, follows it, says where it is, judges D2's answers."""

    def __init__(
        self,
        films: Films,
        config: MissionConfig,
        log: Log,
    ) -> None:
        rig = self._rig = films.rig
        self._films = films
        self._config = config
        self._log = log
        self._body = FilmingBody(films.sender, rig.sender.mount)
        self._track: TargetTrack | None = None
        self._side_m = rig.method.evidence.span_m or 2.0 * config.target.half_size_m
        self._side = SenderSide(PairCameras.of(rig), rig.method, _attempt(config))
        begin(log, films, config, Role.SENDER)

    def look(self, view: View) -> Target | None:
        """Return D1's message about one frame. Raises PartError when the target is not where it
        was picked.
        """
        stamp_ns = view.stamp_ns
        camera = self._rig.sender.camera
        T_n_c, R_n_b = self._body.camera(stamp_ns)
        if self._track is None:
            if stamp_ns >= self._films.target_ns:
                self._track = self._pick(view, T_n_c)
            return None
        seen = follow(view, T_n_c, camera, self._track)
        gravity_v = gravity_in(R_n_b @ self._rig.sender.mount.T_b_v.R)
        frame = self._side.observe(view.frame_id, stamp_ns, seen, gravity_v)
        self._log.write("/frame", stamp_ns, frame_record(view, stamp_ns, T_n_c))
        self._log.write("/target", stamp_ns, target_record(frame, stamp_ns))
        for pair in self._side.judge(stamp_ns):
            self._log.write("/agreement", stamp_ns, self._side.record(pair))
        return frame.message if isinstance(frame.message, Target) else None

    def hear(self, candidate: Candidate, now_ns: int) -> None:
        self._side.hear(candidate, candidate.capture_ns, now_ns)
        self._log.write(
            "/heard_candidate",
            now_ns,
            heard_candidate_record(candidate, candidate.capture_ns),
        )

    @property
    def has_target(self) -> bool:
        return self._track is not None

    def _pick(self, view: View, T_n_c: Pose) -> TargetTrack | None:
        """The track of what was picked; None when this frame does not show it with a depth."""
        camera = self._rig.sender.camera
        pixel = self._films.target.pixel
        boxes = [
            d.box for d in view.targets(None) if d.score >= MIN_SCORE and not is_cut(d.box, camera)
        ]
        picked = boxes if pixel is None else [box for box in boxes if _holds(box, pixel)]
        if pixel is None and len(boxes) > 1:
            raise PartError(
                f"{self._where(view)}: {_places(boxes)}: which of them is the target?",
                "say target.pixel",
            )
        if picked:
            box = min(picked, key=lambda each: each.w * each.h)
            depth = view.depth(box)
            against = depth_against_size(view, box, camera, self._side_m)
            contradicts = against is not None and against.is_contradiction
            if against is not None and contradicts and depth is None:
                raise PartError(
                    f"{self._where(view)}: the target has no depth to be believed: {against.text}",
                    UNIT,
                )
            if depth is not None:
                if against is not None and contradicts:
                    tell_line(f"{self._where(view)}: the target: {against.text} ({UNIT})")
                position = to_local(point_in_camera(box, depth.z_m, camera), T_n_c)
                ranging = Ranging.of(self._config, self._rig.method)
                return TargetTrack.of(self._config, position, view.stamp_ns, ranging=ranging)
        if view.stamp_ns - self._films.target_ns > PICK_S * 1e9:
            at = "" if pixel is None else f" at ({pixel[0]:g}, {pixel[1]:g})"
            what = "without depth" if picked else f"not there{at}; {_places(boxes)}"
            raise PartError(
                f"{self._where(view)}: the target is {what}", "correct target.pixel and target.at_s"
            )
        return None

    def _where(self, view: View) -> str:
        return f"{self._films.sender.file.name} at {(view.stamp_ns - self._films.begin_ns) * 1e-9:.2f} s"


class FilmedReceiver:
    """D2: the marker, the prior, the look for the target, the answer."""

    def __init__(
        self,
        films: Films,
        config: MissionConfig,
        log: Log,
    ) -> None:
        rig = self._rig = films.rig
        self._log = log
        self._body = FilmingBody(films.receiver, rig.receiver.mount)
        self._peer = FilmingBody(films.sender, rig.sender.mount)
        self._together = films.sender.flown is not None and films.receiver.flown is not None
        self._marker = MarkerView(
            rig.layout,
            rig.receiver.camera,
            rig.receiver.mount,
            rig.method,
            config,
        )
        self._side = ReceiverSide(PairCameras.of(rig), rig.method, _attempt(config))
        begin(log, films, config, Role.RECEIVER)

    def hear(self, target: Target, now_ns: int) -> None:
        self._side.hear(target, target.capture_ns, now_ns)
        self._log.write("/heard_target", now_ns, heard_target_record(target, target.capture_ns))

    def look(self, view: View) -> Candidate | None:
        """Return D2's message about one frame."""
        stamp_ns = view.stamp_ns
        side = self._side
        log = self._log
        T_n_c, _ = self._body.camera(stamp_ns)
        motion = self._motion(stamp_ns)
        if self._together:
            self._marker.note_motion(motion)
        fix = self._marker.look(view, T_n_c.R, side.gravity_v(stamp_ns), gravity_in(T_n_c.R))
        log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
        log.write("/marker", stamp_ns, marker_record(stamp_ns, fix))
        moved = motion_record(motion, T_n_c.R, self._marker.R_n_v, fix)
        log.write("/motion", stamp_ns, moved if self._together else {**moved, "peer_yaw_rad": None})
        answer = side.look(view, side.prior(fix, stamp_ns))
        if answer is None:
            return None
        log.write("/candidate", stamp_ns, candidate_record(answer))
        return answer.candidate

    def _motion(self, stamp_ns: int) -> VehicleMotions:
        own = self._body.at(stamp_ns)
        peer = self._peer.at(stamp_ns)
        return VehicleMotions(
            stamp_ns,
            own.velocity_n_mps,
            stamp_ns,
            peer.velocity_n_mps,
            yaw_of(peer.q_n_b),
        )


def begin(
    log: Log,
    films: Films,
    config: MissionConfig,
    role: Role,
) -> None:
    """Write the records that a program's log begins with."""
    log.write("/setup", films.begin_ns, setup_record(films.rig, role, config))
    log.write("/attempt", films.begin_ns, attempt_record(_attempt(config)))


def _attempt(config: MissionConfig) -> AttemptId:
    return AttemptId(config.handoff_id, EPOCH, config.target_id)


def _holds(box: Box, pixel: tuple[float, float]) -> bool:
    u, v = pixel
    return box.x <= u <= box.x + box.w and box.y <= v <= box.y + box.h


def _places(boxes: Sequence[Box]) -> str:
    """Return the places where things are seen, for whoever picks one."""
    if not boxes:
        return "nothing is seen"
    return "seen at " + ", ".join(
        f"({box.center[0]:.0f}, {box.center[1]:.0f})" for box in boxes[:8]
    )
