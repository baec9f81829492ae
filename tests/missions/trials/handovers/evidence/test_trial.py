"""The trial of the evidence gate: its quick form, and that its blocks are counted as they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flight.harness.montecarlo import Attempt
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.handovers.evidence.blocks import (
    LAGS,
    Blocks,
    EvidenceAttempt,
    correlation,
    judge,
)
from missions.trials.handovers.evidence.trial import FORCED_WAYS, QUICK, SIDE_M, rate, reach_m, run
from missions.trials.handovers.judging import Verdict, judge_all
from missions.trials.shared.trial import TrialRequest, TrialResult
from path.config import MethodConfig
from path.gate.evidence import EvidenceGate
from path.gate.window import FramePair

METHOD = MethodConfig(gate="evidence")
PERIOD_NS = 20_000_000


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialResult:
    with open_work(1) as work:
        out = tmp_path_factory.mktemp("trial")
        result = run(TrialRequest(rig_library.load("sim-rendered"), out, 5, True, work))
    assert [(out / picture).read_bytes()[:4] for picture in result.pictures] == [b"\x89PNG"]
    return result


def test_true_pairs_commit_in_less_than_two_seconds(result: TrialResult) -> None:
    assert result.summary["true_attempts"] == QUICK
    assert 1.6 <= result.summary["evidence_median_s"] <= 2.0
    assert result.summary["true_wrong"] == 0
    assert result.findings[0].verdict == "met"


def test_few_attempts_do_not_show_that_the_rates_hold(result: TrialResult) -> None:
    assert [finding.verdict for finding in result.findings[1:3]] == ["short", "short"]
    assert result.summary["first_rate"]["upper"] > METHOD.evidence.first_rate


def test_every_forced_way_is_in_the_table(result: TrialResult) -> None:
    forced = sum(len(forms) for forms in FORCED_WAYS.values())
    assert len(result.summary["forced"]) == forced + 1
    assert len(result.tables[1].rows) == forced + 1
    assert result.noise is not None


def told(first: tuple[int, int], later: tuple[int, int]) -> EvidenceAttempt:
    blocks = (Blocks(first, later),)
    return EvidenceAttempt(0, Verdict(), Verdict(), 1.0, 0.0, blocks, np.zeros(len(LAGS)))


def test_a_rate_counts_blocks_and_resamples_attempts() -> None:
    agreeing, judged, (low, high) = rate(
        [told((100, 0), (0, 0))] * 9 + [told((100, 50), (60, 40))], False, 1
    )
    assert (agreeing, judged) == (50, 1000)
    assert low == 0.0  # one attempt has all of them
    assert high > 0.1
    assert rate([told((5, 0), (0, 0))], True, 1) == (0, 0, (0.0, 1.0))
    assert rate([told((1000, 0), (0, 0))], False, 1)[2][1] == pytest.approx(3.0 / 1000, rel=0.01)


def test_the_reach_is_where_equal_boxes_overlap_that_little() -> None:
    off = reach_m(1.0, 0.4)
    assert (1.0 - off) / (1.0 + off) == pytest.approx(0.4 + 0.05 * 0.6)
    assert reach_m() == pytest.approx(SIDE_M * reach_m(1.0))


def pair_of(index: int) -> FramePair:
    return FramePair(
        index, index * PERIOD_NS, ((index, index * PERIOD_NS), (index + 1, (index + 1) * PERIOD_NS))
    )


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("+" * 61, Blocks((1, 1), (2, 2))),
        ("+" * 21 + "-" * 20, Blocks((1, 1), (1, 0))),  # a weak block
        ("-" * 21 + "+" * 21, Blocks((2, 1), (0, 0))),
        # misses of both drones within the second
        ("+" * 30 + "x" * 5 + "m" * 5 + "+", Blocks((1, 1), (1, 1))),
        ("+" * 10 + "x" * 5 + "+" * 6, Blocks((1, 1), (0, 0))),
        ("+" * 10 + "." * 60 + "+" * 21, Blocks((1, 1), (0, 0))),  # a gap
        ("xxmm", Blocks((0, 0), (0, 0))),
    ],
)
def test_blocks_are_counted_as_they_end(stream: str, expected: Blocks) -> None:
    gate = EvidenceGate(METHOD)
    for index, kind in enumerate(stream, 1):
        pair = pair_of(index)
        if kind == "m":
            gate.restart(pair.capture_ns)
        elif kind != ".":
            gate.expire(pair.capture_ns)
            if kind == "x":
                gate.disagree(pair.peer_sequence, pair.capture_ns)
            else:
                gate.agree(pair, 0.8 if kind == "+" else 0.41, 0.4)
    first, later = gate.judged.first, gate.judged.later
    assert Blocks((first[0], first[1]), (later[0], later[1])) == expected


def test_correlation_of_a_slow_wave_and_of_too_little() -> None:
    slow = correlation(np.sin(np.arange(1000) * 2.0 * math.pi / 300.0))
    assert slow[0] > 0.99 and abs(slow[-1]) < 0.1  # a quarter of the wave
    assert np.isnan(correlation(np.arange(20.0))).all()
    assert np.isnan(correlation(np.ones(1000))).all()


def test_the_same_attempt_runs_the_same() -> None:
    rig = rig_library.load("sim-rendered")
    asked = [Attempt(5, 1, limit_s=2.5)]
    (first,), (again,) = judge_all(rig, judge, asked), judge_all(rig, judge, asked)
    assert (first.strength, first.blocks, first.count) == (
        again.strength,
        again.blocks,
        again.count,
    )
    assert np.isfinite(first.strength)
