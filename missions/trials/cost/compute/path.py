"""One cycle of PATH on both sides, every stage of it timed: the mission's own parts, called as the
mission does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.interfaces import Frame, Log
from drivers.link.wire import KEY_LENGTH, Codec, introduce
from drivers.perception.pixels import PixelView
from drivers.rig.parts import Rig
from flight.camera_pose import gravity_in
from flight.config import MissionConfig
from flight.frame.receiver import ReceiverSide
from flight.frame.records import Answer, AttemptId, OwnFrame
from flight.frame.sender import PairCameras, SenderSide
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.tracking.association import Sighting
from missions.trials.cost.compute.film import (
    BETWEEN_NS,
    HEADINGS_RAD,
    PERIOD_NS,
    Film,
    Moment,
)
from missions.trials.cost.compute.journals import log_receiver, log_sender
from missions.trials.cost.compute.stopwatch import Stopwatch, TimedView, overhead_ns
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.agreement import Agreed
from path.geometry.transforms import Matrix
from path.marker.detect import detect_markers
from path.marker.photometric.known import Memory
from path.marker.pose import PoseSettings, estimate_pose
from path.marker.track import recognise
from path.messages import Candidate, Role, Target, Vec3
from path.observations import Box, Depth, Detection, Missed, Region
from path.values import frozen

GEOMETRY = ("d1_target", "d2_take", "d2_prior", "d2_candidate", "d1_judge")
MESSAGES = ("encode_target", "decode_target", "encode_candidate", "decode_candidate")
D1_CYCLE = ("d1_depth", "d1_target", "encode_target", "decode_candidate", "d1_judge", "d1_log")
D2_CYCLE = (
    "decode_target",
    "d2_take",
    "d2_marker",
    "d2_prior",
    "d2_candidate",
    "encode_candidate",
    "d2_log",
)
SUMS = {
    "geometry": GEOMETRY,
    "geometry_and_depth": ("d1_depth", *GEOMETRY),
    "path_without_messages": ("d1_depth", *GEOMETRY, "d2_marker"),
    "path": ("d1_depth", *GEOMETRY, "d2_marker", *MESSAGES),
    "d1_cycle": D1_CYCLE,
    "d2_cycle": D2_CYCLE,
}
DETECTORS = ("d1_detector", "d2_detector")
FIRST_FRAME = 1000  # clocks do not begin at zero


@frozen
class _Seen:
    """The observations that a cycle took from the pixels of a moment."""

    depth: Depth | None
    fix: MarkerFix
    found: Sequence[Detection]


class PathPair:
    """Both roles on a film. ``cycle`` goes on in time for ever; the film repeats."""

    def __init__(
        self,
        rig: Rig,
        mission: MissionConfig,
        film: Film,
        seed: int,
        logs: Mapping[Role, Log],
    ) -> None:
        self._rig = rig
        self._film = film
        self._logs = logs
        self._motion: VehicleMotions | None = None
        self._pairs: Sequence[PairVerdict] = ()
        self._mounts = {role: rig.role(role).mount for role in Role}
        cameras = film.cameras
        pair = PairCameras(
            cameras[Role.SENDER],
            cameras[Role.RECEIVER],
            self._mounts[Role.SENDER].T_v_c,
        )
        attempt = AttemptId(1, 1, 1)
        self._sender = SenderSide(pair, rig.method, attempt)
        self._receiver = ReceiverSide(pair, rig.method, attempt)
        self._marker = MarkerView(
            rig.layout,
            pair.receiver,
            rig.receiver.mount,
            rig.method,
            mission,
        )
        self._detector = ColorDetector(ColorDetectorConfig())
        key = np.random.default_rng([seed, 3]).bytes(KEY_LENGTH)
        self._codecs = {role: Codec(role, key) for role in Role}
        introduce(*self._codecs.values())
        self._memories: dict[Role, Memory] = {role: {} for role in Role}
        self._frame = FIRST_FRAME
        self._overhead_ns = overhead_ns()
        self._seen: dict[int, _Seen] = {}  # by the moment's number: what the pixels gave
        self.agreed = 0

    def cycle(self) -> dict[str, float]:
        """The next pair of frames; time of each stage and sum, us. Raises RuntimeError when PATH
        makes nothing of it.
        """
        moment, number, watch = self._next()
        stamp_ns = self._frame * PERIOD_NS
        view = self._view(moment, Role.SENDER, stamp_ns)
        watch("d1_detector", view.targets, _around(moment.box1))
        depth = watch("d1_depth", view.depth, moment.box1)
        own, sent = self._own_frame(moment, depth, watch)
        packet = watch("encode_target", self._codecs[Role.SENDER].encode, sent)
        target = watch("decode_target", self._codecs[Role.RECEIVER].decode, packet)
        if not isinstance(target, Target):
            raise RuntimeError(f"the target's packet was dropped: {target}")
        gravity_v = watch("d2_take", self._take, target)
        seen_by_d2 = TimedView(self._view(moment, Role.RECEIVER, stamp_ns + BETWEEN_NS), watch)
        fix = self._fix(moment, seen_by_d2, gravity_v, watch)
        prior = self._prior(fix, watch)
        found = watch("d2_detector", seen_by_d2.targets, prior.region)
        answer = self._answer(found, prior, watch)
        packet = watch("encode_candidate", self._codecs[Role.RECEIVER].encode, answer.candidate)
        received = watch("decode_candidate", self._codecs[Role.SENDER].decode, packet)
        if not isinstance(received, Candidate):
            raise RuntimeError(f"the candidate's packet was dropped: {received}")
        watch("d1_judge", self._hear_and_judge, received)
        self._log(view, seen_by_d2, own, (target, moment, fix, answer), watch)
        self._seen[number] = _Seen(depth, fix, found)
        return _with_sums(watch.us)

    def geometry(self) -> float:
        """The geometry of the next pair of frames with nothing between its stages, us.

        What the pixels gave is taken from the last ``cycle`` on these frames, which there must have
        been.
        """
        moment, number, watch = self._next()
        seen = self._seen[number]
        _, sent = self._own_frame(moment, seen.depth, watch)
        watch("d2_take", self._take, sent)
        prior = self._prior(seen.fix, watch)
        watch("d1_judge", self._hear_and_judge, self._answer(seen.found, prior, watch).candidate)
        return sum(watch.us[stage] for stage in GEOMETRY)

    def _next(self) -> tuple[Moment, int, Stopwatch]:
        self._frame += 1
        number = self._frame % len(self._film.moments)
        return self._film.moments[number], number, Stopwatch(self._overhead_ns)

    def _view(
        self,
        moment: Moment,
        role: Role,
        stamp_ns: int,
    ) -> PixelView:
        depth_mm = moment.depth_mm if role is Role.SENDER else None
        frame = Frame(stamp_ns, self._frame, moment.color[role], depth_mm)
        rig = self._rig
        return PixelView(
            frame,
            self._film.cameras[role],
            rig.layout,
            self._detector,
            rig.method,
            memory=self._memories[role],
        )

    def _own_frame(
        self,
        moment: Moment,
        depth: Depth | None,
        watch: Stopwatch,
    ) -> tuple[OwnFrame, Target]:
        """The frame, and the message in it. Raises RuntimeError when there is none."""
        gravity_v = gravity_in(moment.R_n_b[Role.SENDER] @ self._mounts[Role.SENDER].T_b_v.R)
        stamp_ns = self._frame * PERIOD_NS
        seen = Sighting(moment.box1, depth)
        own = watch("d1_target", self._sender.observe, self._frame, stamp_ns, seen, gravity_v)
        if not isinstance(own.message, Target):
            raise RuntimeError(f"D1 has no target: {own.message.reason.value}")
        return own, own.message

    def _take(self, target: Target) -> Vec3 | None:
        stamp_ns = self._frame * PERIOD_NS + BETWEEN_NS
        self._receiver.hear(target, target.capture_ns, stamp_ns)
        return self._receiver.gravity_v(stamp_ns)

    def _fix(
        self,
        moment: Moment,
        view: TimedView,
        gravity_v: Vec3 | None,
        watch: Stopwatch,
    ) -> MarkerFix:
        R_n_c = moment.R_n_b[Role.RECEIVER] @ self._mounts[Role.RECEIVER].T_b_c.R
        gravity_c = gravity_in(R_n_c)
        motion = VehicleMotions(
            view.stamp_ns, moment.velocity_n_mps[Role.RECEIVER],
            view.stamp_ns, moment.velocity_n_mps[Role.SENDER], HEADINGS_RAD[Role.SENDER],
        )  # fmt: skip
        fix = watch("d2_marker", self._look, view, motion, R_n_c, gravity_v, gravity_c)
        if not isinstance(fix, MarkerFix):
            raise RuntimeError(f"D2 has no pose: {fix.reason.value}")
        self._again(moment, fix, view, gravity_v, gravity_c, watch)
        return fix

    def _prior(self, fix: MarkerFix, watch: Stopwatch) -> Prior:
        stamp_ns = self._frame * PERIOD_NS + BETWEEN_NS
        prior = watch("d2_prior", self._receiver.prior, fix, stamp_ns)
        if not isinstance(prior, Prior):
            raise RuntimeError(f"D2 has no prior: {prior.reason.value}")
        return prior

    def _answer(
        self,
        found: Sequence[Detection],
        prior: Prior,
        watch: Stopwatch,
    ) -> Answer:
        stamp_ns = self._frame * PERIOD_NS + BETWEEN_NS
        answer = watch("d2_candidate", self._receiver.answer, self._frame, stamp_ns, found, prior)
        if answer is None or answer.candidate.box is None:
            raise RuntimeError("D2 has no candidate")
        return answer

    def _look(
        self,
        view: TimedView,
        motion: VehicleMotions,
        R_n_c: Matrix,
        gravity_v: Vec3 | None,
        gravity_c: Vec3,
    ) -> MarkerFix | Missed:
        self._motion = motion
        self._marker.note_motion(motion)
        return self._marker.look(view, R_n_c, gravity_v, gravity_c)

    def _log(
        self,
        one: PixelView,
        two: TimedView,
        own: OwnFrame,
        made: tuple[Target, Moment, MarkerFix, Answer],
        watch: Stopwatch,
    ) -> None:
        target, moment, fix, answer = made
        assert self._motion is not None
        log = self._logs[Role.SENDER]
        watch("d1_log", log_sender, log, one, own, answer.candidate, self._pairs, self._sender)
        R_n_c = moment.R_n_b[Role.RECEIVER] @ self._mounts[Role.RECEIVER].T_b_c.R
        attitudes = R_n_c, self._marker.R_n_v
        log = self._logs[Role.RECEIVER]
        watch("d2_log", log_receiver, log, two, target, fix, self._motion, attitudes, answer)

    def _hear_and_judge(self, candidate: Candidate) -> None:
        """A candidate waits for D1's next frame: what is judged in a cycle is that of the cycle
        before.
        """
        now_ns = self._frame * PERIOD_NS + BETWEEN_NS
        self._pairs = self._sender.judge(now_ns)
        for pair in self._pairs:
            self.agreed += isinstance(pair.verdict, Agreed)
        self._sender.hear(candidate, candidate.capture_ns, now_ns)

    def _again(
        self,
        moment: Moment,
        fix: MarkerFix,
        view: TimedView,
        gravity_v: Vec3 | None,
        gravity_c: Vec3,
        watch: Stopwatch,
    ) -> None:
        """Two parts of the marker's pose by themselves, as flown: all before the fit, and the pose
        from corners.
        """
        camera = self._film.cameras[Role.RECEIVER]
        layout = self._rig.layout
        color = moment.color[Role.RECEIVER]
        if (
            view.expected is None
            or watch("d2_marker_detect", recognise, color, view.expected, layout, camera) is None
        ):
            watch(
                "d2_marker_detect",
                detect_markers,
                color,
                view.region,
                layout,
                camera,
                refine="subpix",
            )
        watch(
            "d2_marker_pose",
            estimate_pose,
            fix.detections,
            layout,
            camera,
            gravity_v,
            gravity_c,
            PoseSettings(),
        )


def _with_sums(us: dict[str, float]) -> dict[str, float]:
    """Return the times with the sums of the stages, and the rest of the marker's time by its
    parts.
    """
    for name, stages in SUMS.items():
        us[name] = sum(us[stage] for stage in stages)
    us["d2_marker_fit"] = us["d2_marker_corners"] - us["d2_marker_detect"]
    us["d2_marker_filter"] = us["d2_marker"] - us["d2_marker_corners"] - us["d2_marker_pose"]
    return us


def _around(box: Box) -> Region:
    """Return the region in which a drone that tracks a box looks for it in the next frame."""
    u, v = box.center
    return Region(u - box.w, v - box.w, u + box.w, v + box.w)
