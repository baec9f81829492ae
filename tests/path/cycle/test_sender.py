"""D1's cycle, alone and with D2's: what counts, what restarts, and that no disorder on the link
finishes it early.
"""

import math
import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from path.camera.model import CameraModel
from path.config import GateKind, MethodConfig
from path.cycle.prior import Prior
from path.cycle.receiver import ReceiverCycle
from path.cycle.sender import PairVerdict, SenderCycle
from path.gate.agreement import Agreed
from path.gate.evidence import EvidenceGate, strength
from path.gate.window import AgreementWindow
from path.geometry.rotation import exp, quat_from_R
from path.geometry.transforms import Pose
from path.messages import Candidate, Target
from path.observations import Box, Depth, Detection, Missed, MissReason
from path.target.rivals import SEEN_TIMES, Rival
from tests.path.gate.side_by_side import SideBySide

MS = 1_000_000
PERIOD = 20 * MS
LATE_NS = 10**15  # a clock that has run for eleven days
CONFIG = MethodConfig(gate="count", hold_frames=10, hold_s=0.18)
CAMERA1 = CameraModel(640, 480, 615.0, 616.0, 320.0, 240.0, (-0.1, 0.05, 0.001, -0.001, 0.0))
CAMERA2 = CameraModel(1280, 720, 920.0, 925.0, 640.0, 360.0, (-0.08, 0.04, 0.001, -0.001, 0.0))
T_V_C1 = Pose(exp(np.array([0.3, -2.0, 0.4])), np.array([0.1, -0.05, -0.2]))
T_C2_C1 = Pose(exp(np.array([0.1, 0.4, 0.9])), np.array([-0.7, 0.1, 0.8]))
T_V_C2 = T_V_C1 @ T_C2_C1.inverse()
COVARIANCE = np.diag([0.004**2] * 3 + [0.003**2] * 3)
GRAVITY = (0.0, 0.0, 1.0)
DEPTH_M = 2.0
SIZE_M = 0.25


def place(ms: float, speed_mps: float = 0.0) -> np.ndarray:
    """The target in D1's camera frame."""
    return np.array([-0.2 + speed_mps * ms / 1000.0, 0.1, DEPTH_M])


def box_in(camera: CameraModel, point_c: np.ndarray) -> Box:
    x, y, z = point_c.tolist()
    u, v = camera.project_point((x, y, z))
    w, h = camera.fx * SIZE_M / z, camera.fy * SIZE_M / z
    return Box(u - w / 2, v - h / 2, w, h)


def own_box(ms: float, speed_mps: float = 0.0) -> Box:
    return box_in(CAMERA1, place(ms, speed_mps))


def candidate(sequence: int, ms: float, speed_mps: float = 0.0, **changes: Any) -> Candidate:
    """D2's true answer of a frame at ``ms``."""
    x, y, z = T_V_C2.t.tolist()
    box = box_in(CAMERA2, T_C2_C1.apply(place(ms, speed_mps)))
    answered = max(0, math.floor(ms / 20.0)) % 65_536
    rotation = quat_from_R(T_V_C2.R)
    good = Candidate(
        1, 2, 3, sequence % 65_536, answered, round(ms * MS), box, None, (x, y, z), rotation, 0.005
    )
    return replace(good, **changes)


class Bench:
    """A sender whose frames come every 20 ms from 0 on, and whose clock D2 shares."""

    def __init__(self, config: MethodConfig = CONFIG, speed_mps: float = 0.0) -> None:
        self.sender = SenderCycle(
            CAMERA1, CAMERA2, T_V_C1, config, handoff_id=1, epoch=2, target_id=3
        )
        self.speed_mps = speed_mps

    def see(self, index: int, **changes: Any) -> Target | Missed:
        box = changes.get("box", own_box(20.0 * index, self.speed_mps))
        depth = changes.get("depth", Depth(DEPTH_M, 0.02))
        gravity_v, rivals = changes.get("gravity_v", GRAVITY), changes.get("rivals", ())
        return self.sender.observe(index, index * PERIOD, box, depth, gravity_v, rivals)

    def offer(self, message: Candidate, late_ms: float = 5.0) -> Missed | None:
        return self.sender.offer(
            message, message.capture_ns, message.capture_ns + round(late_ms * MS)
        )

    def step(self, index: int, **changes: Any) -> list[PairVerdict]:
        """D1's frame ``index``, after D2's frame 7 ms before it came in."""
        if index:
            self.offer(candidate(index, 20.0 * index - 7.0, self.speed_mps, **changes))
        self.see(index)
        return self.sender.evaluate_ready(index * PERIOD)

    def run(self, last: int, first: int = 0) -> list[PairVerdict]:
        return [pair for index in range(first, last + 1) for pair in self.step(index)]

    @property
    def count(self) -> int:
        return self.sender.gate.count


