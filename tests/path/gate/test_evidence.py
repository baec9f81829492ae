"""The gate "evidence": what it takes, what costs it; its bound holds where one for independent frames breaks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import (
    EvidenceGate,
    evidence_needed,
    evidence_of,
    gain,
    make_gate,
    persistent_bound,
    strength,
)
from path.gate.window import AgreementWindow, FramePair, Offsets
from path.observations import MissReason
from tests.path.gate.side_by_side import SideBySide

MS = 1_000_000
PERIOD = 20 * MS
METHOD = MethodConfig(gate="evidence")
OWN = METHOD.evidence
TAU = 0.4
CLEAR = 0.8
ON_TARGET = Offsets((0.0, 0.0))


def pair_of(index: int, period_ns: int = PERIOD) -> FramePair:
    """The index-th pair of a steady stream; the sequence wraps on the way."""
    own = (index, index * period_ns), (index + 1, (index + 1) * period_ns)
    return FramePair((65_500 + index) % 65_536, index * period_ns + 3 * MS, own, ON_TARGET)


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
    assert feed(gate, range(85, 300)) == 85  # the block was long enough by then, and has pairs enough


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


@pytest.mark.parametrize(("recall", "frames", "within_s"), [(0.9, 5, 4.0), (0.7, 5, 10.0), (0.7, 15, 10.0)])
def test_detectors_that_miss_in_spells_hold_nothing_up_for_long(recall: float, frames: int, within_s: float) -> None:
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
        assert gate.agree(replace(pair_of(29), peer_sequence=pair_of(12).peer_sequence), 1.0, TAU) is not None
        assert gate.disagree(pair_of(12).peer_sequence, 0) is MissReason.STALE
    assert (gate.count, gate.evidence) == before


@pytest.mark.parametrize("iou", [TAU - 0.01, 0.0, math.nan, -math.inf])
def test_a_pair_that_does_not_agree_gains_nothing_whoever_says_otherwise(iou: float) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(80))
    before = gate.count, gate.evidence
    gate.agree(pair_of(80), iou, TAU)
    assert (gate.count, gate.blocks) == (before[0], 4)  # it fills the block, which agrees in spite of it
    assert not gate.complete
    for index in range(81, 500):
        gate.agree(pair_of(index), iou, TAU)
        assert not gate.complete
    assert gate.evidence.reached == 0.0


@given(runs=st.integers(1, 400), alpha=st.floats(1e-9, 0.5))
def test_all_runs_together_never_spend_more_than_alpha(runs: int, alpha: float) -> None:
    own = EvidenceConfig(alpha=alpha)
    spent = 0.0
    for run in range(1, runs + 1):
        blocks = next(n for n in range(1, 200) if evidence_of(n, own) >= evidence_needed(run, own))
        spent += 10.0 ** -evidence_of(blocks, own)
    assert spent <= alpha * (1.0 + 1e-9)


def test_a_run_of_blocks_that_agree_as_often_as_allowed_is_a_bet_that_does_not_pay() -> None:
    """Whatever the order of agreeing blocks, evidence exceeds 1 / a at any time with a probability of at most a."""
    own, rng = EvidenceConfig(first_rate=0.05), np.random.default_rng(8)
    tries, limits, exceeded = 40_000, (1.5, 2.0, 2.5), np.zeros(3)
    for _ in range(tries):
        if rng.random() >= own.first_rate:
            continue
        blocks, setbacks, most = 1, 0, evidence_of(1, own)
        while evidence_of(blocks, own, setbacks) > 0.0 and blocks + setbacks < 60:
            agrees = rng.random() < own.next_rate
            blocks, setbacks = blocks + agrees, setbacks + (not agrees)
            most = max(most, evidence_of(blocks, own, setbacks))
        exceeded += [most >= limit for limit in limits]
    for limit, count in zip(limits, exceeded.tolist(), strict=True):
        assert count / tries <= 10.0**-limit + 3.0 * math.sqrt(10.0**-limit / tries)


def test_the_persistent_part_is_a_tail_beyond_the_reach_and_heavier_the_less_was_measured() -> None:
    assert persistent_bound(0.1, 0.12, 0.03, 148) == 1.0
    assert persistent_bound(0.3, 0.12, 0.0, 148) == 0.0
    gaussian = math.exp(-0.5 * (0.16 / 0.03) ** 2)
    assert gaussian < persistent_bound(0.3, 0.14, 0.03, 148) < persistent_bound(0.3, 0.14, 0.03, 20)
    assert persistent_bound(0.3, 0.14, 0.03, 10**7) == pytest.approx(gaussian, rel=0.01)
    rng = np.random.default_rng(3)
    measured, beyond = 12, 0
    tries = 40_000
    for _ in range(tries):  # estimate, then be caught out by the next attempt
        errors = rng.normal(0.0, 0.05, (measured + 1, 2))
        sigma = math.sqrt(float(np.mean(errors[:-1] ** 2)))
        beyond += math.hypot(*errors[-1]) >= 3.0 * sigma
    assert beyond / tries == pytest.approx(persistent_bound(3.0, 0.0, 1.0, measured), rel=0.1)


@pytest.mark.parametrize(("iou", "tau", "expected"), [(0.4, 0.4, 0.0), (1.0, 0.4, 1.0), (0.7, 0.4, 0.5), (1, 1, 0)])
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


# --- whatever is fed -------------------------------------------------------------------------------------------------

SMALL = MethodConfig(
    gate="evidence", max_gap_s=0.05, evidence=EvidenceConfig(block_s=0.06, block_pairs=3, min_s=0.15, min_pairs=8)
)
TICK = 10 * MS


@dataclass(frozen=True)
class Event:
    """One input: an agreeing pair (or a repeated one), a disagreement, or a miss of D1."""

    kind: str
    tick: int
    iou: float


@st.composite
def events(draw: st.DrawFn) -> list[Event]:
    """Mostly forward in time and agreeing, with everything else in between."""
    made: list[Event] = []
    tick = 0
    for _ in range(draw(st.integers(1, 8))):
        kind = draw(st.sampled_from(["agree"] * 6 + ["echo", "disagree", "miss"]))
        iou = draw(st.floats(TAU, 1.0))
        for _ in range(draw(st.integers(1, 25))):
            tick += draw(st.sampled_from([1] * 12 + [3, 7]))
            made.append(Event(kind, tick, iou))
            if kind != "agree":
                break
    return made


def play(gate: EvidenceGate, event: Event) -> MissReason | None:
    pair = pair_of(event.tick, TICK)
    if event.kind == "agree":
        return gate.agree(pair, event.iou, TAU)
    if event.kind == "echo":
        return gate.agree(pair_of(max(0, event.tick - 4), TICK), 1.0, TAU)
    if event.kind == "miss":
        gate.restart(pair.capture_ns)
        return None
    return gate.disagree(pair.peer_sequence, pair.capture_ns)


@settings(max_examples=300)
@given(events())
def test_complete_only_after_the_floors_and_with_the_evidence_of_its_blocks(stream: list[Event]) -> None:
    gate, own = EvidenceGate(SMALL), SMALL.evidence
    for event in stream:
        before = gate.evidence
        play(gate, event)
        assert gate.evidence.needed >= before.needed
        assert gate.blocks * own.block_s <= gate.span_s + 1e-9
        if gate.complete:
            assert gate.count >= own.min_pairs
            assert gate.span_s >= own.min_s - 1e-9
            assert gate.evidence.reached >= gate.evidence.needed


@settings(max_examples=100)
@given(events())
def test_what_is_refused_changes_nothing(stream: list[Event]) -> None:
    gate = EvidenceGate(SMALL)
    for event in stream:
        before = gate.count, gate.evidence, gate.complete
        if play(gate, event) is not None:
            assert (gate.count, gate.evidence, gate.complete) == before


@settings(max_examples=100)
@given(st.lists(st.floats(0.62, 1.0), min_size=10, max_size=60), st.data())
def test_more_overlap_in_every_pair_never_takes_longer(ious: list[float], data: st.DataObject) -> None:
    """For streams all of whose pairs are strong enough; a single miss anywhere never makes it faster either."""
    missed = data.draw(st.integers(0, len(ious) - 1))
    plain, raised, broken = EvidenceGate(SMALL), EvidenceGate(SMALL), EvidenceGate(SMALL)
    for index, iou in enumerate(ious):
        pair = pair_of(index, TICK)
        plain.agree(pair, iou, TAU)
        raised.agree(pair, min(1.0, iou + 0.1), TAU)
        if index == missed:
            broken.restart(pair.capture_ns)
        else:
            broken.agree(pair, iou, TAU)
        assert raised.evidence.reached >= plain.evidence.reached >= broken.evidence.reached
        assert plain.complete <= raised.complete
        assert broken.complete <= plain.complete


# --- the bound, where frames are correlated ---------------------------------------------------------------------------

FRAMES, ATTEMPTS, RATE_HZ = 200, 700, 25.0
CORRELATION_S = 0.6
SPREAD, APART = 0.1, 0.42  # of a box side: what varies, and the wrong object's offset
TRUE_OFFSET = 0.1
MODEL_ALPHA = 0.02


def overlaps(rng: np.random.Generator, offset: float) -> NDArray[np.float64]:
    """IoU of equal boxes, (ATTEMPTS, FRAMES), whose offset along one side wanders about a persistent one."""
    keep = math.exp(-1.0 / (RATE_HZ * CORRELATION_S))
    wander = np.empty((ATTEMPTS, FRAMES))
    wander[:, 0] = rng.standard_normal(ATTEMPTS)
    for k in range(1, FRAMES):
        wander[:, k] = keep * wander[:, k - 1] + math.sqrt(1.0 - keep * keep) * rng.standard_normal(ATTEMPTS)
    off = np.minimum(1.0, np.abs(offset + SPREAD * wander))
    return (1.0 - off) / (1.0 + off)


def independent_test(iou: NDArray[np.float64], rng: np.random.Generator) -> float:
    """Returns the share of attempts that Wald's test accepts with the same alpha, as if the frames were independent.

    It has the very densities of one frame's overlap, and is begun again whenever it rejects, as a handshake is.
    """
    edges = np.linspace(0.0, 1.0, 41)
    true = np.histogram(overlaps(rng, TRUE_OFFSET), edges)[0] + 1.0
    wrong = np.histogram(overlaps(rng, APART), edges)[0] + 1.0
    ratio = np.log(true / true.sum()) - np.log(wrong / wrong.sum())
    gains = ratio[np.clip(np.digitize(iou, edges) - 1, 0, len(ratio) - 1)]
    total, accepted = np.zeros(len(iou)), np.zeros(len(iou), bool)
    for k in range(FRAMES):
        total = np.maximum(total + gains[:, k], math.log(MODEL_ALPHA))
        total[total <= math.log(MODEL_ALPHA)] = 0.0
        accepted |= total >= math.log(1.0 / MODEL_ALPHA)
    return float(np.mean(accepted))


def gate_test(iou: NDArray[np.float64], config: MethodConfig) -> tuple[float, list[int], list[int]]:
    """Share of attempts that the gate accepts, and of the first blocks and of the later ones: judged, agreeing."""
    accepted, first, later = 0, [0, 0], [0, 0]
    period = round(1e9 / RATE_HZ)
    for attempt in iou.tolist():
        gate, was_complete = EvidenceGate(config), False
        for index, score in enumerate(attempt):
            gate.agree(pair_of(index, period), score, TAU)
            was_complete = was_complete or gate.complete
        accepted += was_complete
        for k in range(2):
            first[k] += gate.judged.first[k]
            later[k] += gate.judged.later[k]
    return accepted / len(iou), first, later


def test_the_bound_holds_for_correlated_frames_where_one_for_independent_frames_breaks() -> None:
    never = MethodConfig(gate="evidence", evidence=EvidenceConfig(alpha=1e-300))
    _, first, later = gate_test(overlaps(np.random.default_rng([1, 1]), APART), never)
    first_rate, next_rate = (first[1] + 3.0) / first[0], (later[1] + 3.0 * math.sqrt(later[1])) / later[0]
    assert next_rate > 3.0 * first_rate  # they are far from independent: who is in, stays in
    own = EvidenceConfig(alpha=MODEL_ALPHA, first_rate=first_rate, next_rate=next_rate)
    wrong = overlaps(np.random.default_rng([1, 2]), APART)
    false_rate = gate_test(wrong, MethodConfig(gate="evidence", evidence=own))[0]
    true_rate = gate_test(
        overlaps(np.random.default_rng([1, 3]), TRUE_OFFSET), MethodConfig(gate="evidence", evidence=own)
    )[0]
    assert false_rate <= MODEL_ALPHA
    assert true_rate > 0.5
    assert independent_test(wrong, np.random.default_rng([1, 4])) > 10.0 * MODEL_ALPHA


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


def test_what_is_within_reach_is_never_safe_however_small_the_error_is_held_to_be() -> None:
    assert persistent_bound(0.5, 0.5, 0.0, 148) == 1.0
    assert persistent_bound(0.5, 0.4999, 0.0, 148) == 0.0


def test_a_pair_exactly_at_the_threshold_counts_into_the_share() -> None:
    own = replace(OWN, block_share=1.0, block_pairs=8, block_s=7 * PERIOD * 1e-9)
    gate = EvidenceGate(replace(METHOD, evidence=own))
    for index in range(8):
        gate.agree(pair_of(index), TAU if index == 3 else CLEAR, TAU)
    assert gate.judged.first == [1, 1]


def test_another_run_is_not_held_against_where_the_boxes_of_the_last_one_lay() -> None:
    """Nor does it profit from them: what speaks for the target is of the pairs of this run alone."""
    aside = Offsets((OWN.apart_m, OWN.apart_m))
    fresh, again = EvidenceGate(METHOD), EvidenceGate(METHOD)
    for index in range(200):
        again.agree(replace(pair_of(index), offsets=aside), CLEAR, TAU)
    assert again.expire(pair_of(400).capture_ns)
    for index in range(401, 600):
        for gate in (fresh, again):
            gate.agree(pair_of(index), CLEAR, TAU)
    assert again._identity == fresh._identity


def test_a_run_without_setbacks_has_the_evidence_of_its_first_block() -> None:
    first = -math.log10(OWN.first_rate)
    assert (evidence_of(0, OWN), evidence_of(1, OWN)) == (0.0, pytest.approx(first))
    assert evidence_of(1, OWN, 1) == pytest.approx(first + math.log10(OWN.setback))
