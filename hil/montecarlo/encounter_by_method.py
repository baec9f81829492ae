"""An encounter through the method itself: ``MarkerView``, ``ReceiverCycle`` and ``SenderCycle``, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.rig.parts import Mount
from flight.encounter import MISS, OWN_MISS, PAIR, Attempt, Series
from flight.marker_view import MarkerFix, MarkerView, Motion
from hil.montecarlo.encounter_method import REASONS
from hil.montecarlo.encounter_scene import Believed
from hil.montecarlo.encounter_sight import CLAIMED, FOUND, SEEN, SIGMA, STATUS, UNCLEAR, WHO, Z
from hil.montecarlo.encounter_stage import BLOCK_S, EPOCH_S, Stage
from hil.montecarlo.encounter_state import CANDIDATE_HEARD, RECEIVER_FRAME, SENDER_FRAME
from path.agreement import BoxMapping, TwoViews, depth_in, iou, map_box
from path.config import MethodConfig
from path.geometry import Pose
from path.messages import Candidate, Target, Vec3
from path.observations import Box, Depth, Detection, MarkerDetection, Missed, MissReason, Region
from path.prior import Prior
from path.receiver import ReceiverCycle
from path.rigid import rigid, rigid_from_quat
from path.rotation import normalized
from path.sender import Pair, SenderCycle
from path.timeline import Sample, Track

Array = NDArray[np.float64]
BOTH: tuple[BoxMapping, BoxMapping] = ("center", "corner")


@dataclass(frozen=True, slots=True)
class _View:
    """As much of ``drivers.interfaces.View`` as the marker view looks at."""

    stamp_ns: int
    row: Array
    marker_id: int

    def markers(self, region: Region | None) -> Sequence[MarkerDetection]:
        corners = self.row[:8].reshape(4, 2)
        if self.row[FOUND] == 0.0:
            return ()
        if region is not None and not all(region.contains(u, v) for u, v in corners.tolist()):
            return ()
        return (MarkerDetection(self.marker_id, corners, self.row[CLAIMED] ** 2 * np.eye(8)),)


def play_cycles(attempt: Attempt, stage: Stage, believed: Believed, method: MethodConfig) -> tuple[Series, float]:
    """What D1's gate was told, and for how long it was played."""
    both = _Both(stage, believed, method)
    until_s = 0.0
    for kind, which, now_ns in zip(*(column.tolist() for column in stage.events), strict=True):
        while now_ns >= (until_s + EPOCH_S) * 1e9:
            until_s += BLOCK_S
            stage.fill(until_s)
        if now_ns >= (attempt.limit_s + EPOCH_S) * 1e9:
            break
        both.step(kind, which, now_ns)
        if both.sender.gate.complete and kind == SENDER_FRAME and not attempt.whole:
            break
    return both.record.series, min(until_s, attempt.limit_s)


class _Both:
    """Both drones' cycles on one stage."""

    def __init__(self, stage: Stage, believed: Believed, method: MethodConfig) -> None:
        rig, calibrated = believed.rig, stage.believed
        mount = calibrated.T_b_v.inverse() @ calibrated.T_b_c1
        self._stage = stage
        receiver = Mount(calibrated.T_b_c2, calibrated.T_b_v)
        self._marker_id = rig.layout.markers[0].id
        self._marker = MarkerView(rig.layout, calibrated.camera_2, receiver, method, believed.mission)
        self.sender = SenderCycle(
            calibrated.camera_1, calibrated.camera_2, mount, method, handoff_id=1, epoch=1, target_id=1
        )
        self._receiver = ReceiverCycle(calibrated.camera_2, method, handoff_id=1, epoch=1, target_id=1)
        self._targets: dict[int, Target] = {}
        self._candidates: dict[int, Candidate] = {}
        views = TwoViews(calibrated.camera_1, calibrated.camera_2, rigid(mount))
        self.record = _Record(views, method)
        self._whose: dict[int, float] = {}
        self._own: dict[int, float] = {}

    def step(self, kind: int, which: int, now_ns: int) -> None:
        seen = self._stage.seen
        if kind == SENDER_FRAME:
            self._sender_frame(which, now_ns)
        elif kind == RECEIVER_FRAME:
            self._receiver_frame(which)
        elif kind == CANDIDATE_HEARD:
            candidate = self._candidates[which]
            self.sender.offer(candidate, candidate.capture_ns, now_ns)
        elif which in self._targets:
            target = self._targets[which]
            self._receiver.on_target(target, int(seen.stamp_1[which]), now_ns + self._stage.clock_ns)

    def _sender_frame(self, k: int, now_ns: int) -> None:
        seen = self._stage.seen
        row, stamp_ns, number = seen.own[k], int(seen.stamp_1[k]), int(seen.number_1[k])
        box = Box(*row[1:5].tolist()) if row[STATUS] == SEEN else None
        depth = Depth(float(row[Z]), float(row[SIGMA])) if box is not None and row[Z] > 0.0 else None
        message = self.sender.observe(number, stamp_ns, box, depth, _vector(seen.gravity_v[k]))
        if isinstance(message, Target):
            self._targets[k] = message
            self._own[number] = float(row[WHO])
            assert box is not None
            assert depth is not None
            values = (box.x, box.y, box.w, box.h, *message.point_v_m, depth.z_m)
            self.record.track.add(Sample(stamp_ns, number, values))
        else:
            reason = MissReason.AMBIGUOUS_TARGET if row[STATUS] == UNCLEAR else message.reason
            self.record.own_miss(reason, number, stamp_ns, now_ns)
        for pair in self.sender.evaluate_ready(now_ns):
            self.record.pair(pair, now_ns, self._whose, self._own)

    def _receiver_frame(self, k: int) -> None:
        seen, cycle = self._stage.seen, self._receiver
        stamp_ns, number = int(seen.stamp_2[k]), int(seen.number_2[k])
        view = _View(stamp_ns, seen.markers[k], self._marker_id)
        last = int(seen.heard[k]) - 1
        own, peer = seen.own_moves, seen.peer_moves
        self._marker.note_motion(
            Motion(
                int(own.stamp[k]),
                _vector(own.velocity[k]),
                int(peer.stamp[last]),
                _vector(peer.velocity[last]),
                float(seen.peer_yaw[last]),
            )
        )
        fix = self._marker.look(view, seen.R_n_c[k], cycle.gravity_v(stamp_ns), _vector(seen.gravity_c[k]))  # type: ignore[arg-type]
        if isinstance(fix, MarkerFix):
            biased = Pose(seen.turn @ fix.T_c_v.R, fix.T_c_v.t + seen.shift_c)
            prior = cycle.prior(biased, fix.covariance, stamp_ns)
        else:
            prior = fix
        rows = seen.found[k, : seen.many[k]].tolist()
        found = [Detection(Box(*row[:4]), row[4]) for row in rows]
        if isinstance(prior, Prior):
            found = [each for each in found if prior.region.contains(*each.box.center)]
        candidate = cycle.candidate(number, stamp_ns, found, prior)
        assert isinstance(candidate, Candidate)
        self._candidates[k] = candidate
        box = candidate.box
        if box is not None:
            self._whose[candidate.sequence] = next(row[5] for row in rows if row[:4] == [box.x, box.y, box.w, box.h])