def test_a_true_pair_agrees_with_full_overlap_whatever_the_relative_roll() -> None:
    (pair,) = Bench().run(1)
    assert isinstance(pair.verdict, Agreed)
    assert pair.verdict.iou > 0.97
    assert pair.verdict.count == 1


def test_the_overlap_where_a_body_has_its_middle_is_told_when_its_size_is_stated() -> None:
    (unstated,) = Bench().run(1)
    assert unstated.placed_iou is None
    stated = replace(CONFIG.evidence, span_m=1.5 * SIZE_M, height_m=1.5 * SIZE_M)
    (pair,) = Bench(replace(CONFIG, evidence=stated)).run(1)
    assert pair.verdict.iou == unstated.verdict.iou  # what S itself says stays as it is
    assert pair.placed_iou is not None
    # these boxes are around points, whose middles lie where they are
    assert 0.5 < pair.placed_iou < 0.99


@pytest.mark.parametrize(("gate", "agrees"), [("evidence", False), ("count", True)])
def test_boxes_larger_than_the_target_disagree_though_they_overlap(
    gate: GateKind, agrees: bool
) -> None:
    sized = replace(CONFIG.evidence, span_m=0.5 * SIZE_M, height_m=0.5 * SIZE_M)
    bench = Bench(replace(CONFIG, gate=gate, evidence=sized))
    (pair,) = bench.run(1)
    assert pair.oversize > sized.size_sigmas
    assert isinstance(pair.verdict, Agreed) == agrees
    if not agrees:
        assert pair.verdict == Missed(MissReason.AMBIGUOUS_TARGET, pair.verdict.iou)
        assert bench.sender.misses == {MissReason.AMBIGUOUS_TARGET: 1}
        # it was an answer
        assert bench.offer(candidate(1, 13.0)) == Missed(MissReason.DUPLICATE, ignored=True)


def test_a_box_that_grows_at_once_in_either_camera_disagrees() -> None:
    bench = Bench(replace(CONFIG, gate="evidence"))
    assert all(isinstance(pair.verdict, Agreed) for pair in bench.run(40))
    box = candidate(41, 813.0).box
    assert box is not None
    (theirs,) = bench.step(41, box=Box(box.x - 0.2 * box.w, box.y, 1.4 * box.w, box.h))
    (after,) = bench.step(42)
    assert theirs.verdict == Missed(MissReason.AMBIGUOUS_TARGET, theirs.verdict.iou)
    assert isinstance(after.verdict, Agreed)
    bench.offer(candidate(43, 859.0))
    own = own_box(860.0)
    bench.see(43, box=Box(own.x - 0.2 * own.w, own.y, 1.4 * own.w, own.h))
    (own_verdict,) = bench.sender.evaluate_ready(43 * PERIOD)
    assert own_verdict.verdict == Missed(MissReason.AMBIGUOUS_TARGET, own_verdict.verdict.iou)


def test_the_papers_corner_would_not() -> None:
    (pair,) = Bench(replace(CONFIG, box_mapping="corner")).run(1)
    assert isinstance(pair.verdict, Missed)
    assert pair.verdict.reason is MissReason.LOW_IOU


