"""The gate "evidence": what it takes, what costs it; its bound holds where one for independent frames breaks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from path.config import EvidenceConfig, MethodConfig
from path.evidence import (
    EvidenceGate,
    SideBySide,
    evidence_needed,
    evidence_of,
    make_gate,
    persistent_bound,
    strength,
)
from path.observations import MissReason
from path.window import AgreementWindow, FramePair

MS = 1_000_000
PERIOD = 20 * MS
METHOD = MethodConfig(gate="evidence")
OWN = METHOD.evidence
TAU = 0.4
CLEAR = 0.8


def pair_of(index: int, period_ns: int = PERIOD) -> FramePair:
    """The index-th pair of a steady stream; the sequence wraps on the way."""
    own = (index, index * period_ns), (index + 1, (index + 1) * period_ns)
    return FramePair((65_500 + index) % 65_536, index * period_ns + 3 * MS, own)


def feed(gate: EvidenceGate, indices: range, iou: float = CLEAR) -> int | None:
    """Agreeing pairs until the gate is complete; the index that completed it."""
    for index in indices:
        assert gate.agree(pair_of(index), iou, TAU) is None
        if gate.complete:
            return index
    return None


def test_the_gate_is_the_one_that_the_settings_name() -> None:
    assert isinstance(make_gate(MethodConfig()), AgreementWindow)
    assert isinstance(make_gate(METHOD), EvidenceGate)


def test_a_clear_agreement_takes_four_blocks() -> None:
    gate = EvidenceGate(METHOD)
    assert feed(gate, range(1000)) == 80  # 1.6 s at 50 Hz
    assert 10.0**-gate.evidence.reached == pytest.approx(3e-3 * 0.5**3)
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


def test_a_weak_block_costs_everything_and_the_next_run_needs_more() -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(41))
    assert gate.blocks == 2
    needed = gate.evidence.needed
    feed(gate, range(41, 61), TAU)
    assert (gate.count, gate.blocks, gate.evidence.reached) == (0, 0, 0.0)
    assert feed(gate, range(61, 200)) == 61 + 120
    assert gate.evidence.needed > needed


@pytest.mark.parametrize("what", ["disagree", "restart", "gap"])
def test_a_miss_costs_everything(what: str) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(79))
    resumed = 80
    if what == "disagree":
        assert gate.disagree(pair_of(79).peer_sequence, pair_of(79).capture_ns) is None
    elif what == "restart":
        gate.restart(pair_of(79).capture_ns)
    else:
        resumed = 90
        assert gate.expire(pair_of(90).capture_ns)
    assert gate.evidence.reached == 0.0
    assert feed(gate, range(resumed, 300)) == resumed + 120  # six blocks in the second run


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
def test_a_pair_that_does_not_agree_is_a_miss_whoever_says_otherwise(iou: float) -> None:
    gate = EvidenceGate(METHOD)
    feed(gate, range(50))
    gate.agree(pair_of(50), iou, TAU)
    assert (gate.count, gate.evidence.reached) == (0, 0.0)


@given(runs=st.integers(1, 400), alpha=st.floats(1e-9, 0.5))
def test_all_runs_together_never_spend_more_than_alpha(runs: int, alpha: float) -> None:
    own = EvidenceConfig(alpha=alpha)
    spent = 0.0
    for run in range(1, runs + 1):
        blocks = next(n for n in range(1, 200) if evidence_of(n, own) >= evidence_needed(run, own))
        spent += own.first_rate * own.next_rate ** (blocks - 1)
    assert spent <= alpha * (1.0 + 1e-9)


def test_the_persistent_part_is_a_tail_beyond_the_reach() -> None:
    assert persistent_bound(0.1, 0.12, 0.03) == 1.0
    assert persistent_bound(0.12 + 0.03 * 4.292, 0.12, 0.03) == pytest.approx(1e-4, rel=0.01)
    assert persistent_bound(0.3, 0.12, 0.0) == 0.0
    rng = np.random.default_rng(3)
    errors = rng.normal(0.0, 0.05, (200_000, 2))
    anywhere = np.hypot(errors[:, 0], errors[:, 1]) >= 0.25 - 0.12  # objects all around, at 0.25 m
    assert np.mean(anywhere) <= persistent_bound(0.25, 0.12, 0.05) * 1.1


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


def runs_of(stream: list[Event]) -> Iterator[tuple[int, list[Event]]]:
    """After each input, the agreeing events since the last miss or gap, from the inputs alone."""
    run: list[Event] = []
    newest = floor = -1
    for event in stream:
        if event.kind == "agree":
            if run and event.tick - run[-1].tick > 5:
                run = []
            run.append(event)
            newest = floor = event.tick
        elif event.kind == "echo":
            tick = max(0, event.tick - 4)
            if tick > newest:  # that packet was lost before: it is news
                newest = tick
                if tick > floor:
                    floor = tick
                    run = [*([] if run and tick - run[-1].tick > 5 else run), Event("agree", tick, 1.0)]
        else:
            run, floor = [], event.tick
            newest = event.tick if event.kind == "disagree" else newest
        yield event.tick, run


@settings(max_examples=300)
@given(events())
def test_complete_only_after_the_floors_and_enough_strong_pairs_without_a_miss(stream: list[Event]) -> None:
    gate, own = EvidenceGate(SMALL), SMALL.evidence
    for event, (_, run) in zip(stream, runs_of(stream), strict=True):
        before = gate.evidence
        play(gate, event)
        assert gate.count <= len(run)
        assert gate.evidence.needed >= before.needed
        if gate.complete:
            counted = run[-gate.count :]
            assert len(counted) >= own.min_pairs
            assert (counted[-1].tick - counted[0].tick) * TICK >= own.min_s * 1e9
            mean = sum(strength(each.iou, TAU) for each in counted) / len(counted)
            # the block under way may be weak, those before it are not
            blocks = evidence_blocks(gate)
            assert blocks * own.block_s * 1e9 <= (counted[-1].tick - counted[0].tick) * TICK
            assert mean >= own.strength * blocks * own.block_pairs / len(counted) - 1e-9


def evidence_blocks(gate: EvidenceGate) -> int:
    return next(n for n in range(1000) if evidence_of(n, SMALL.evidence) >= gate.evidence.reached - 1e-9)


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
    """Share of attempts that Wald's test accepts with the same alpha, from the very densities of one frame's overlap,
    as if the frames were independent; begun again whenever it rejects, as a handshake is."""
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


def gate_test(iou: NDArray[np.float64], config: MethodConfig) -> tuple[float, tuple[int, int], tuple[int, int]]:
    """Share of attempts that the gate accepts, and of the first blocks and of the later ones: judged, agreeing."""
    accepted = 0
    judged, agreeing = [0, 0], [0, 0]
    period = round(1e9 / RATE_HZ)
    for attempt in iou.tolist():
        gate, was_complete = EvidenceGate(config), False
        for index, score in enumerate(attempt):
            pair, blocks, count = pair_of(index, period), gate.blocks, gate.count
            if score >= TAU:
                gate.agree(pair, score, TAU)
            else:
                gate.disagree(pair.peer_sequence, pair.capture_ns)
            stage = min(blocks, 1)
            if gate.blocks > blocks:
                judged[stage] += 1
                agreeing[stage] += 1
            elif count and not gate.count:
                judged[stage] += 1
            was_complete = was_complete or gate.complete
        accepted += was_complete
    return accepted / len(iou), (judged[0], agreeing[0]), (judged[1], agreeing[1])


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
    monkeypatch.setattr("path.evidence.evidence_needed", lambda run, config: reached)  # pyright: ignore
    assert gate.complete
    monkeypatch.setattr("path.evidence.evidence_needed", lambda run, config: reached + 1e-9)  # pyright: ignore
    assert not gate.complete


def test_of_several_gates_the_answer_is_the_first_ones() -> None:
    first, second = EvidenceGate(METHOD), EvidenceGate(METHOD)
    second.agree(pair_of(0), CLEAR, 0.5)
    both = SideBySide(first, second)
    assert both.agree(pair_of(0), CLEAR, 0.5) is None  # the second one has it already
    assert second.refusal(pair_of(0).peer_sequence) is MissReason.DUPLICATE
    far_ns = 10**12
    first.restart(0)
    assert both.expire(far_ns) is False and second.count == 0
