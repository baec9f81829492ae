"""The gate "evidence": what it takes, and what costs it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from path.config import MethodConfig
from path.gate.evidence import EvidenceGate, evidence_of, gain, make_gate, strength
from path.gate.window import AgreementWindow, Offsets
from path.observations import MissReason
from tests.path.gate.fed_evidence import MS, PERIOD, TAU, pair_of
from tests.path.gate.side_by_side import SideBySide

METHOD = MethodConfig(gate="evidence")
OWN = METHOD.evidence
CLEAR = 0.8


def feed(gate: EvidenceGate, indices: range, iou: float = CLEAR) -> int | None:
    """Agreeing pairs until the gate is complete; the index that completed it."""
    for index in indices:
        assert gate.agree(pair_of(index), iou, TAU) is None
        if gate.complete:
            return index
    return None


def test_the_gate_is_the_one_that_the_settings_name() -> None:
    assert isinstance(make_gate(MethodConfig(gate="count")), AgreementWindow)
    assert isinstance(make_gate(MethodConfig(gate="evidence")), EvidenceGate)


def test_a_clear_agreement_takes_four_blocks() -> None:
    gate = EvidenceGate(METHOD)
    assert feed(gate, range(1000)) == 80  # 1.6 s at 50 Hz
    assert 10.0**-gate.evidence.reached == pytest.approx(OWN.first_rate / gain(OWN) ** 3)
    assert 10.0**-gate.evidence.needed == pytest.approx(1e-3 / 2.0)


def test_an_agreement_that_is_only_just_one_never_suffices() -> None:
    gate = EvidenceGate(METHOD)
    only_just = TAU + 0.9 * OWN.strength * (1.0 - TAU)
    assert feed(gate, range(3000), only_just) is None
    assert gate.evidence.reached == 0.0


def test_a_slow_camera_fills_its_blocks_with_pairs_all_the_same() -> None:
    gate, at_10_hz = EvidenceGate(METHOD), 100 * MS
    for index in range(31):
        gate.agree(pair_of(index, at_10_hz), CLEAR, TAU)
        assert not gate.complete
    gate.agree(pair_of(31, at_10_hz), CLEAR, TAU)
    assert gate.complete  # four blocks of eight pairs


def test_a_fast_camera_needs_all_the_time() -> None:
    gate = EvidenceGate(METHOD)
    for index in range(2000):
        gate.agree(pair_of(index, MS), CLEAR, TAU)
        if gate.complete:
            break
    assert gate.span_s == pytest.approx(4 * OWN.block_s, abs=0.002)


def test_a_weak_block_costs_what_it_is_worth() -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(41))
    assert gate.blocks == 2
    before = gate.evidence
    feed(gate, range(41, 61), TAU)
    assert gate.evidence.reached == pytest.approx(before.reached + math.log10(OWN.setback))
    assert gate.evidence.needed == before.needed  # the same run
    assert feed(gate, range(61, 300)) == 60 + 20 * 5


def test_a_first_block_that_does_not_agree_ends_the_run_and_the_next_one_needs_more() -> None:
    gate = EvidenceGate(METHOD)
    needed = gate.evidence.needed
    feed(gate, range(21), TAU)
    assert (gate.count, gate.blocks, gate.evidence.reached) == (0, 0, 0.0)
    assert feed(gate, range(21, 200)) == 21 + 120
    assert gate.evidence.needed > needed


def test_setbacks_eat_up_all_evidence() -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(21))
    feed(gate, range(21, 61), TAU)
    assert (gate.count, gate.evidence.reached) == (0, 0.0)


@pytest.mark.parametrize("what", ["D2 found no box", "D1 found none"])
def test_a_miss_costs_no_evidence_only_time(what: str) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(70))
    before = gate.evidence
    for index in range(70, 85):
        if what == "D2 found no box":
            assert gate.disagree(pair_of(index).peer_sequence, pair_of(index).capture_ns) is None
        else:
            gate.restart(pair_of(index).capture_ns)
        assert gate.evidence == before
        assert not gate.complete
    # the block was long enough by then, and has pairs enough
    assert feed(gate, range(85, 300)) == 85


def test_after_a_long_gap_everything_begins_anew() -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(79))
    assert not gate.expire(pair_of(78 + 50).capture_ns)
    assert gate.expire(pair_of(78 + 51).capture_ns)
    assert gate.evidence.reached == 0.0
    assert feed(gate, range(129, 400)) == 129 + 120  # six blocks in the second run


def test_a_few_boxes_in_wrong_places_cost_nothing_and_many_the_block() -> None:
    few, many = EvidenceGate(METHOD), EvidenceGate(METHOD)
    for index in range(81):
        pair = pair_of(index)
        for gate, every in ((few, 5), (many, 2)):
            if index % every == 1:
                gate.disagree(pair.peer_sequence, pair.capture_ns, strength(0.0, TAU))
                assert not gate.complete
            else:
                gate.agree(pair, CLEAR, TAU)
    assert few.complete
    assert many.evidence.reached == 0.0


@pytest.mark.parametrize(
    ("recall", "frames", "within_s"), [(0.9, 5, 4.0), (0.7, 5, 10.0), (0.7, 15, 10.0)]
)
def test_detectors_that_miss_in_spells_hold_nothing_up_for_long(
    recall: float, frames: int, within_s: float
) -> None:
    rng = np.random.default_rng([4, frames])
    times_s: list[float] = []
    for _ in range(40):
        gate, missed = EvidenceGate(METHOD), [False, False]
        for index in range(1000):
            begin = (1.0 - recall) / recall / frames
            missed = [rng.random() >= 1.0 / frames if m else rng.random() < begin for m in missed]
            pair = pair_of(index)
            gate.expire(pair.capture_ns)
            if any(missed):
                gate.disagree(pair.peer_sequence, pair.capture_ns)
            else:
                gate.agree(pair, CLEAR, TAU)
            if gate.complete:
                times_s.append(index * PERIOD * 1e-9)
                break
    assert len(times_s) == 40
    assert np.median(times_s) < 0.6 * within_s
    assert np.percentile(times_s, 90.0) < within_s


def test_duplicates_and_echoes_are_no_evidence() -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(30))
    before = gate.count, gate.evidence
    for _ in range(500):
        assert gate.agree(pair_of(29), CLEAR, TAU) is MissReason.DUPLICATE
        assert gate.agree(pair_of(12), CLEAR, TAU) is MissReason.STALE
        assert (
            gate.agree(pair_of(29)._replace(peer_sequence=pair_of(12).peer_sequence), 1.0, TAU)
            is not None
        )
        assert gate.disagree(pair_of(12).peer_sequence, 0) is MissReason.STALE
    assert (gate.count, gate.evidence) == before


@pytest.mark.parametrize("iou", [TAU - 0.01, 0.0, math.nan, -math.inf])
def test_a_pair_that_does_not_agree_gains_nothing_whoever_says_otherwise(iou: float) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(80))
    before = gate.count, gate.evidence
    gate.agree(pair_of(80), iou, TAU)
    # it fills the block, which agrees in spite of it
    assert (gate.count, gate.blocks) == (before[0], 4)
    assert not gate.complete
    for index in range(81, 500):
        gate.agree(pair_of(index), iou, TAU)
        assert not gate.complete
    assert gate.evidence.reached == 0.0


@pytest.mark.parametrize(
    ("iou", "tau", "expected"), [(0.4, 0.4, 0.0), (1.0, 0.4, 1.0), (0.7, 0.4, 0.5), (1, 1, 0)]
)
def test_strength(iou: float, tau: float, expected: float) -> None:
    assert strength(iou, tau) == pytest.approx(expected)


def test_side_by_side_gates_see_the_same_and_the_first_decides() -> None:
    window, evidence = AgreementWindow(METHOD), EvidenceGate(METHOD)
    both, alone = SideBySide(window, evidence), EvidenceGate(METHOD)
    for index in range(120):
        pair = pair_of(index)
        if index == 40:
            assert both.disagree(pair.peer_sequence, pair.capture_ns) is None
            alone.disagree(pair.peer_sequence, pair.capture_ns)
        elif index == 60:
            both.restart(pair.capture_ns)
            alone.restart(pair.capture_ns)
        else:
            assert both.agree(pair, CLEAR, TAU) == alone.agree(pair, CLEAR, TAU)
            assert both.agree(pair, CLEAR, TAU) is MissReason.DUPLICATE
        assert (evidence.count, evidence.evidence) == (alone.count, alone.evidence)
    assert not both.complete
    assert (both.count, both.span_s, both.evidence) == (window.count, window.span_s, None)
    assert both.refusal(pair_of(119).peer_sequence) is MissReason.DUPLICATE
    assert both.expire(pair_of(200).capture_ns)
    assert evidence.count == 0


def test_just_enough_evidence_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(1000))
    reached = gate.evidence.reached
    monkeypatch.setattr("path.gate.evidence.evidence_needed", lambda run, config: reached)  # pyright: ignore
    assert gate.complete
    monkeypatch.setattr("path.gate.evidence.evidence_needed", lambda run, config: reached + 1e-9)  # pyright: ignore
    assert not gate.complete


def test_of_several_gates_the_answer_is_the_first_ones() -> None:
    first, second = EvidenceGate(METHOD), EvidenceGate(METHOD)
    second.agree(pair_of(0), CLEAR, 0.5)
    both = SideBySide(first, second)
    assert both.agree(pair_of(0), CLEAR, 0.5) is None  # the second one has it already
    assert second.refusal(pair_of(0).peer_sequence) is MissReason.DUPLICATE
    far_ns = 10**12
    assert first.expire(far_ns)  # it has nothing any more; the second one still does
    assert both.expire(far_ns) is False and second.count == 0


@pytest.mark.parametrize(("less", "agrees"), [(0.0, True), (1e-9, False)])
def test_a_block_exactly_as_strong_as_is_asked_for_agrees(less: float, agrees: bool) -> None:
    """With a threshold of 0 the strength of a pair is its overlap."""
    gate = EvidenceGate(METHOD)
    index = 0
    while not gate.judged.first[0] and index < 1000:
        gate.agree(pair_of(index), OWN.strength - less, 0.0)
        index += 1
    assert gate.judged.first == [1, int(agrees)]


@pytest.mark.parametrize("agreeing", [0, 1])
def test_a_block_in_which_exactly_the_share_agrees_does(agreeing: int) -> None:
    """Its median is strong in both; one pair fewer, and it is none."""
    own = replace(OWN, block_share=0.75, block_pairs=8, block_s=7 * PERIOD * 1e-9)
    gate = EvidenceGate(replace(METHOD, evidence=own))
    for index in range(8):
        if 1 <= index < 4 - agreeing:
            gate.disagree(pair_of(index).peer_sequence, pair_of(index).capture_ns, -0.1)
        else:
            gate.agree(pair_of(index), 1.0, TAU)
    assert gate.judged.first == [1, agreeing]


def test_a_pair_exactly_at_the_threshold_counts_into_the_share() -> None:
    own = replace(OWN, block_share=1.0, block_pairs=8, block_s=7 * PERIOD * 1e-9)
    gate = EvidenceGate(replace(METHOD, evidence=own))
    for index in range(8):
        gate.agree(pair_of(index), TAU if index == 3 else CLEAR, TAU)
    assert gate.judged.first == [1, 1]


def test_another_run_is_not_held_against_where_the_boxes_of_the_last_one_lay() -> None:
    """Nor does it profit from them: what speaks for the target is of the pairs of this run
    alone.
    """
    aside = Offsets((OWN.apart_m, OWN.apart_m))
    fresh, again = EvidenceGate(METHOD), EvidenceGate(METHOD)
    for index in range(200):
        again.agree(pair_of(index)._replace(offsets=aside), CLEAR, TAU)
    assert again.expire(pair_of(400).capture_ns)
    for index in range(401, 600):
        for gate in (fresh, again):
            gate.agree(pair_of(index), CLEAR, TAU)
    assert again._identity == fresh._identity


def test_a_run_without_setbacks_has_the_evidence_of_its_first_block() -> None:
    first = -math.log10(OWN.first_rate)
    assert (evidence_of(0, OWN), evidence_of(1, OWN)) == (0.0, pytest.approx(first))
    assert evidence_of(1, OWN, 1) == pytest.approx(first + math.log10(OWN.setback))


def test_a_run_that_is_ended_is_followed_by_one_that_needs_more_and_what_was_captured_before_does_not_count() -> (
    None
):
    gate = EvidenceGate(METHOD)
    assert feed(gate, range(70)) is None
    needed = gate.evidence.needed
    gate.end_run(pair_of(75).capture_ns)
    assert (gate.count, gate.evidence.reached) == (0, 0.0)
    assert gate.agree(pair_of(74), CLEAR, TAU) is MissReason.STALE
    completed = feed(gate, range(76, 1000))
    assert completed is not None
    assert completed >= 76 + 80
    # the second run of its attempt
    assert gate.evidence.needed == pytest.approx(needed + math.log10(3.0))