def test_the_message_carries_the_target_in_the_marker_frame() -> None:
    target = Bench().see(70_000)
    assert isinstance(target, Target)
    assert target.point_v_m == pytest.approx(T_V_C1.apply(place(0.0)).tolist(), abs=1e-9)
    assert (target.sequence, target.capture_ns) == (70_000 - 65_536, 70_000 * PERIOD)
    assert (target.handoff_id, target.epoch, target.target_id) == (1, 2, 3)
    assert 0.0 < target.sigma_m < 0.1


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"box": None}, MissReason.NO_TARGET),
        ({"box": Box(10.0, 10.0, 0.0, 5.0)}, MissReason.NO_TARGET),
        ({"box": Box(math.nan, 10.0, 5.0, 5.0)}, MissReason.NON_FINITE),
        ({"depth": None}, MissReason.NO_DEPTH),
        ({"depth": Depth(math.nan, 0.01)}, MissReason.NO_DEPTH),
        ({"depth": Depth(0.0, 0.01)}, MissReason.NO_DEPTH),
        ({"depth": Depth(7.0, 0.01)}, MissReason.NO_DEPTH),
        ({"depth": Depth(2.0, math.nan)}, MissReason.NO_DEPTH),
        ({"depth": Depth(2.0, math.inf)}, MissReason.NON_FINITE),
        ({"gravity_v": (0.0, math.nan, 1.0)}, MissReason.NON_FINITE),
        ({"gravity_v": (0.0, 0.0, 9.81)}, MissReason.NON_FINITE),
    ],
)
def test_a_frame_of_d1_without_a_target_restarts_the_count(
    changes: dict[str, Any], reason: MissReason
) -> None:
    bench = Bench()
    bench.run(5)
    assert bench.count == 5
    assert bench.see(6, **changes) == Missed(reason)
    assert bench.count == 0
    assert bench.sender.misses == {reason: 1}


def test_no_pair_is_made_next_to_a_frame_that_saw_nothing_nor_one_from_before_it() -> None:
    bench = Bench()
    bench.run(5)
    bench.offer(candidate(6, 93.0))  # captured before the miss, comes late
    bench.offer(candidate(7, 113.0))  # between frame 5 and the miss
    bench.see(6, box=None)
    late, beside = bench.sender.evaluate_ready(6 * PERIOD)
    assert isinstance(late.verdict, Missed)
    assert late.verdict.ignored
    assert beside.verdict == Missed(MissReason.NO_TRACK)
    assert bench.count == 0


@pytest.mark.parametrize(
    ("frame_id", "stamp_ns", "reason"),
    [
        (5, 5 * PERIOD, MissReason.DUPLICATE),
        (5, 6 * PERIOD, MissReason.DUPLICATE),
        (4, 6 * PERIOD, MissReason.STALE),
        (6, 5 * PERIOD, MissReason.STALE),
        (6, 0, MissReason.STALE),
    ],
)
def test_an_old_or_repeated_frame_of_d1_changes_nothing(
    frame_id: int, stamp_ns: int, reason: MissReason
) -> None:
    bench = Bench()
    bench.run(5)
    result = bench.sender.observe(frame_id, stamp_ns, None, None, GRAVITY)
    assert isinstance(result, Missed)
    assert result.ignored
    assert result.reason is reason
    assert bench.count == 5


def test_a_candidate_waits_for_d1s_frame_after_it_and_meets_d1s_box_of_its_instant() -> None:
    bench = Bench(speed_mps=1.0)
    bench.run(3)
    bench.offer(candidate(4, 73.0, speed_mps=1.0))
    assert bench.sender.evaluate_ready(75 * MS) == []
    bench.see(4)
    (pair,) = bench.sender.evaluate_ready(80 * MS)
    expected = own_box(73.0, speed_mps=1.0)
    assert pair.own_box is not None
    assert pair.own_box.x == pytest.approx(expected.x, abs=0.01)
    assert abs(own_box(60.0, speed_mps=1.0).x - expected.x) > 3.0
    assert isinstance(pair.verdict, Agreed)
    assert pair.verdict.iou > 0.95


def test_a_candidate_that_comes_before_d1s_first_frame_waits_as_long_as_any() -> None:
    bench = Bench()
    bench.offer(candidate(1, 13.0))
    assert bench.sender.evaluate_ready(512 * MS) == []
    (pair,) = bench.sender.evaluate_ready(513 * MS)
    assert pair.verdict == Missed(MissReason.STALE)


def test_depth_of_no_uncertainty_is_depth_and_of_a_negative_one_is_none() -> None:
    assert isinstance(Bench().see(0, depth=Depth(DEPTH_M, 0.0)), Target)
    assert Bench().see(0, depth=Depth(DEPTH_M, -1e-9)) == Missed(MissReason.NO_DEPTH)


