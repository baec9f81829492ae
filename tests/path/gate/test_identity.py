"""Which object D2's box is of: the ratio of likelihoods, and that its bound holds for errors as
they are said to be.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import EvidenceGate, evidence_needed
from path.gate.identity import Identity, against_rival, against_unseen, nearest_rival
from path.gate.likelihood import REACH_SIGMAS
from path.gate.window import FramePair, Offset, Offsets

OWN = EvidenceConfig()
SIGMA = OWN.offset_sigma_m
ENOUGH = evidence_needed(1, OWN)
MS = 1_000_000


def gate_after(pairs: int, offsets: Offsets | None) -> EvidenceGate:
    gate = EvidenceGate(MethodConfig(gate="evidence"))
    for k in range(pairs):
        frames = (k, 20 * k * MS), (k + 1, 20 * (k + 1) * MS)
        gate.agree(FramePair(k, 20 * k * MS, frames, offsets), 0.9, 0.4)
    return gate


def test_on_the_target_with_nothing_beside_it_is_enough() -> None:
    assert gate_after(100, Offsets((0.0, 0.0))).complete
    assert gate_after(100, Offsets((2.0 * SIGMA, 0.0))).complete


def test_no_number_of_frames_makes_up_for_an_offset_that_errors_do_not_explain() -> None:
    assert not gate_after(2000, Offsets((0.0, 4.0 * SIGMA))).complete


def test_a_box_between_the_target_and_another_object_is_no_evidence() -> None:
    gate = gate_after(2000, Offsets((0.06, 0.0), ((-0.06, 0.0),)))
    assert gate.evidence.reached == 0.0
    assert not gate.complete


def test_an_object_that_is_as_near_as_the_errors_reach_is_no_evidence_whatever_the_offset() -> None:
    assert not gate_after(2000, Offsets((0.0, 0.0), ((3.0 * SIGMA, 0.0),))).complete


def test_an_object_beyond_the_errors_does_not_disturb() -> None:
    assert gate_after(100, Offsets((0.01, 0.0), ((0.5, 0.0), (0.0, -0.6)))).complete


def test_runs_that_began_too_weakly_are_no_more_observations_of_errors_that_last() -> None:
    """An offset that is enough in an attempt's first run is enough in its fifth; one that is not
    never is.
    """

    def complete(offset_m: float) -> bool:
        gate = EvidenceGate(MethodConfig(gate="evidence"))
        for k in range(300):
            frames = (k, 20 * k * MS), (k + 1, 20 * (k + 1) * MS)
            # above the threshold, but not by as much as a first block needs
            iou = 0.45 if k < 100 else 0.9
            gate.agree(FramePair(k, 20 * k * MS, frames, Offsets((offset_m, 0.0))), iou, 0.4)
        assert gate.evidence.needed > ENOUGH + 0.5
        return gate.complete

    assert against_unseen((2.3 * SIGMA, 0.0), OWN) == pytest.approx(ENOUGH, abs=0.2)
    assert complete(2.3 * SIGMA)
    assert not complete(2.7 * SIGMA)


def test_an_object_to_which_d1_itself_may_have_gone_over_is_no_evidence_while_it_is_there() -> None:
    gate = gate_after(200, Offsets((0.01, 0.0), ((0.3, 0.0),)))
    assert gate.evidence.reached == pytest.approx(-math.log10(OWN.swap))
    assert not gate.complete
    for k in range(200, 260):
        frames = (k, 20 * k * MS), (k + 1, 20 * (k + 1) * MS)
        gate.agree(FramePair(k, 20 * k * MS, frames, Offsets((0.01, 0.0))), 0.9, 0.4)
    assert gate.complete


def test_pairs_of_which_nobody_knows_the_offset_identify_nothing() -> None:
    gate = gate_after(2000, None)
    assert gate.evidence.reached == 0.0
    assert not gate.complete


def test_an_object_that_comes_up_counts_from_then_on_and_in_the_next_run_only_when_it_is_there() -> (
    None
):
    identity = Identity()
    for _ in range(50):
        identity.note(Offsets((0.01, 0.0)))
    alone = identity.reached(OWN)
    identity.note(Offsets((0.01, 0.0), ((0.02, 0.0),)))
    assert identity.reached(OWN) < 0.5 < alone


def test_before_any_pair_there_is_no_evidence() -> None:
    assert Identity().reached(OWN) == 0.0


def test_the_nearest_of_several() -> None:
    assert nearest_rival(Offsets((0.0, 0.0), ((0.3, 0.0), (0.0, 0.2), (1.0, 1.0)))) == (0.0, 0.2)
    assert nearest_rival(Offsets((0.0, 0.0))) is None


def test_ratios_as_by_hand() -> None:
    """For errors known exactly they are those of normal distributions."""
    exact = EvidenceConfig(offset_known=10_000, offset_sigma_m=0.02, unseen=1e-3)
    target, rival = (0.02, 0.0), (0.0, 0.08)
    assert against_rival(target, rival, exact) == pytest.approx(
        (16.0 - 1.0) / 2.0 / math.log(10.0), rel=1e-2
    )
    anywhere = 1.0 / (math.pi * (REACH_SIGMAS * 0.02) ** 2)
    here = math.exp(-0.5) / (2.0 * math.pi * 0.02**2)
    assert against_unseen(target, exact) == pytest.approx(
        math.log10(here / (1e-3 * anywhere)), rel=1e-3
    )


@pytest.mark.parametrize("distance_m", [0.02, 0.05, 0.08, 0.12, 0.2])
def test_a_box_of_the_rival_is_taken_for_the_targets_no_more_often_than_the_bound(
    distance_m: float,
) -> None:
    """Errors that last are drawn once; the box is of the rival: the ratio exceeds 1/a in a share a
    of them at most.
    """
    rng, count, bar = np.random.default_rng(5), 100_000, 2.0
    errors = SIGMA * rng.standard_normal((count, 2))
    rival: list[Offset] = [(x, y) for x, y in errors.tolist()]
    fooled = sum(against_rival((x + distance_m, y), (x, y), OWN) >= bar for x, y in rival)
    assert fooled / count <= 10.0**-bar


def test_a_box_of_something_unseen_passes_no_more_often_than_the_bound() -> None:
    rng, count, bar = np.random.default_rng(6), 100_000, 3.3
    off = REACH_SIGMAS * SIGMA * np.sqrt(rng.random(count))
    fooled = sum(against_unseen((x, 0.0), OWN) >= bar for x in off.tolist())
    assert OWN.unseen * fooled / count <= 10.0**-bar


@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0, 20.0])
def test_the_same_offset_in_errors_says_the_same_however_large_the_errors_are(scale: float) -> None:
    """Where boxes of a boat lie 0.14 m apart, D2 looks for it as many times farther: it was never
    handed over.
    """
    larger = replace(OWN, offset_sigma_m=scale * SIGMA)
    there = against_unseen((scale * SIGMA, 0.0), larger)
    assert there == pytest.approx(against_unseen((SIGMA, 0.0), OWN))
    assert there > ENOUGH


def test_true_boxes_pass() -> None:
    """Errors of the size stated: 94 in 100 reach what a first run needs."""
    rng = np.random.default_rng(7)
    passed = [
        against_unseen((x, y), OWN) >= ENOUGH
        for x, y in (SIGMA * rng.standard_normal((20_000, 2))).tolist()
    ]
    assert np.mean(passed) > 0.94


@pytest.mark.parametrize(
    ("beside_m", "object_m", "seen", "handed_over"),
    [
        (0.00, 0.35, True, False),  # D1 may have gone over to it itself
        (0.06, 0.35, True, False),
        # what beats the gate: the error is the whole way, which nobody said it can be
        (0.00, 0.50, True, True),
        (0.06, 0.50, True, True),
        (0.06, 1.00, True, True),
        (0.09, 0.50, True, False),
        (0.09, 1.00, True, False),
        (0.00, 0.35, False, True),
        (0.06, 0.20, False, True),
        (0.09, 0.35, False, False),
        (0.12, 1.00, False, False),
    ],
)
def test_a_prior_that_is_forced_onto_another_object(
    beside_m: float, object_m: float, seen: bool, handed_over: bool
) -> None:
    """A pose that is off by as much as lies between the objects, all but ``beside_m``: by the same
    wrong pose the other object's box is mapped to that far from the target. No frame can tell
    (docs/gates.md).
    """
    rivals = ((beside_m - object_m, 0.0),) if seen else ()
    assert gate_after(2000, Offsets((beside_m, 0.0), rivals)).complete is handed_over
