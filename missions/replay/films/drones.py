"""Both drones' cycles over the frames of their films, as in flight, and the records that a flight would have left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.interfaces import Log, PartError, View
from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.guidance import Vec3
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.tracking.association import Sighting, follow
from flight.tracking.objects import MIN_SCORE, is_cut
from flight.tracking.places import point_in_camera, to_local
from flight.tracking.ranging import Ranging
from flight.tracking.target_track import TargetTrack
from missions.leg.journal import (
    agreement_record,
    attempt_record,
    beside_record,
    candidate_record,
    counted,
    frame_record,
    heard_candidate_record,
    heard_target_record,
    marker_miss_record,
    marker_record,
    motion_record,
    range_record,
    setup_record,
    target_record,
)
from missions.replay.films.config import Films, PlayedFilm
from missions.replay.films.depth_unit import REMEDY as UNIT
from missions.replay.films.depth_unit import depth_against_size
from missions.replay.films.trajectory import HANGING, BodyState
from missions.shown import tell_line
from path.cycle.prior import Prior
from path.cycle.receiver import ReceiverCycle
from path.cycle.sender import SenderCycle
from path.geometry.rigid import inverse_as_quat, rigid
from path.geometry.rotation import R_from_quat, yaw_of
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Role, Target
from path.observations import Box, Missed

EPOCH = 1
PICK_S = 0.5  # within which the target has to be seen where it was picked


@dataclass(frozen=True, slots=True)
class FilmingBody:
    """A drone as it was while it filmed, by its trajectory if there is one."""

    film: PlayedFilm
    mount: Mount

    def at(self, stamp_ns: int) -> BodyState:
        return HANGING if self.film.flown is None else self.film.flown.at(stamp_ns)

    def camera(self, stamp_ns: int) -> tuple[Pose, Matrix]:
        """``T_n_c`` and ``R_n_b``."""
        body = self.at(stamp_ns)
        R_n_b, T_b_c = R_from_quat(body.q_n_b), self.mount.T_b_c
        return Pose(R_n_b @ T_b_c.R, R_n_b @ T_b_c.t + np.array(body.position_n_m)), R_n_b


class FilmedSender:
    """D1: picks the target, follows it, says where it is, judges D2's answers."""

    def __init__(self, films: Films, config: MissionConfig, log: Log) -> None:
        rig = self._rig = films.rig
        self._films, self._config, self._log = films, config, log
        self._body = FilmingBody(films.sender, rig.sender.mount)
        self._track: TargetTrack | None = None
        self._side_m = rig.method.evidence.span_m or 2.0 * config.target.half_size_m
        self._cycle = SenderCycle(
            rig.sender.camera, rig.receiver.camera, rig.sender.mount.T_v_c, rig.method,
            handoff_id=config.handoff_id, epoch=EPOCH, target_id=config.target_id,
        )  # fmt: skip
        begin(log, films, config, Role.SENDER)

    def look(self, view: View) -> Target | None:
        """Returns D1's message about one frame. Raises PartError when the target is not where it was picked."""
        stamp_ns, camera = view.stamp_ns, self._rig.sender.camera
        T_n_c, R_n_b = self._body.camera(stamp_ns)
        if self._track is None:
            if stamp_ns >= self._films.target_ns:
                self._track = self._pick(view, T_n_c)
            return None
        seen = follow(view, T_n_c, camera, self._track)
        box, depth, beside = (seen.box, seen.depth, seen.beside) if isinstance(seen, Sighting) else (None, None, ())
        x, y, z = (R_n_b @ self._rig.sender.mount.T_b_v.R)[2].tolist()
        message = self._cycle.observe(view.frame_id, stamp_ns, box, depth, (x, y, z), beside)
        record = target_record(message, view.frame_id, stamp_ns, box)
        if isinstance(seen, Sighting):
            record["beside"] = beside_record(beside)
            if depth is not None:
                record["depth_m"], record["depth_sigma_m"] = depth.z_m, depth.sigma_m
                record |= range_record(seen)
        else:
            record["reason"] = seen.value
        self._log.write("/frame", stamp_ns, frame_record(view, stamp_ns, T_n_c))
        self._log.write("/target", stamp_ns, {**record, "judged_ns": stamp_ns})
        for pair in self._cycle.evaluate_ready(stamp_ns):
            count, evidence = counted(pair, self._cycle.gate)
            needed, target_id = self._rig.method.needed_pairs, self._config.target_id
            self._log.write("/agreement", stamp_ns, agreement_record(pair, count, needed, evidence, target_id))
        return message if isinstance(message, Target) else None

    def hear(self, candidate: Candidate, now_ns: int) -> None:
        self._cycle.offer(candidate, candidate.capture_ns, now_ns)
        self._log.write("/heard_candidate", now_ns, heard_candidate_record(candidate, candidate.capture_ns))

    @property
    def has_target(self) -> bool:
        return self._track is not None

    def _pick(self, view: View, T_n_c: Pose) -> TargetTrack | None:
        """The track of what was picked; None when this frame does not show it with a depth."""
        camera, pixel = self._rig.sender.camera, self._films.target.pixel
        boxes = [d.box for d in view.targets(None) if d.score >= MIN_SCORE and not is_cut(d.box, camera)]
        picked = boxes if pixel is None else [box for box in boxes if _holds(box, pixel)]
        if pixel is None and len(boxes) > 1:
            raise PartError(f"{self._where(view)}: {_places(boxes)}: which of them is the target?", "say target.pixel")
        if picked:
            box = min(picked, key=lambda each: each.w * each.h)
            depth = view.depth(box)
            against = depth_against_size(view, box, camera, self._side_m)
            contradicts = against is not None and against.is_contradiction
            if against is not None and contradicts and depth is None:
                raise PartError(f"{self._where(view)}: the target has no depth to be believed: {against.text}", UNIT)
            if depth is not None:
                if against is not None and contradicts:
                    tell_line(f"{self._where(view)}: the target: {against.text} ({UNIT})")
                position = to_local(point_in_camera(box, depth.z_m, camera), T_n_c)
                ranging = Ranging.of(self._config, self._rig.method)
                return TargetTrack.of(self._config, position, view.stamp_ns, ranging=ranging)
        if view.stamp_ns - self._films.target_ns > PICK_S * 1e9:
            at = "" if pixel is None else f" at ({pixel[0]:g}, {pixel[1]:g})"
            what = "without depth" if picked else f"not there{at}; {_places(boxes)}"
            raise PartError(f"{self._where(view)}: the target is {what}", "correct target.pixel and target.at_s")
        return None

    def _where(self, view: View) -> str:
        return f"{self._films.sender.file.name} at {(view.stamp_ns - self._films.begin_ns) * 1e-9:.2f} s"