def test_what_the_gate_refuses_as_no_new_evidence_is_no_disagreement_either(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench()
    bench.run(5)

    def refuse(_sequence: int, _capture_ns: int, _by: float | None) -> MissReason:
        return MissReason.STALE

    monkeypatch.setattr(bench.sender.gate, "disagree", refuse)
    (pair,) = bench.step(6, box=Box(100.0, 100.0, 80.0, 80.0))
    assert isinstance(pair.verdict, Missed)
    assert (pair.verdict.reason, pair.verdict.ignored) == (MissReason.STALE, True)
    assert bench.count == 5


def test_a_candidate_d1_never_has_a_frame_for_is_a_miss_in_the_end() -> None:
    bench = Bench()
    bench.run(5)
    bench.offer(candidate(6, 113.0))
    assert bench.sender.evaluate_ready(612 * MS) == []
    pairs = bench.sender.evaluate_ready(613 * MS)
    assert [pair.verdict for pair in pairs] == [Missed(MissReason.NO_TRACK)]
    assert bench.count == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"box": None, "reason": MissReason.NO_CANDIDATE}, MissReason.NO_CANDIDATE),
        ({"box": None, "reason": MissReason.MARKER_FLIPPED}, MissReason.MARKER_FLIPPED),
        ({"box": Box(100.0, 100.0, 80.0, 80.0)}, MissReason.LOW_IOU),
        ({"sigma_m": 0.5}, MissReason.POSE_UNCERTAIN),
        ({"position_v_m": (50.0, 50.0, 50.0)}, MissReason.PRIOR_OUTSIDE),
        ({"target_sequence": 40_000}, MissReason.STALE),
    ],
)
def test_a_fresh_frame_of_d2_that_does_not_agree_restarts_the_count(
    changes: dict[str, Any], reason: MissReason
) -> None:
    bench = Bench()
    bench.run(5)
    if reason is MissReason.PRIOR_OUTSIDE:  # turned away from the target
        changes = {"rotation_v_c2": quat_from_R(T_V_C2.R @ exp(np.array([0.0, math.pi, 0.0])))}
    (pair,) = bench.step(6, **changes)
    assert isinstance(pair.verdict, Missed)
    assert pair.verdict.reason is reason
    assert not pair.verdict.ignored
    assert bench.count == 0


@pytest.mark.parametrize(
    ("changes", "compared"),
    [
        ({"box": Box(100.0, 100.0, 80.0, 80.0)}, True),
        ({"box": None, "reason": MissReason.NO_CANDIDATE}, False),
        ({"sigma_m": 0.5}, False),
        ({"target_sequence": 40_000}, False),
        # turned away
        ({"rotation_v_c2": quat_from_R(T_V_C2.R @ exp(np.array([0.0, math.pi, 0.0])))}, False),
    ],
)
def test_the_gate_is_told_by_how_much_a_pair_disagrees_and_of_nothing_where_nothing_was_compared(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], compared: bool
) -> None:
    """A pair that was compared and disagrees speaks against the object; one that could not be
    compared does not.
    """
    bench = Bench()
    bench.run(5)
    told: list[float | None] = []

    def disagree(sequence: int, capture_ns: int, by: float | None) -> None:
        assert (sequence, capture_ns) == (6, 113 * MS)
        told.append(by)

    monkeypatch.setattr(bench.sender.gate, "disagree", disagree)
    (pair,) = bench.step(6, **changes)
    assert pair.candidate is not None and (pair.candidate.sequence, pair.capture_ns) == (
        6,
        113 * MS,
    )
    if not compared:
        assert told == [None]
        return
    assert (
        isinstance(pair.verdict, Missed) and pair.verdict.iou is not None and pair.tau is not None
    )
    assert told == [strength(pair.verdict.iou, pair.tau)]
    assert told[0] is not None and told[0] < -0.5


@pytest.mark.parametrize(
    ("changes", "kept"),
    [
        ({"box": None, "reason": MissReason.NO_CANDIDATE}, True),
        ({"box": Box(100.0, 100.0, 80.0, 80.0)}, False),
    ],
)
def test_frames_that_disagree_cost_what_was_gathered_and_frames_without_a_box_do_not(
    changes: dict[str, Any], kept: bool
) -> None:
    """With the gate that goes by evidence: as many frames of either, after the same agreement."""
    bench = Bench(MethodConfig(gate="evidence"))
    bench.run(60)
    before = bench.sender.gate.evidence
    for index in range(61, 100):
        bench.step(index, **changes)
    after = bench.sender.gate.evidence
    assert before is not None and after is not None and before.reached > 0.0
    assert (after.reached >= before.reached) is kept
    assert not bench.sender.gate.complete


