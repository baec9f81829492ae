"""The bound of the gate "evidence": it holds where one for independent frames breaks, whatever is
fed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import EvidenceGate, evidence_needed, evidence_of, persistent_bound
from path.gate.window import Gate
from path.observations import MissReason
from tests.path.gate.fed_evidence import MS, TAU, pair_of


@given(runs=st.integers(1, 400), alpha=st.floats(1e-9, 0.5))
def test_all_runs_together_never_spend_more_than_alpha(runs: int, alpha: float) -> None:
    own = EvidenceConfig(alpha=alpha)
    spent = 0.0
    for run in range(1, runs + 1):
        blocks = next(n for n in range(1, 200) if evidence_of(n, own) >= evidence_needed(run, own))
        spent += 10.0 ** -evidence_of(blocks, own)
    assert spent <= alpha * (1.0 + 1e-9)


def test_a_run_of_blocks_that_agree_as_often_as_allowed_is_a_bet_that_does_not_pay() -> None:
    """Whatever the order of agreeing blocks, evidence exceeds 1 / a at any time with a probability
    of at most a.
    """
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


# --- whatever is fed

SMALL = MethodConfig(
    gate="evidence",
    max_gap_s=0.05,
    evidence=EvidenceConfig(block_s=0.06, block_pairs=3, min_s=0.15, min_pairs=8),
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


def play(gate: Gate, event: Event) -> MissReason | None:
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
def test_complete_only_after_the_floors_and_with_the_evidence_of_its_blocks(
    stream: list[Event],
) -> None:
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
def test_more_overlap_in_every_pair_never_takes_longer(
    ious: list[float], data: st.DataObject
) -> None:
    """For streams all of whose pairs are strong enough; a single miss anywhere never makes it
    faster either.
    """
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


# --- the bound, where frames are correlated

FRAMES, ATTEMPTS, RATE_HZ = 200, 700, 25.0

CORRELATION_S = 0.6

SPREAD, APART = 0.1, 0.42  # of a box side: what varies, and the wrong object's offset

TRUE_OFFSET = 0.1
MODEL_ALPHA = 0.02


def overlaps(rng: np.random.Generator, offset: float) -> NDArray[np.float64]:
    """IoU of equal boxes, (ATTEMPTS, FRAMES), whose offset along one side wanders about a
    persistent one.
    """
    keep = math.exp(-1.0 / (RATE_HZ * CORRELATION_S))
    wander = np.empty((ATTEMPTS, FRAMES))
    wander[:, 0] = rng.standard_normal(ATTEMPTS)
    for k in range(1, FRAMES):
        wander[:, k] = keep * wander[:, k - 1] + math.sqrt(1.0 - keep * keep) * rng.standard_normal(
            ATTEMPTS
        )
    off = np.minimum(1.0, np.abs(offset + SPREAD * wander))
    return (1.0 - off) / (1.0 + off)


def independent_test(iou: NDArray[np.float64], rng: np.random.Generator) -> float:
    """Returns the share of attempts that Wald's test accepts with the same alpha, as if the frames
    were independent.

    It has the very densities of one frame's overlap, and is begun again whenever it rejects, as a
    handshake is.
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
    """Share of attempts that the gate accepts, and of the first blocks and of the later ones:
    judged, agreeing.
    """
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
    first_rate, next_rate = (
        (first[1] + 3.0) / first[0],
        (later[1] + 3.0 * math.sqrt(later[1])) / later[0],
    )
    assert next_rate > 3.0 * first_rate  # they are far from independent: who is in, stays in
    own = EvidenceConfig(alpha=MODEL_ALPHA, first_rate=first_rate, next_rate=next_rate)
    wrong = overlaps(np.random.default_rng([1, 2]), APART)
    false_rate = gate_test(wrong, MethodConfig(gate="evidence", evidence=own))[0]
    true_rate = gate_test(
        overlaps(np.random.default_rng([1, 3]), TRUE_OFFSET),
        MethodConfig(gate="evidence", evidence=own),
    )[0]
    assert false_rate <= MODEL_ALPHA
    assert true_rate > 0.5
    assert independent_test(wrong, np.random.default_rng([1, 4])) > 10.0 * MODEL_ALPHA


def test_what_is_within_reach_is_never_safe_however_small_the_error_is_held_to_be() -> None:
    assert persistent_bound(0.5, 0.5, 0.0, 148) == 1.0
    assert persistent_bound(0.5, 0.4999, 0.0, 148) == 0.0
