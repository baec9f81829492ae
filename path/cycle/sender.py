"""One cycle of D1, the sender: say where the target is, judge what D2 answers. Pure: stamps come
in, values go out.
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
        """``camera`` is D1's, ``peer_camera`` D2's; ``T_v_c1`` the calibrated mounting of D1's
        camera.

        ``gate``: what decides, when it is not to be the one that ``config`` names.
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
        """D1's newest frame: the message to send, or why there is none. The gate is told of a miss,
        unless ``ignored``.

        Args:
            frame_id: strictly increasing; its low 16 bits are the message's sequence.
            stamp_ns: mid-exposure, D1's clock.
            box: the tracked target; None when the frame does not show it.
            depth: registered depth over that box.
            gravity_v: unit vector of gravity in the marker frame at ``stamp_ns``.
            rivals: the objects nearest to the target that look like it, in the same frame.
        """
        newest = self._track.newest
        if newest is not None and (frame_id <= newest.frame or stamp_ns <= newest.stamp_ns):
            reason = MissReason.DUPLICATE if frame_id == newest.frame else MissReason.STALE
            return self._missed(Missed(reason, ignored=True))
        box = None if box is None else plain_box(box)
        point = Missed(MissReason.NO_TARGET) if box is None else self._locate(box, depth, gravity_v)
        if isinstance(point, Missed):
            self._track.add(Sample(stamp_ns, frame_id, None))
            self.gate.restart(stamp_ns)
            return self._missed(point)
        assert box is not None
        assert depth is not None
        above = self._sizes.own(stamp_ns, box, depth, point.point_v_m, gravity_v)
        place = *point.point_v_m, point.z_m
        self._track.add(
            Sample(
                stamp_ns,
                frame_id,
                (box.x, box.y, box.w, box.h, *place, depth.sigma_m, *gravity_v, above),
            )
        )
        self._rivals.note(stamp_ns, box, point.z_m, point.point_v_m, gravity_v, rivals)
        handoff_id, epoch, target_id = self._identity
        sequence = frame_id & 0xFFFF
        return Target(
            handoff_id,
            epoch,
            target_id,
            sequence,
            stamp_ns,
            point.point_v_m,
            gravity_v,
            point.sigma_m,
        )

    def offer(self, candidate: Candidate, capture_ns: int, now_ns: int) -> Missed | None:
        """Take in a candidate; None when it will be evaluated, else why it is no evidence (always
        ``ignored``).

        Args:
            capture_ns: ``candidate.capture_ns`` converted to D1's clock.
            now_ns: D1's clock.
        """
        reason = self._no_evidence(candidate, capture_ns, now_ns)
        if reason is not None:
            return self._missed(Missed(reason, ignored=True))
        pending = _Pending(self._order(candidate.sequence), capture_ns, candidate)
        insort(self._pending, pending)  # by their order, which no two of them share
        return None

    def begin_evidence_anew(self, stamp_ns: int) -> None:
        """D1's own reckoning was interrupted at that instant (D1's clock): nothing is added up
        across it.
        """
        self.gate.end_run(stamp_ns)

    def evaluate_ready(self, now_ns: int) -> list[PairVerdict]:
        """Judge every candidate whose capture instant D1's own frames have passed, or that waited
        too long.
        """
        pairs: list[PairVerdict] = []
        newest = self._track.newest
        newest_ns = (
            now_ns - self._max_age_ns
            if newest is None
            else max(newest.stamp_ns, now_ns - self._max_age_ns)
        )
        while self._pending and self._pending[0].capture_ns <= newest_ns:
            pending = self._pending.pop(0)
            if self.gate.expire(pending.capture_ns):
                pairs.append(self._silent(pending.capture_ns))
            pairs.append(self._judge(pending.candidate, pending.capture_ns))
        # what is older than max_age_s is refused, so no pair can join the run any more
        if not self._pending and self.gate.expire(now_ns - self._max_age_ns):
            pairs.append(self._silent(now_ns))
        return pairs

    def _locate(self, box: Box, depth: Depth | None, gravity_v: Vec3) -> TargetPoint | Missed:
        if not math.isfinite(box.x + box.y + box.w + box.h):
            return Missed(MissReason.NON_FINITE)
        if not (box.w > 0.0 and box.h > 0.0):
            return Missed(MissReason.NO_TARGET)
        if depth is None or not self._trusted(depth):
            return Missed(MissReason.NO_DEPTH)
        point = locate(self._views, box, depth, self._config)
        norm = math.hypot(*gravity_v)
        if not (
            math.isfinite(sum(point.point_v_m) + point.sigma_m) and abs(norm - 1.0) < UNIT_TOLERANCE
        ):
            return Missed(MissReason.NON_FINITE)
        return point

    def _trusted(self, depth: Depth) -> bool:
        """Return whether a range can be used: the limits of the depth camera are of what it
        measured.
        """
        if not (depth.z_m > 0.0 and depth.sigma_m >= 0.0):
            return False
        config = self._config
        return (
            depth.source is not RangeSource.DEPTH
            or config.min_depth_m <= depth.z_m <= config.max_depth_m
        )

    def _no_evidence(self, candidate: Candidate, capture_ns: int, now_ns: int) -> MissReason | None:
        if (candidate.handoff_id, candidate.epoch, candidate.target_id) != self._identity:
            return MissReason.STALE
        if not _is_sound(candidate):
            return MissReason.NON_FINITE
        for pending in self._pending:
            if pending.candidate.sequence == candidate.sequence:
                return MissReason.DUPLICATE
        if capture_ns - now_ns > self._max_future_ns:
            return MissReason.CLOCK
        if now_ns - capture_ns > self._max_age_ns or len(self._pending) >= MAX_PENDING:
            return MissReason.STALE
        return self.gate.refusal(candidate.sequence)

    def _order(self, sequence: int) -> int:
        """Unwrapped order of a u16 sequence among those pending."""
        if not self._pending:
            return sequence
        first = self._pending[0]
        return first.order + serial_difference(sequence, first.candidate.sequence)

    def _judge(self, candidate: Candidate, capture_ns: int) -> PairVerdict:
        at = self._track.at(capture_ns)
        reason = self._incomparable(candidate, capture_ns)
        box2 = candidate.box
        if reason is not None or at is None or box2 is None:
            missed = self._disagreed(
                candidate.sequence, capture_ns, Missed(reason or MissReason.NO_TRACK), None
            )
            return PairVerdict(candidate, capture_ns, missed)
        x, y, w, h, _, _, _, z1, z_sigma, _, _, _, oversize = at.values
        own_box = Box(x, y, w, h)
        found = self._comparer.compare(at.values, candidate, box2)
        offsets = self._offsets(found.offset_m, candidate, box2, own_box, at.values)
        sigma_m = math.hypot(candidate.sigma_m, z_sigma)
        oversize = max(oversize, self._sizes.theirs(capture_ns, box2, sigma_m, found))
        tau = placed_iou = None
        if found.mapped is None:
            verdict: Verdict = Missed(MissReason.PRIOR_OUTSIDE)
            verdict = self._disagreed(candidate.sequence, capture_ns, verdict, None)
        else:
            tau = threshold(z1, self._config)
            if offsets is not None and self._config.evidence.span_m > 0.0:
                placed_iou = found.placed_iou
            if found.iou >= tau:
                own = (at.before.frame, at.before.stamp_ns), (at.after.frame, at.after.stamp_ns)
                pair = FramePair(candidate.sequence, capture_ns, own, offsets, oversize, placed_iou)
                verdict = self._agreed(pair, found.iou, tau)
            else:
                missed = Missed(MissReason.LOW_IOU, found.iou)
                verdict = self._disagreed(
                    candidate.sequence, capture_ns, missed, strength(found.iou, tau)
                )
        return PairVerdict(
            candidate,
            capture_ns,
            verdict,
            own_box,
            found.mapped,
            tau,
            at,
            offsets,
            oversize,
            placed_iou,
        )

    def _offsets(
        self, target_m: Offset | None, candidate: Candidate, box2: Box, own_box: Box, own: Values
    ) -> Offsets | None:
        if target_m is None:
            return None
        if not self._rivals.known:
            return Offsets(target_m)
        T_v_c2 = rigid_from_quat(normalized(candidate.rotation_v_c2), candidate.position_v_m)
        return self._rivals.offsets(target_m, T_v_c2, box2, own_box, own)

    def _incomparable(self, candidate: Candidate, capture_ns: int) -> MissReason | None:
        """Return why a fresh candidate cannot even be compared, whatever D1 saw at that instant;
        None when it can.
        """
        if candidate.reason is not None:
            return candidate.reason
        if candidate.sigma_m > self._config.pose_sigma_limit_m:
            return MissReason.POSE_UNCERTAIN
        used = self._track.find(candidate.target_sequence)
        if (
            used is None
            or used.values is None
            or abs(capture_ns - used.stamp_ns) > self._max_age_ns
        ):
            return MissReason.STALE
        return None

    def _agreed(self, pair: FramePair, score: float, tau: float) -> Verdict:
        """Let the gate count a pair that agrees; what it refuses becomes a miss, mostly an
        ``ignored`` one.
        """
        refusal = self.gate.agree(pair, score, tau)
        if refusal is not None:
            return self._missed(
                Missed(refusal, score, ignored=refusal is not MissReason.AMBIGUOUS_TARGET)
            )
        self.agreed += 1
        return Agreed(score, tau, self.gate.count, self.gate.evidence)

    def _disagreed(
        self, sequence: int, capture_ns: int, missed: Missed, by: float | None
    ) -> Missed:
        """Tell the gate of a pair that does not agree; what is no new evidence becomes an
        ``ignored`` miss.
        """
        refusal = self.gate.disagree(sequence, capture_ns, by)
        return self._missed(
            missed if refusal is None else Missed(refusal, missed.iou, ignored=True)
        )

    def _silent(self, instant_ns: int) -> PairVerdict:
        return PairVerdict(None, instant_ns, self._missed(Missed(MissReason.LINK_SILENT)))

    def _missed(self, missed: Missed) -> Missed:
        self.misses[missed.reason] += 1
        return missed


def _is_sound(candidate: Candidate) -> bool:
    """Return whether a candidate is finite, its rotation is one, and a box is there exactly when
    no reason is.
    """
    total = sum(candidate.position_v_m) + sum(candidate.rotation_v_c2) + candidate.sigma_m
    box = candidate.box
    if box is not None:
        total += box.x + box.y + box.w + box.h
        if not (box.w > 0.0 and box.h > 0.0):
            return False
    norm = math.hypot(*candidate.rotation_v_c2)
    one_of_two = (box is None) != (candidate.reason is None)
    return (
        math.isfinite(total)
        and abs(norm - 1.0) < UNIT_TOLERANCE
        and candidate.sigma_m >= 0.0
        and one_of_two
    )