@pytest.mark.parametrize(
    ("message", "late_ms", "reason"),
    [
        (candidate(5, 93.0), 5.0, MissReason.DUPLICATE),
        (candidate(3, 53.0), 5.0, MissReason.STALE),
        (candidate(3, 53.0, box=None, reason=MissReason.NO_CANDIDATE), 5.0, MissReason.STALE),
        (candidate(6, 113.0), 501.0, MissReason.STALE),
        (candidate(6, 113.0), -60.0, MissReason.CLOCK),
        (candidate(6, 113.0, epoch=1), 5.0, MissReason.STALE),
        (candidate(6, 113.0, handoff_id=2), 5.0, MissReason.STALE),
        (candidate(6, 113.0, target_id=4), 5.0, MissReason.STALE),
        (candidate(6, 113.0, box=Box(math.nan, 0.0, 1.0, 1.0)), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, box=Box(0.0, 0.0, -1.0, 1.0)), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, box=None), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, position_v_m=(math.inf, 0.0, 0.0)), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, rotation_v_c2=(0.0, 0.0, 0.0, 0.0)), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, sigma_m=math.nan), 5.0, MissReason.NON_FINITE),
        (candidate(6, 113.0, sigma_m=-0.01), 5.0, MissReason.NON_FINITE),
    ],
)
def test_what_is_no_evidence_is_counted_by_reason_and_changes_nothing(
    message: Candidate, late_ms: float, reason: MissReason
) -> None:
    bench = Bench()
    bench.run(5)
    assert bench.offer(message, late_ms) == Missed(reason, ignored=True)
    assert bench.sender.misses == {reason: 1}
    assert bench.count == 5
    bench.run(6, first=6)
    assert bench.count == 6


def test_an_answer_to_a_target_sample_of_long_ago_does_not_agree() -> None:
    bench = Bench()
    bench.run(40)
    (pair,) = bench.step(41, target_sequence=41 - 26)
    assert pair.verdict == Missed(MissReason.STALE)
    assert bench.count == 0


def test_an_echo_of_a_waiting_candidate_is_a_duplicate() -> None:
    bench = Bench()
    bench.see(0)
    assert bench.offer(candidate(1, 13.0)) is None
    assert bench.offer(candidate(1, 13.0)) == Missed(MissReason.DUPLICATE, ignored=True)
    bench.see(1)
    assert len(bench.sender.evaluate_ready(PERIOD)) == 1
    assert bench.count == 1


def test_a_flood_of_candidates_is_bounded() -> None:
    bench = Bench()
    bench.see(0)
    results = [bench.offer(candidate(i, 10.0 + 0.1 * i)) for i in range(100)]
    assert results.count(None) == 64
    assert results[-1] == Missed(MissReason.STALE, ignored=True)


def test_candidates_that_overtook_each_other_are_judged_in_order() -> None:
    bench = Bench()
    bench.see(0)
    for sequence, ms in ((65_537, 16.0), (65_535, 4.0), (65_536, 10.0)):
        bench.offer(candidate(sequence, ms))
    bench.see(1)
    pairs = bench.sender.evaluate_ready(PERIOD)
    assert [pair.candidate.sequence for pair in pairs if pair.candidate is not None] == [
        65_535,
        0,
        1,
    ]
    # two frames of D1 make two distinct pairs at most
    assert [isinstance(pair.verdict, Agreed) for pair in pairs] == [True, True, False]
    assert bench.count == 2


def test_silence_restarts_once_no_candidate_could_join_any_more() -> None:
    bench = Bench()
    bench.run(5)
    last_ms = 93.0
    for index in range(6, 40):
        bench.see(index)
    limit_ms = last_ms + 1000.0 * (CONFIG.max_gap_s + CONFIG.max_age_s)
    assert bench.sender.evaluate_ready(round(limit_ms * MS)) == []
    assert bench.count == 5
    (silent,) = bench.sender.evaluate_ready(round(limit_ms * MS) + 1)
    assert silent.candidate is None
    assert silent.verdict == Missed(MissReason.LINK_SILENT)
    assert bench.count == 0


def test_a_gap_on_capture_stamps_starts_a_new_run() -> None:
    bench = Bench()
    bench.run(5)
    for index in range(6, 16):
        bench.see(index)
    silent, agreed = bench.step(16)
    assert silent.verdict == Missed(MissReason.LINK_SILENT)
    assert isinstance(agreed.verdict, Agreed)
    assert agreed.verdict.count == 1