class _Record:
    """What the gate is told, as a series: scores are those of both mappings, whatever the verdict."""

    def __init__(self, views: TwoViews, method: MethodConfig) -> None:
        self.track = Track(method.track_length, method.max_bracket_s)
        self._views = views
        self._rows: list[tuple[int, ...]] = []
        self._values: list[tuple[float, ...]] = []

    def own_miss(self, reason: MissReason, number: int, stamp_ns: int, now_ns: int) -> None:
        self.track.add(Sample(stamp_ns, number, None))
        self._rows.append((OWN_MISS, REASONS.index(reason), now_ns, 0, stamp_ns, number, stamp_ns, 0, 0, 0, 0))
        self._values.append((0.0, 0.0, 0.0, 0.0))

    def pair(self, pair: Pair, now_ns: int, whose: dict[int, float], own_whose: dict[int, float]) -> None:
        """``whose``: object of D2's box by sequence, ``own_whose``: of D1's by frame."""
        candidate, verdict = pair.candidate, pair.verdict
        if candidate is None:
            return
        head = (now_ns, candidate.sequence, pair.capture_ns)
        at = self.track.at(pair.capture_ns)
        if pair.own_box is None or pair.mapped_box is None or at is None:
            assert isinstance(verdict, Missed)
            self._rows.append((MISS, REASONS.index(verdict.reason), *head, 0, 0, 0, 0, 0, 0))
            self._values.append((0.0, 0.0, 0.0, 0.0))
            return
        theirs = whose[candidate.sequence]
        right, same = int(theirs == 0.0), int(theirs == own_whose[at.before.frame])
        own = (at.before.frame, at.before.stamp_ns, at.after.frame, at.after.stamp_ns)
        self._rows.append((PAIR, -1, *head, *own, right, same))
        self._values.append((*self._scores(candidate, at.values, pair.own_box), at.values[7], candidate.sigma_m))

    def _scores(self, candidate: Candidate, values: tuple[float, ...], own_box: Box) -> tuple[float, float]:
        T_v_c2 = rigid_from_quat(normalized(candidate.rotation_v_c2), candidate.position_v_m)
        assert candidate.box is not None
        depths = values[7], depth_in(T_v_c2, (values[4], values[5], values[6]))
        center, corner = (map_box(self._views, T_v_c2, candidate.box, depths, mapping) for mapping in BOTH)
        return (
            math.nan if center is None else iou(own_box, center),
            math.nan if corner is None else iou(own_box, corner),
        )

    @property
    def series(self) -> Series:
        ints = np.array(self._rows, np.int64).reshape(-1, 11)
        floats = np.array(self._values, float).reshape(-1, 4)
        return Series(
            kind=ints[:, 0], reason=ints[:, 1], now_ns=ints[:, 2], sequence=ints[:, 3], capture_ns=ints[:, 4],
            own=ints[:, 5:9], iou=floats[:, :2], z_m=floats[:, 2], pose_sigma_m=floats[:, 3], right=ints[:, 9] != 0,
            same=ints[:, 10] != 0,
        )  # fmt: skip


def _vector(row: Array) -> Vec3:
    x, y, z = row.tolist()
    return x, y, z
