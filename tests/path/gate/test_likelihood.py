"""The gate "likelihood": what offsets say of which object D2's box is of, on paper and drawn as
they are said to be.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.config import EvidenceConfig, MethodConfig
from path.gate.evidence import make_gate
from path.gate.likelihood import HELD_S, LikelihoodGate, Scatter
from path.gate.window import FramePair, Offset, Offsets

MS = 1_000_000
OWN = EvidenceConfig()
SIGMA = OWN.offset_sigma_m
CONFIG = MethodConfig(gate="likelihood")


def told(gate: LikelihoodGate, k: int, offsets: Offsets, iou: float = 0.8) -> None:
    frames = (k, 20 * k * MS), (k + 1, 20 * (k + 1) * MS)
    gate.agree(FramePair(k, 20 * k * MS, frames, offsets), iou, 0.4)


def after(pairs: int, target_m: Offset, *rivals_m: Offset) -> LikelihoodGate:
    gate = make_gate(CONFIG)
    assert isinstance(gate, LikelihoodGate)
    for k in range(pairs):
        told(gate, k, Offsets(target_m, rivals_m))
    return gate


def test_on_the_target_alone_it_is_enough_after_the_shortest_time() -> None:
    done = next(k for k in range(1, 500) if after(k, (0.0, 0.0)).complete)
    assert 0.02 * done <= OWN.min_s + HELD_S + 0.05


@pytest.mark.parametrize("sigmas", [4.5, 6.0])
def test_no_number_of_frames_makes_up_for_an_offset_that_errors_do_not_explain(
    sigmas: float,
) -> None:
    assert not after(1000, (0.0, sigmas * SIGMA)).complete


def test_an_object_as_near_as_the_errors_reach_leaves_nothing_to_be_decided() -> None:
    assert not after(1000, (0.0, 0.0), (2.0 * SIGMA, 0.0)).complete
    assert after(100, (0.0, 0.0), (10.0 * SIGMA, 0.0)).complete


def test_a_box_of_the_other_object_is_never_the_targets() -> None:
    gate = after(1000, (8.0 * SIGMA, 0.0), (0.0, 0.0))
    assert gate.evidence.reached == 0.0


def test_without_scatter_the_ratio_is_that_of_two_normal_distributions_with_heavy_tails() -> None:
    """By hand, for a mean that is 1 sigma from the target and 5 from the other object."""
    gate = after(80, (SIGMA, 0.0), (-5.0 * SIGMA, 0.0))
    n = OWN.offset_known
    by_hand = n * math.log1p(25.0 / (2.0 * n)) - n * math.log1p(1.0 / (2.0 * n))
    assert gate.evidence.reached == pytest.approx(by_hand / math.log(10.0), rel=0.01)


def test_one_that_moves_about_the_box_is_not_what_the_box_is_of() -> None:
    """Another object wanders past the box: its offset is as small in the mean, and scatters ten
    times as much.
    """
    still, moving = make_gate(CONFIG), make_gate(CONFIG)
    for k in range(150):
        x = 8.0 * SIGMA * math.sin(0.05 * k)
        told(still, k, Offsets((0.0, 0.0), ((2.0 * SIGMA, 0.0),)))  # type: ignore[arg-type]
        told(moving, k, Offsets((0.0, 0.0), ((x, 0.0),)))  # type: ignore[arg-type]
    assert moving.evidence is not None and still.evidence is not None
    assert moving.evidence.reached > still.evidence.reached + 1.0


def test_pairs_that_overlap_with_nothing_speak_against_it() -> None:
    some, many = after(0, (0.0, 0.0)), after(0, (0.0, 0.0))
    for k in range(100):
        told(some, k, Offsets((0.0, 0.0)), 0.8 if k % 20 else 0.1)
        told(many, k, Offsets((0.0, 0.0)), 0.8 if k % 2 else 0.1)
    assert some.complete
    assert many.evidence.reached < some.evidence.reached - 0.3


def test_a_run_that_was_broken_off_makes_the_next_one_need_more() -> None:
    gate = after(30, (0.0, 0.0))
    first = gate.evidence.needed
    gate.expire(10_000 * MS)
    for k in range(600, 640):
        told(gate, k, Offsets((0.0, 0.0)))
    assert gate.evidence.needed == pytest.approx(first + math.log10(3.0))


def test_what_was_reckoned_before_a_step_does_not_go_with_what_comes_after() -> None:
    gate = after(90, (0.0, 0.0))
    assert gate.complete
    gate.end_run(90 * 20 * MS)
    told(gate, 91, Offsets((0.0, 0.0)))
    assert not gate.complete and gate.count == 1


def test_correlation_and_variance_are_those_of_the_noise() -> None:
    rng = np.random.default_rng(5)
    scatter, value = Scatter(), np.zeros(2)
    for _ in range(4000):
        value = 0.9 * value + math.sqrt(1.0 - 0.81) * 0.01 * rng.standard_normal(2)
        scatter.note((float(value[0]), float(value[1])))
    assert scatter.correlation == pytest.approx(0.9, abs=0.03)
    assert math.sqrt(scatter.variance) == pytest.approx(0.01, rel=0.15)


def test_boxes_of_something_else_are_accepted_as_seldom_as_the_bound_says() -> None:
    """D2 sees only the other object, wherever it stands; errors are drawn as they are said to
    be.
    """
    rng = np.random.default_rng(11)
    accepted, tries = 0, 400
    for _ in range(tries):
        beta = SIGMA * rng.standard_normal(2)
        angle, apart_m = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, 0.3)
        away = apart_m * np.array([math.cos(angle), math.sin(angle)])
        gate, noise = make_gate(CONFIG), np.zeros(2)
        for k in range(75):
            noise = 0.92 * noise + math.sqrt(1.0 - 0.92**2) * 0.4 * SIGMA * rng.standard_normal(2)
            rival = beta + noise
            target = rival + away
            told(gate, k, Offsets((target[0], target[1]), ((rival[0], rival[1]),)))  # type: ignore[arg-type]
        accepted += gate.complete
    assert accepted <= 2


@pytest.mark.parametrize("scale", [0.2, 5.0, 20.0])
def test_a_world_so_many_times_as_large_is_judged_the_same(scale: float) -> None:
    own = EvidenceConfig(offset_sigma_m=min(1.0, scale * SIGMA))
    factor = own.offset_sigma_m / SIGMA
    usual, other = make_gate(CONFIG), make_gate(MethodConfig(gate="likelihood", evidence=own))
    rng = np.random.default_rng(3)
    for k in range(120):
        x, y = (0.5 * SIGMA * rng.standard_normal(2)).tolist()
        told(usual, k, Offsets((x, y), ((x + 0.3, y),)))  # type: ignore[arg-type]
        told(other, k, Offsets((factor * x, factor * y), ((factor * (x + 0.3), factor * y),)))  # type: ignore[arg-type]
        assert usual.evidence is not None and other.evidence is not None
        assert other.evidence.reached == pytest.approx(usual.evidence.reached, rel=1e-9)
        assert usual.complete is other.complete