def test_a_window_of_lost_packets_within_the_gap_goes_on() -> None:
    bench = Bench()
    bench.run(5)
    for index in range(6, 12):
        bench.see(index)
    bench.run(12, first=12)
    assert bench.count == 6


def test_the_whole_method_agrees_on_a_moving_target_and_completes_on_time() -> None:
    """Both cycles, D2's frames 7 ms before D1's, 8 ms of link; the targets point goes over, the box
    comes back.
    """
    config = MethodConfig(gate="count")
    speed = 0.05
    bench = Bench(config, speed_mps=speed)
    receiver = ReceiverCycle(CAMERA2, config, handoff_id=1, epoch=2, target_id=3)
    T_c2_v = T_V_C2.inverse()
    on_its_way: list[Target] = []
    for index in range(400):
        ms = 20.0 * index - 7.0
        for target in on_its_way:
            receiver.on_target(target, target.capture_ns, target.capture_ns + 8 * MS)
        if index > 1:
            prior = receiver.prior(T_c2_v, COVARIANCE, round(ms * MS))
            assert isinstance(prior, Prior)
            seen = [
                Detection(box_in(CAMERA2, T_C2_C1.apply(place(ms, speed) + offset)), 0.9)
                for offset in (np.zeros(3), np.array([0.4, -0.1, 0.1]))
            ]
            answer = receiver.candidate(index, round(ms * MS), seen, prior)
            assert isinstance(answer, Candidate)
            bench.offer(answer, late_ms=8.0)
        sent = bench.see(index)
        assert isinstance(sent, Target)
        on_its_way = [sent]
        pairs = bench.sender.evaluate_ready(index * PERIOD + MS)
        for pair in pairs:
            assert isinstance(pair.verdict, Agreed)
            assert pair.verdict.iou > 0.9
        if bench.sender.gate.complete:
            break
    assert bench.count == 351
    assert bench.sender.agreed == 351
    assert bench.sender.gate.span_s == pytest.approx(7.0)
    assert not bench.sender.misses
    assert not receiver.misses


def test_the_gate_that_goes_by_evidence_decides_when_the_settings_say_so() -> None:
    bench = Bench(MethodConfig(gate="evidence"))
    pairs = bench.run(81)
    assert bench.sender.gate.complete
    verdicts = [pair.verdict for pair in pairs]
    reached = [
        verdict.evidence.reached
        for verdict in verdicts
        if isinstance(verdict, Agreed) and verdict.evidence
    ]
    assert len(reached) == 81
    assert reached == sorted(reached)
    assert reached[19] == 0.0
    assert reached[20] == pytest.approx(-math.log10(MethodConfig().evidence.first_rate))  # 0.4 s


def test_the_gate_that_goes_by_evidence_wants_a_better_pose() -> None:
    uncertain = MethodConfig().evidence.max_pose_sigma_m * 1.1
    for config, expected in ((MethodConfig(gate="count"), 21), (MethodConfig(gate="evidence"), 20)):
        bench = Bench(config)
        bench.run(20)
        bench.step(21, sigma_m=uncertain)
        assert bench.count == expected


def test_another_gate_can_look_on() -> None:
    window, evidence = AgreementWindow(CONFIG), EvidenceGate(CONFIG)
    sender = SenderCycle(
        CAMERA1,
        CAMERA2,
        T_V_C1,
        CONFIG,
        handoff_id=1,
        epoch=2,
        target_id=3,
        gate=SideBySide(window, evidence),
    )
    bench = Bench()
    bench.sender = sender
    bench.run(70)
    bench.step(71, box=None, reason=MissReason.NO_CANDIDATE)
    bench.run(90, first=72)
    bench.see(91, box=None)
    bench.run(100, first=92)
    assert (window.count, evidence.count) == (8, 97)


