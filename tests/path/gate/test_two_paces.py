"""Two tests on the same pairs, in short blocks and in long ones that may be weaker."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import EvidenceGate, TwoPaces, evidence_needed, evidence_of, make_gate
from path.gate.window import FramePair, Gate, Offsets
from tests.path.gate.fed_evidence import TAU, pair_of
from tests.path.gate.test_evidence_bound import (
    APART,
    MODEL_ALPHA,
    RATE_HZ,
    TRUE_OFFSET,
    Event,
    events,
    gate_test,
    overlaps,
    play,
)

OWN = EvidenceConfig(
    patient_block_s=1.0, patient_strength=0.1, patient_first_rate=0.08, patient_next_rate=0.5
)
PATIENT = MethodConfig(gate="evidence", evidence=OWN)
STRONG, WEAK, TOO_WEAK = 0.5, 0.15, 0.05


def completed(gate: Gate, strengths: list[float]) -> int | None:
    """The pair that completed the gate, fed with agreeing pairs so strong, at 50 Hz."""
    for index, strong in enumerate(strengths):
        assert gate.agree(pair_of(index), TAU + strong * (1.0 - TAU), TAU) is None
        if gate.complete:
            return index
    return None


def replaced(pair: FramePair, off_m: float) -> FramePair:
    return pair._replace(offsets=Offsets((off_m, 0.0)))


def test_both_together_may_spend_alpha() -> None:
    short, patient = OWN.paces
    assert short.accident_share + patient.accident_share == pytest.approx(1.0)
    spent = [10.0 ** -evidence_needed(1, own) for own in (short, patient)]
    assert sum(spent) == pytest.approx(10.0 ** -evidence_needed(1, EvidenceConfig()))
    assert (patient.block_s, patient.strength, patient.next_rate) == (1.0, 0.1, 0.5)
    assert EvidenceConfig().paces == (EvidenceConfig(),)


def test_the_gate_has_two_paces_where_the_settings_say_so() -> None:
    assert isinstance(make_gate(PATIENT), TwoPaces)
    assert isinstance(make_gate(MethodConfig(gate="evidence")), EvidenceGate)


def test_a_clear_agreement_takes_as_long_as_with_short_blocks_alone() -> None:
    short, _ = OWN.paces
    alone = EvidenceGate(replace(PATIENT, evidence=short))
    assert (
        completed(make_gate(PATIENT), [STRONG] * 300)
        == completed(alone, [STRONG] * 300)
        is not None
    )


def test_a_weak_agreement_that_lasts_takes_the_long_blocks_that_are_needed() -> None:
    _, patient = OWN.paces
    blocks = next(
        n for n in range(1, 100) if evidence_of(n, patient) >= evidence_needed(1, patient)
    )
    assert completed(make_gate(PATIENT), [WEAK] * 3000) == 50 * blocks
    assert completed(make_gate(replace(PATIENT, evidence=EvidenceConfig())), [WEAK] * 3000) is None
    assert completed(make_gate(PATIENT), [TOO_WEAK] * 3000) is None


@pytest.mark.parametrize(("off_m", "passes"), [(0.073, True), (0.076, False)])
def test_errors_that_last_are_asked_for_the_same_by_both(off_m: float, passes: bool) -> None:
    """What is shared is the chance of an accident."""
    gate = make_gate(PATIENT)
    for index in range(3000):
        pair = replaced(pair_of(index), off_m)
        gate.agree(pair, TAU + WEAK * (1.0 - TAU), TAU)
    assert gate.complete == passes


@settings(max_examples=200)
@given(events())
def test_either_alone_decides_and_nothing_else_does(stream: list[Event]) -> None:
    small = EvidenceConfig(
        block_s=0.06,
        block_pairs=3,
        min_s=0.15,
        min_pairs=8,
        patient_block_s=0.2,
        patient_strength=0.05,
    )
    method = MethodConfig(gate="evidence", max_gap_s=0.05, evidence=small)
    both, each = (
        make_gate(method),
        [EvidenceGate(replace(method, evidence=own)) for own in small.paces],
    )
    for event in stream:
        answers = {play(gate, event) for gate in (both, *each)}
        assert len(answers) == 1
        assert both.complete == any(gate.complete for gate in each)
        assert both.evidence in [gate.evidence for gate in each]
        assert both.count in [gate.count for gate in each]


def accepted(iou: NDArray[np.float64], method: MethodConfig) -> float:
    """Share of the attempts that the gate is complete in at some time."""
    gates = [make_gate(method) for _ in iou]
    return sum(
        _is_accepted(gate, attempt) for gate, attempt in zip(gates, iou.tolist(), strict=True)
    ) / len(iou)


def _is_accepted(gate: Gate, attempt: list[float]) -> bool:
    for index, score in enumerate(attempt):
        gate.agree(pair_of(index, round(1e9 / RATE_HZ)), score, TAU)
        if gate.complete:
            return True
    return False


def test_the_bound_holds_for_both_together_with_the_rates_that_are_measured_of_each() -> None:
    """Rates of boxes that wander about an offset at which they do not agree, and other such
    boxes.
    """
    wrong, again = (overlaps(np.random.default_rng([7, k]), APART) for k in range(2))
    never = replace(OWN, alpha=1e-300, min_pairs=16)
    rates: list[float] = []
    for own in never.paces:
        _, first, later = gate_test(wrong, MethodConfig(gate="evidence", evidence=own))
        rates += [(first[1] + 3.0) / first[0], (later[1] + 3.0 * math.sqrt(later[1])) / later[0]]
    own = replace(
        never,
        alpha=MODEL_ALPHA,
        first_rate=rates[0],
        next_rate=rates[1],
        patient_first_rate=rates[2],
        patient_next_rate=max(rates[2], rates[3]),
    )
    method = MethodConfig(gate="evidence", evidence=own)
    assert accepted(again, method) <= MODEL_ALPHA
    assert accepted(overlaps(np.random.default_rng([7, 2]), TRUE_OFFSET), method) > 0.5


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"patient_block_s": 0.3}, "patient_block_s"),
        ({"patient_block_s": 1.0, "patient_first_rate": 0.6}, "patient_first_rate"),
        ({"patient_block_s": 1.0, "patient_share": 1.0}, "patient_share"),
    ],
)
def test_settings_that_cannot_be_right_are_named(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=f"^{named}: "):
        EvidenceConfig(**changes)


def test_a_run_that_is_ended_is_ended_at_both_paces() -> None:
    gate = TwoPaces(PATIENT)
    assert completed(gate, [STRONG] * 70) is None
    gate.end_run(pair_of(70).capture_ns)
    assert [pace.count for pace in gate.paces] == [0, 0]
