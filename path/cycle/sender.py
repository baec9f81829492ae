"""One cycle of D1, the sender: say where the target is, judge what D2 answers.

``flight.frame.sender`` calls it for every frame of D1 and every answer of D2. It is pure: stamps and
observations come in, messages and verdicts go out. Who is responsible is not decided here
(``path.protocol``).
"""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import Agreed, Comparer, TwoViews, Verdict, plain_box, threshold
from path.gate.evidence import make_gate, strength
from path.gate.window import FramePair, Gate, Offset, Offsets, serial_difference
from path.geometry.rigid import rigid, rigid_from_quat
from path.geometry.rotation import normalized
from path.geometry.transforms import Pose
from path.messages import Candidate, Target, Vec3
from path.observations import Box, Depth, Missed, MissReason, RangeSource
from path.target.place import TargetPoint, locate
from path.target.rivals import Rival, Rivals
from path.target.size import FITS, Sizes
from path.timeline import Between, Sample, Track, Values

MAX_PENDING = 64
UNIT_TOLERANCE = 0.05  # of a direction or a quaternion that went through float32


class PairVerdict(NamedTuple):
    """The verdict on one candidate, and what it rests on.

    Attributes:
        candidate: None when the verdict is that none came (LINK_SILENT).
        capture_ns: when D2's frame was taken, D1's clock.
        own_box: D1's box at that instant, interpolated; None when there is none.
        mapped_box: D2's box in D1's image; None when it did not come to that.
        tau: what the overlap had to be; None when nothing was compared.
        own: D1's samples around that instant, box, point and depth; None as ``own_box``.
        offsets: of D2's box from the target and from what D1 sees beside it; None when nothing was
            compared.
        oversize: by how many standard deviations a box is larger than the target can be
            (``path.target.size``).
        placed_iou: as of a ``FramePair``.
    """

    candidate: Candidate | None
    capture_ns: int
    verdict: Verdict
    own_box: Box | None = None
    mapped_box: Box | None = None
    tau: float | None = None
    own: Between | None = None
    offsets: Offsets | None = None
    oversize: float = FITS
    placed_iou: float | None = None


class _Pending(NamedTuple):
    order: int  # sequence, unwrapped
    capture_ns: int
    candidate: Candidate