def test_a_look_alike_beside_the_target_never_agrees() -> None:
    bench = Bench()
    for index in range(1, 30):
        point = T_C2_C1.apply(place(0.0) + np.array([0.35, 0.0, 0.0]))
        for pair in bench.step(index, box=box_in(CAMERA2, point)):
            assert isinstance(pair.verdict, Missed)
    assert bench.count == 0


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    frames=st.integers(3, 24),
    loss=st.sampled_from([0.0, 0.2]),
    disagreeing=st.sets(st.integers(1, 24), max_size=2),
)
def test_no_disorder_on_the_link_completes_the_window_early(
    seed: int, frames: int, loss: float, disagreeing: set[int]
) -> None:
    """Packets lost, echoed up to three times and shuffled: complete only after enough distinct
    frames that agree.
    """
    rng = random.Random(seed)
    arrivals: list[tuple[float, Candidate]] = []
    for index in range(1, frames + 1):
        ms = 20.0 * index - 7.0
        message = candidate(index, ms)
        if index in disagreeing:
            message = replace(message, box=None, reason=MissReason.NO_CANDIDATE)
        for _ in range(rng.randint(1, 3)):
            if rng.random() >= loss:
                arrivals.append((ms + rng.choice((3.0, 15.0, 60.0)), message))
    arrivals.sort(key=lambda arrival: arrival[0])
    bench = Bench()
    arrived: set[int] = set()
    for tick in range(40 * frames):
        now_ms = 0.5 * tick
        while arrivals and arrivals[0][0] <= now_ms:
            _, message = arrivals.pop(0)
            bench.sender.offer(message, message.capture_ns, round(now_ms * MS))
            arrived.add(message.sequence)
        if tick % 40 == 0:
            bench.see(tick // 40)
        bench.sender.evaluate_ready(round(now_ms * MS))
        assert bench.count <= len(arrived - disagreeing)
        if bench.sender.gate.complete:
            assert len(arrived - disagreeing) >= CONFIG.hold_frames
            assert now_ms >= 13.0 + 180.0


# --- what else D1 sees, and every bound


def test_a_pair_is_measured_from_what_stands_beside_the_target_once_it_was_seen_often_enough() -> (
    None
):
    bench = Bench()
    beside = place(0.0) + np.array([0.5, 0.0, 0.0])
    rival = Rival(box_in(CAMERA1, beside), Depth(DEPTH_M, 0.02))
    told: list[int] = []
    for index in range(SEEN_TIMES + 3):
        bench.offer(candidate(index + 1, 20.0 * index + 13.0))
        bench.see(index, rivals=(rival,))
        for pair in bench.sender.evaluate_ready(index * PERIOD):
            assert pair.offsets is not None
            told.append(len(pair.offsets.rivals_m))
            assert math.hypot(*pair.offsets.target_m) < 0.01
            for offset_m in pair.offsets.rivals_m:
                assert math.hypot(*offset_m) == pytest.approx(0.5, abs=0.05)
    assert told == [0] * (SEEN_TIMES - 2) + [1] * 4


def test_nothing_is_added_up_across_an_interruption_of_its_own_reckoning() -> None:
    bench = Bench()
    bench.run(5)
    bench.sender.begin_evidence_anew(5 * PERIOD)
    assert bench.count == 0
    bench.run(8, first=6)
    assert bench.count == 3


@pytest.mark.parametrize(
    ("z_m", "holds"), [(0.3, True), (6.0, True), (0.299, False), (6.001, False)]
)
def test_depth_is_taken_between_its_bounds_and_at_them(z_m: float, holds: bool) -> None:
    assert (CONFIG.min_depth_m, CONFIG.max_depth_m) == (0.3, 6.0)
    assert isinstance(Bench().see(0, depth=Depth(z_m, 0.02)), Target) is holds


@pytest.mark.parametrize(
    ("length", "holds"), [(0.951, True), (1.049, True), (0.949, False), (1.051, False)]
)
def test_a_direction_and_a_rotation_are_of_length_one_to_a_twentieth(
    length: float, holds: bool
) -> None:
    gravity_v = (0.0, 0.0, length)
    assert isinstance(Bench().see(0, gravity_v=gravity_v), Target) is holds
    bench = Bench()
    w, x, y, z = (length * part for part in quat_from_R(T_V_C2.R))
    refused = bench.offer(candidate(1, 13.0, rotation_v_c2=(w, x, y, z)))
    assert refused == (None if holds else Missed(MissReason.NON_FINITE, ignored=True))


@pytest.mark.parametrize(
    "box",
    [
        Box(0.0, 0.0, 0.0, 1.0),
        Box(0.0, 0.0, 1.0, 0.0),
        Box(0.0, 0.0, 1.0, -1.0),
        Box(0.0, math.inf, 1.0, 1.0),
        Box(0.0, 0.0, math.inf, 1.0),
        Box(0.0, 0.0, 1.0, math.inf),
    ],
)
def test_a_box_without_a_size_is_none_on_either_side(box: Box) -> None:
    assert Bench().offer(candidate(1, 13.0, box=box)) == Missed(MissReason.NON_FINITE, ignored=True)
    reason = (
        MissReason.NO_TARGET
        if math.isfinite(box.x + box.y + box.w + box.h)
        else MissReason.NON_FINITE
    )
    assert Bench().see(0, box=box) == Missed(reason)


def test_a_box_smaller_than_a_pixel_is_a_box() -> None:
    box = Box(320.0, 240.0, 0.4, 0.4)
    assert Bench().offer(candidate(1, 13.0, box=box)) is None
    assert isinstance(Bench().see(0, box=box), Target)


def test_a_pose_of_no_uncertainty_is_a_pose() -> None:
    assert Bench().offer(candidate(1, 13.0, sigma_m=0.0)) is None


@pytest.mark.parametrize(("age_ns", "reason"), [(500 * MS, None), (500 * MS + 1, MissReason.STALE)])
def test_a_candidate_is_evidence_until_it_is_too_old(
    age_ns: int, reason: MissReason | None
) -> None:
    message = candidate(1, 13.0)
    refused = Bench().sender.offer(message, LATE_NS, LATE_NS + age_ns)
    assert refused == (None if reason is None else Missed(reason, ignored=True))


@pytest.mark.parametrize(("early_ns", "reason"), [(50 * MS, None), (50 * MS + 1, MissReason.CLOCK)])
def test_a_candidate_may_come_a_little_before_its_time(
    early_ns: int, reason: MissReason | None
) -> None:
    message = candidate(9, 173.0)
    refused = Bench().sender.offer(message, LATE_NS, LATE_NS - early_ns)
    assert refused == (None if reason is None else Missed(reason, ignored=True))


def test_a_candidate_of_the_very_instant_of_a_frame_is_judged_with_that_frame() -> None:
    bench = Bench()
    bench.see(0)
    bench.offer(candidate(1, 20.0))
    assert bench.sender.evaluate_ready(PERIOD) == []
    bench.see(1)
    (pair,) = bench.sender.evaluate_ready(PERIOD)
    assert isinstance(pair.verdict, Agreed)
    assert pair.own_box == own_box(20.0)


@pytest.mark.parametrize("more", [0.0, 1e-9])
def test_a_pair_agrees_when_it_reaches_what_is_asked_of_it(
    monkeypatch: pytest.MonkeyPatch, more: float
) -> None:
    (usual,) = Bench().run(1)
    assert isinstance(usual.verdict, Agreed)
    asked = usual.verdict.iou + more

    def threshold(z_m: float, _config: MethodConfig) -> float:
        assert z_m == pytest.approx(DEPTH_M)
        return asked

    monkeypatch.setattr("path.cycle.sender.threshold", threshold)
    (pair,) = Bench().run(1)
    assert pair.tau == asked
    assert isinstance(pair.verdict, Missed if more else Agreed)


@pytest.mark.parametrize("more", [0.0, 1e-6])
def test_a_pose_at_the_limit_of_its_uncertainty_is_compared(more: float) -> None:
    bench = Bench()
    bench.run(3)
    (pair,) = bench.step(4, sigma_m=CONFIG.pose_sigma_limit_m + more)
    assert isinstance(pair.verdict, Missed if more else Agreed)


@pytest.mark.parametrize("more_ms", [0, 1])
def test_an_answer_may_rest_on_a_sample_as_old_as_a_candidate_may_be(more_ms: int) -> None:
    bench = Bench()
    for index in range(29):
        bench.see(index)
    bench.offer(candidate(1, 540.0 + more_ms, target_sequence=2))  # whose frame was taken at 40 ms
    (pair,) = bench.sender.evaluate_ready(28 * PERIOD)
    assert isinstance(pair.verdict, Missed if more_ms else Agreed)


def test_a_message_carries_the_low_bits_of_its_frame_s_number() -> None:
    bench = Bench()
    sent = bench.see(65_536 + 7)
    assert isinstance(sent, Target)
    assert sent.sequence == 7 and sent.capture_ns == (65_536 + 7) * PERIOD
    assert (sent.handoff_id, sent.epoch, sent.target_id, sent.gravity_v) == (1, 2, 3, GRAVITY)
    expected = T_V_C1.apply(place(0.0))
    assert sent.point_v_m == pytest.approx(tuple(expected.tolist()), abs=0.02)