class FilmedReceiver:
    """D2: the marker, the prior, the look for the target, the answer."""

    def __init__(self, films: Films, config: MissionConfig, log: Log) -> None:
        rig = self._rig = films.rig
        self._log = log
        self._body = FilmingBody(films.receiver, rig.receiver.mount)
        self._peer = FilmingBody(films.sender, rig.sender.mount)
        self._together = films.sender.flown is not None and films.receiver.flown is not None
        self._marker = MarkerView(rig.layout, rig.receiver.camera, rig.receiver.mount, rig.method, config)
        x, y, z = rig.sender.mount.T_v_c.t.tolist()
        self._cycle = ReceiverCycle(
            rig.receiver.camera, rig.method, handoff_id=config.handoff_id, epoch=EPOCH, target_id=config.target_id,
            sender=(rig.sender.camera, (x, y, z)),
        )  # fmt: skip
        begin(log, films, config, Role.RECEIVER)

    def hear(self, target: Target, now_ns: int) -> None:
        self._cycle.on_target(target, target.capture_ns, now_ns)
        self._log.write("/heard_target", now_ns, heard_target_record(target, target.capture_ns))

    def look(self, view: View) -> Candidate | None:
        """Returns D2's message about one frame."""
        stamp_ns, cycle, log = view.stamp_ns, self._cycle, self._log
        T_n_c, _ = self._body.camera(stamp_ns)
        motion = self._motion(stamp_ns)
        if self._together:
            self._marker.note_motion(motion)
        fix = self._marker.look(view, T_n_c.R, cycle.gravity_v(stamp_ns), _down(T_n_c))
        log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
        log.write("/marker", stamp_ns, _marker_of(stamp_ns, fix))
        moved = motion_record(motion, T_n_c.R, self._marker.R_n_v, fix)
        log.write("/motion", stamp_ns, moved if self._together else {**moved, "peer_yaw_rad": None})
        prior = cycle.prior(fix.T_c_v, fix.covariance, stamp_ns) if isinstance(fix, MarkerFix) else fix
        found = view.targets(prior.region) if isinstance(prior, Prior) else ()
        candidate = cycle.candidate(view.frame_id, stamp_ns, found, prior)
        if isinstance(candidate, Missed):
            return None
        log.write("/candidate", stamp_ns, candidate_record(candidate, prior, found))
        return candidate

    def _motion(self, stamp_ns: int) -> VehicleMotions:
        own, peer = self._body.at(stamp_ns), self._peer.at(stamp_ns)
        return VehicleMotions(stamp_ns, own.velocity_n_mps, stamp_ns, peer.velocity_n_mps, yaw_of(peer.q_n_b))


def begin(log: Log, films: Films, config: MissionConfig, role: Role) -> None:
    """Writes the records that a program's log begins with."""
    log.write("/setup", films.begin_ns, setup_record(films.rig, role, config))
    log.write("/attempt", films.begin_ns, attempt_record(config.handoff_id, EPOCH, config.target_id))


def _down(T_n_c: Pose) -> Vec3:
    """Unit gravity in the camera."""
    x, y, z = T_n_c.R[2].tolist()
    return x, y, z


def _marker_of(stamp_ns: int, fix: MarkerFix | Missed) -> dict[str, object]:
    if isinstance(fix, Missed):
        return marker_miss_record(stamp_ns, fix)
    rotation, position = inverse_as_quat(rigid(fix.T_c_v))
    sigma_m = math.sqrt(float(np.trace(fix.covariance[:3, :3])) / 3.0)
    return marker_record(stamp_ns, position, rotation, sigma_m, fix.side_px, fix.detections[0])


def _holds(box: Box, pixel: tuple[float, float]) -> bool:
    u, v = pixel
    return box.x <= u <= box.x + box.w and box.y <= v <= box.y + box.h


def _places(boxes: Sequence[Box]) -> str:
    """Returns the places where things are seen, for whoever picks one."""
    if not boxes:
        return "nothing is seen"
    return "seen at " + ", ".join(f"({box.center[0]:.0f}, {box.center[1]:.0f})" for box in boxes[:8])