class SenderCycle:
    """D1's side of the method for one handoff of one target.

    A candidate is offered when it comes in and evaluated once D1 has frames on both sides of its
    capture instant: its box is compared with D1's own box *at that instant*. Candidates wait for
    that in the order of their sequence, so a small reordering on the link costs nothing.
    """

    def __init__(
        self,
        camera: CameraModel,
        peer_camera: CameraModel,
        T_v_c1: Pose,
        config: MethodConfig,
        *,
        handoff_id: int,
        epoch: int,
        target_id: int,
        gate: Gate | None = None,
    ) -> None:
        """Begin an attempt.

        Args:
            camera: D1's.
            peer_camera: D2's.
            T_v_c1: calibrated mounting of D1's camera, in the frame of the marker.
            gate: what decides, when it is not to be the one that ``config`` names.
        """
        self.gate = make_gate(config) if gate is None else gate
        self.misses: Counter[MissReason] = Counter()
        self.agreed = 0
        self._views = TwoViews(camera, peer_camera, rigid(T_v_c1))
        self._config = config
        self._identity = (handoff_id, epoch, target_id)
        self._track = Track(config.track_length, config.max_bracket_s)
        self._comparer = Comparer(self._views, config)
        self._rivals = Rivals(self._views, config)
        self._sizes = Sizes(self._views, config)
        self._pending: list[_Pending] = []
        self._max_age_ns = round(config.max_age_s * 1e9)
        self._max_future_ns = round(config.max_future_s * 1e9)

    def observe(
        self,
        frame_id: int,
        stamp_ns: int,
        box: Box | None,
        depth: Depth | None,
        gravity_v: Vec3,
        rivals: Sequence[Rival] = (),
    ) -> Target | Missed:
        """Take in D1's newest frame, and return the message to send or why there is none.

        The gate is told of a miss, unless it is ``ignored``.

        Args:
            frame_id: strictly increasing; its low 16 bits are the message's sequence.
            stamp_ns: mid-exposure, D1's clock.
            box: the tracked target; None when the frame does not show it.
            depth: registered depth over that box.
            gravity_v: unit vector of gravity in the marker frame at ``stamp_ns``.
            rivals: the objects nearest to the target that look like it, in the same frame.
        """
        newest = self._track.newest
        if newest is not None:
            if frame_id == newest.frame:
                return self._ignored(MissReason.DUPLICATE)
            if frame_id < newest.frame:
                return self._ignored(MissReason.STALE)
            if stamp_ns <= newest.stamp_ns:
                return self._ignored(MissReason.STALE)

        if box is not None:
            box = plain_box(box)
        point = self._locate(box, depth, gravity_v)
        if isinstance(point, Missed):
            unseen = Sample(stamp_ns, frame_id, None)
            self._track.add(unseen)
            self.gate.restart(stamp_ns)
            return self._missed(point)

        assert box is not None
        assert depth is not None
        point_v_m = point.point_v_m
        oversize = self._sizes.own(stamp_ns, box, depth, point_v_m, gravity_v)
        edges = (
            box.x,
            box.y,
            box.w,
            box.h,
        )
        place = (*point_v_m, point.z_m, depth.sigma_m)
        # in the order in which ``_judge`` takes them apart
        values = (*edges, *place, *gravity_v, oversize)
        seen = Sample(stamp_ns, frame_id, values)
        self._track.add(seen)
        self._rivals.note(stamp_ns, box, point.z_m, point_v_m, gravity_v, rivals)

        handoff_id, epoch, target_id = self._identity
        return Target(
            handoff_id=handoff_id,
            epoch=epoch,
            target_id=target_id,
            sequence=frame_id & 0xFFFF,
            capture_ns=stamp_ns,
            point_v_m=point_v_m,
            gravity_v=gravity_v,
            sigma_m=point.sigma_m,
        )

    def offer(
        self,
        candidate: Candidate,
        capture_ns: int,
        now_ns: int,
    ) -> Missed | None:
        """Take in a candidate, and return why it is no evidence; None when it will be evaluated.

        Args:
            capture_ns: ``candidate.capture_ns`` converted to D1's clock.
            now_ns: D1's clock.

        Returns:
            A miss is always ``ignored``.
        """
        reason = self._no_evidence(candidate, capture_ns, now_ns)
        if reason is not None:
            return self._ignored(reason)
        order = self._order(candidate.sequence)
        pending = _Pending(order, capture_ns, candidate)
        insort(self._pending, pending)  # by their order, which no two of them share
        return None

    def begin_evidence_anew(self, stamp_ns: int) -> None:
        """Add nothing up across this instant of D1's clock: its own reckoning was interrupted."""
        self.gate.end_run(stamp_ns)

    def evaluate_ready(self, now_ns: int) -> list[PairVerdict]:
        """Judge the candidates that D1's own frames have passed, or that waited too long."""
        pairs: list[PairVerdict] = []
        too_old_ns = now_ns - self._max_age_ns
        newest = self._track.newest
        ready_ns = too_old_ns
        if newest is not None:
            ready_ns = max(newest.stamp_ns, too_old_ns)
        while self._pending:
            pending = self._pending[0]
            if pending.capture_ns > ready_ns:
                return pairs
            self._pending.pop(0)
            if self.gate.expire(pending.capture_ns):
                silent = self._silent(pending.capture_ns)
                pairs.append(silent)
            judged = self._judge(pending.candidate, pending.capture_ns)
            pairs.append(judged)
        # What is older is refused when it comes, so no pair can join the run any more.
        if self.gate.expire(too_old_ns):
            silent = self._silent(now_ns)
            pairs.append(silent)
        return pairs

    def _locate(  # noqa: PLR0911
        self,
        box: Box | None,
        depth: Depth | None,
        gravity_v: Vec3,
    ) -> TargetPoint | Missed:
        """Return the target's place, or why this frame tells none."""
        if box is None:
            return Missed(MissReason.NO_TARGET)
        total = box.x + box.y + box.w + box.h
        if not math.isfinite(total):
            return Missed(MissReason.NON_FINITE)
        if not (box.w > 0.0 and box.h > 0.0):
            return Missed(MissReason.NO_TARGET)
        if depth is None or not self._trusted(depth):
            return Missed(MissReason.NO_DEPTH)
        point = locate(self._views, box, depth, self._config)
        total = sum(point.point_v_m) + point.sigma_m
        if not math.isfinite(total):
            return Missed(MissReason.NON_FINITE)
        if not _is_unit(gravity_v):
            return Missed(MissReason.NON_FINITE)
        return point

    def _trusted(self, depth: Depth) -> bool:
        """Return whether a range can be used."""
        # So that what is no number is not trusted either.
        is_plain = depth.z_m > 0.0 and depth.sigma_m >= 0.0
        if not is_plain:
            return False
        if depth.source is not RangeSource.DEPTH:
            return True
        # The limits are the depth camera's.
        config = self._config
        return config.min_depth_m <= depth.z_m <= config.max_depth_m

    def _no_evidence(  # noqa: PLR0911
        self,
        candidate: Candidate,
        capture_ns: int,
        now_ns: int,
    ) -> MissReason | None:
        identity = (
            candidate.handoff_id,
            candidate.epoch,
            candidate.target_id,
        )
        if identity != self._identity:
            return MissReason.STALE
        if not _is_sound(candidate):
            return MissReason.NON_FINITE
        for pending in self._pending:
            if pending.candidate.sequence == candidate.sequence:
                return MissReason.DUPLICATE
        age_ns = now_ns - capture_ns
        if -age_ns > self._max_future_ns:
            return MissReason.CLOCK
        if age_ns > self._max_age_ns:
            return MissReason.STALE
        if len(self._pending) >= MAX_PENDING:
            return MissReason.STALE
        return self.gate.refusal(candidate.sequence)

    def _order(self, sequence: int) -> int:
        """Return the unwrapped order of a u16 sequence among those pending."""
        if not self._pending:
            return sequence
        first = self._pending[0]
        ahead = serial_difference(sequence, first.candidate.sequence)
        return first.order + ahead

    def _judge(self, candidate: Candidate, capture_ns: int) -> PairVerdict:
        """Compare D2's box with D1's at the instant of its frame, and tell the gate."""
        at = self._track.at(capture_ns)
        reason = self._incomparable(candidate, capture_ns)
        box2 = candidate.box
        if reason is not None or at is None or box2 is None:
            missed = Missed(reason or MissReason.NO_TRACK)
            verdict = self._disagreed(
                candidate.sequence,
                capture_ns,
                missed,
                by=None,
            )
            return PairVerdict(candidate, capture_ns, verdict)

        own = at.values
        own_box = Box(*own[:4])
        z1_m = own[7]
        z_sigma_m = own[8]
        own_oversize = own[12]
        found = self._comparer.compare(own, candidate, box2)
        offsets = self._offsets(found.offset_m, candidate, box2, own_box, own)
        sigma_m = math.hypot(candidate.sigma_m, z_sigma_m)
        peer_oversize = self._sizes.theirs(capture_ns, box2, sigma_m, found)
        outside = Missed(MissReason.PRIOR_OUTSIDE)
        pair = PairVerdict(
            candidate=candidate,
            capture_ns=capture_ns,
            verdict=outside,
            own_box=own_box,
            mapped_box=found.mapped,
            own=at,
            offsets=offsets,
            oversize=max(own_oversize, peer_oversize),
        )
        if found.mapped is None:
            verdict = self._disagreed(
                candidate.sequence,
                capture_ns,
                outside,
                by=None,
            )
            return pair._replace(verdict=verdict)

        tau = threshold(z1_m, self._config)
        pair = pair._replace(tau=tau)
        knows_size = self._config.evidence.span_m > 0.0
        if knows_size and offsets is not None:
            pair = pair._replace(placed_iou=found.placed_iou)
        if found.iou >= tau:
            verdict = self._agreed(pair, at, found.iou, tau)
            return pair._replace(verdict=verdict)
        missed = Missed(MissReason.LOW_IOU, found.iou)
        by = strength(found.iou, tau)
        verdict = self._disagreed(
            candidate.sequence,
            capture_ns,
            missed,
            by,
        )
        return pair._replace(verdict=verdict)

    def _offsets(
        self,
        target_m: Offset | None,
        candidate: Candidate,
        box2: Box,
        own_box: Box,
        own: Values,
    ) -> Offsets | None:
        if target_m is None:
            return None
        if not self._rivals.known:
            return Offsets(target_m)
        rotation = normalized(candidate.rotation_v_c2)
        T_v_c2 = rigid_from_quat(rotation, candidate.position_v_m)
        return self._rivals.offsets(target_m, T_v_c2, box2, own_box, own)

    def _incomparable(self, candidate: Candidate, capture_ns: int) -> MissReason | None:
        """Return why a fresh candidate cannot be compared, whatever D1 saw then; None if it can."""
        if candidate.reason is not None:
            return candidate.reason
        if candidate.sigma_m > self._config.pose_sigma_limit_m:
            return MissReason.POSE_UNCERTAIN
        used = self._track.find(candidate.target_sequence)
        if used is None or used.values is None:
            return MissReason.STALE
        apart_ns = abs(capture_ns - used.stamp_ns)
        if apart_ns > self._max_age_ns:
            return MissReason.STALE
        return None

    def _agreed(
        self,
        pair: PairVerdict,
        at: Between,
        score: float,
        tau: float,
    ) -> Verdict:
        """Let the gate count a pair that agrees; what it refuses becomes a miss."""
        assert pair.candidate is not None
        before = (at.before.frame, at.before.stamp_ns)
        after = (at.after.frame, at.after.stamp_ns)
        counted = FramePair(
            peer_sequence=pair.candidate.sequence,
            capture_ns=pair.capture_ns,
            own_frames=(before, after),
            offsets=pair.offsets,
            oversize=pair.oversize,
            placed_iou=pair.placed_iou,
        )
        refusal = self.gate.agree(counted, score, tau)
        if refusal is not None:
            is_old = refusal is not MissReason.AMBIGUOUS_TARGET
            missed = Missed(refusal, score, ignored=is_old)
            return self._missed(missed)
        self.agreed += 1
        gate = self.gate
        return Agreed(score, tau, gate.count, gate.evidence)

    def _disagreed(
        self,
        sequence: int,
        capture_ns: int,
        missed: Missed,
        by: float | None,
    ) -> Missed:
        """Tell the gate of a pair that does not agree; what is no new evidence is ``ignored``."""
        refusal = self.gate.disagree(sequence, capture_ns, by)
        if refusal is not None:
            missed = Missed(refusal, missed.iou, ignored=True)
        return self._missed(missed)

    def _silent(self, instant_ns: int) -> PairVerdict:
        missed = Missed(MissReason.LINK_SILENT)
        verdict = self._missed(missed)
        return PairVerdict(None, instant_ns, verdict)

    def _ignored(self, reason: MissReason) -> Missed:
        missed = Missed(reason, ignored=True)
        return self._missed(missed)

    def _missed(self, missed: Missed) -> Missed:
        self.misses[missed.reason] += 1
        return missed


def _is_sound(candidate: Candidate) -> bool:
    """Return whether a candidate is finite, and has either a box or a reason for none."""
    box = candidate.box
    rotation = candidate.rotation_v_c2
    has_no_box = box is None
    has_no_reason = candidate.reason is None
    if has_no_box == has_no_reason:
        return False
    total = candidate.sigma_m
    total += sum(candidate.position_v_m)
    total += sum(rotation)
    if box is not None:
        total += box.x + box.y + box.w + box.h
        has_area = box.w > 0.0 and box.h > 0.0
        if not has_area:
            return False
    if not math.isfinite(total):
        return False
    if candidate.sigma_m < 0.0:
        return False
    return _is_unit(rotation)


def _is_unit(parts: Sequence[float]) -> bool:
    length = math.hypot(*parts)
    return abs(length - 1.0) < UNIT_TOLERANCE
