"""The sweep of the thresholds: that it decides as the window does, chooses by its rule, and its quick form."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from flight.harness.montecarlo import (
    MISS,
    OWN_MISS,
    PAIR,
    Attempt,
    FaultName,
    HandoverRunner,
    MonteCarloHandover,
    Series,
    WrongAssociation,
    tell,
)
from missions import rig_library
from missions.trials.handshake.handovers import runner_of
from missions.trials.shared.statistics import Interval
from missions.trials.shared.trial import TrialRequest, TrialResult
from missions.trials.thresholds import trial as thresholds
from missions.trials.thresholds.choice import MAY_COST, PAPER_N, Shares, choose, curve, difference, halves, index_of
from missions.trials.thresholds.grid import BINS, FRAMES, MAPPINGS, RIGHT, WRONG, Outcomes, Setting, grid, outcomes
from missions.trials.thresholds.series import (
    BESIDE,
    FAULT_NAMES,
    NEAR,
    ON,
    WAYS,
    GridAttempt,
    true_attempts,
    wrong_attempts,
)
from missions.work import open_work
from path.config import MethodConfig
from path.gate.window import AgreementWindow

RIG = rig_library.load("sim-rendered")
PERIOD_NS = 20_000_000


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialResult:
    out = tmp_path_factory.mktemp("trial")
    with open_work(1) as work:
        result = thresholds.run(TrialRequest(RIG, out, 5, True, work))
    assert [(out / picture.file).read_bytes()[:4] for picture in result.pictures] == [b"\x89PNG"] * 2
    return result


@cache
def runner() -> HandoverRunner:
    return runner_of(str(RIG.file))


def agrees_with_the_window(series: Series, step: int) -> None:
    found = outcomes(series, MethodConfig())
    for k in range(0, len(grid()), step):
        for n, frames in enumerate(FRAMES):
            method = grid()[k].method(MethodConfig(), frames)
            done = tell(series, AgreementWindow(method), method)
            expected = 0 if done is None else RIGHT if series.right[done] else WRONG
            assert found.commit[k, n] == expected, (grid()[k], frames)


@pytest.mark.parametrize("fault", ["link_delay", "camera_freeze", "look_alike_near", "mixed"])
def test_all_settings_at_once_decide_as_the_window_itself(fault: FaultName) -> None:
    agrees_with_the_window(runner().run(Attempt(7, 1, fault, limit_s=8.5, whole=True)).series, 61)


@pytest.mark.parametrize("number", range(4))
def test_they_do_on_streams_that_no_link_makes(number: int) -> None:
    """Repeated, overtaking, missing and late entries, and a sequence that wraps round."""
    rng = np.random.default_rng(number)
    count = 900
    sequence = 65_000 + np.arange(count) + rng.choice([0, 0, 0, 0, 0, -1, -3, 1], count)
    capture = np.arange(count) * PERIOD_NS + np.cumsum(rng.choice([0, 300_000_000], count, p=[0.997, 0.003]))
    own = np.stack((np.arange(count), capture - 5_000_000, np.arange(count) + 1, capture + 15_000_000), axis=1)
    own[rng.random(count) < 0.02] -= [1, PERIOD_NS, 1, PERIOD_NS]
    kind = rng.choice([PAIR, MISS, OWN_MISS], count, p=[0.99, 0.006, 0.004])
    capture[kind == OWN_MISS] += 3 * PERIOD_NS  # of a frame newer than those of D2 that come in after it
    iou = np.clip(rng.normal(0.75, 0.08, (count, 2)), 0.0, 1.0)
    series = Series(
        kind, np.full(count, -1), np.arange(count) // 2 * 2 * PERIOD_NS, sequence & 0xFFFF, capture, own, iou,
        rng.uniform(1.0, 3.0, count), np.full(count, 0.01), *(rng.random((2, count)) < 0.5),
    )  # fmt: skip
    agrees_with_the_window(series, 43)
    assert (outcomes(series, MethodConfig()).commit[:, 0] > 0).any()


def test_an_empty_series_commits_nothing() -> None:
    n, x = np.zeros(0, np.int64), np.zeros(0)
    empty = Series(n, n, n, n, n, np.zeros((0, 4), np.int64), np.zeros((0, 2)), x, x, n > 0, n > 0)
    assert not outcomes(empty, MethodConfig()).commit.any()


def test_the_grid_has_the_default_and_every_setting_once() -> None:
    assert len(set(grid())) == len(grid()) > 400
    assert Setting.of(MethodConfig()) in grid()
    assert {setting.mapping for setting in grid()} == set(MAPPINGS)
    assert all(setting.tau_min <= setting.tau_max for setting in grid())


def shares(right: dict[int, float], wrong: dict[int, tuple[float, float]]) -> Shares:
    """Settings that are not named are bad in both."""
    table = np.zeros((len(grid()), len(FRAMES)))
    errors = np.ones_like(table)
    for k, value in right.items():
        table[k, PAPER_N] = value
    for k, (long, short) in wrong.items():
        errors[k, PAPER_N], errors[k, 0] = long, short
    return Shares(table, errors, np.zeros_like(table))


def test_the_strictest_setting_that_costs_nothing_is_chosen() -> None:
    right = {3: 0.80, 5: 0.80 - 0.9 * MAY_COST, 8: 0.80 - 1.1 * MAY_COST, 9: 0.795}
    assert choose(shares(right, {3: (0.1, 0.5), 5: (0.05, 0.5), 8: (0.0, 0.0), 9: (0.05, 0.6)})) == 5
    assert choose(shares(right, {3: (0.05, 0.5), 5: (0.05, 0.5), 8: (0.0, 0.0), 9: (0.05, 0.5)})) == 3  # the most true


def tried(way: str, iou: Sequence[float], committed: int, number: int = 0) -> GridAttempt:
    """Every setting with every window comes to the same; all pairs are of what the attempt is about."""
    counts = np.zeros((2, len(MAPPINGS), BINS), np.int64)
    for value in iou:
        counts[int(not way), :, int(value * BINS)] += 1
    wrong = WrongAssociation("lock", 0.5) if way else None
    commit = np.full((len(grid()), len(FRAMES)), committed, np.int8)
    return GridAttempt(way, Attempt(0, number, wrong=wrong), Outcomes(commit, counts))


def area(*some: GridAttempt) -> tuple[float, Interval]:
    found = curve(some, "center", np.random.default_rng(0))
    assert found is not None
    assert (np.diff(found.true) <= 0.0).all() and (np.diff(found.false) <= 0.0).all()
    return found.auc, found.interval


def test_the_area_under_the_curve_is_the_chance_to_tell_them_apart() -> None:
    true = tried("", [0.7, 0.8, 0.9], RIGHT)
    assert area(true, tried(NEAR, [0.1, 0.3], 0))[0] == 1.0
    assert area(true, tried(NEAR, [0.95], 0))[0] == 0.0
    assert area(true, tried(NEAR, [0.7, 0.8, 0.9], 0))[0] == pytest.approx(0.5)
    assert area(true, tried(NEAR, [0.75], 0), tried(BESIDE, [0.75], 0))[0] == pytest.approx(2.0 / 3.0)
    assert area(true, tried(NEAR, [0.1], 0), tried(ON, [0.95], 0))[0] == 1.0  # those on it are not told by overlap
    low, high = area(true, *(tried(NEAR, [0.1 + 0.08 * k], 0) for k in range(10)))[1]
    assert low < area(true, *(tried(NEAR, [0.1 + 0.08 * k], 0) for k in range(10)))[0] < high
    assert curve([true], "center", np.random.default_rng(0)) is None


def test_shares_tell_true_and_forced_attempts_apart() -> None:
    some = [tried("", [0.8], RIGHT), tried("", [0.8], WRONG), tried(NEAR, [0.5], WRONG), tried(NEAR, [0.5], 0)]
    found = Shares.of(some)
    assert (found.right == 0.5).all() and (found.slipped == 0.5).all() and (found.wrong == 0.5).all()
    assert difference(some, 0, 1, forced=True, rng=np.random.default_rng(0)) == (0.0, 0.0)


def test_halves_share_every_kind_and_no_attempt() -> None:
    asked = [*true_attempts("rig", 0, 56), *wrong_attempts("rig", 0, 20)]
    some = [
        GridAttempt(each.way, each.attempt, Outcomes(np.zeros(0, np.int8), np.zeros(0, np.int64))) for each in asked
    ]
    one, other = halves(some)
    indices = [{each.attempt.index for each in part} for part in (one, other)]
    assert indices[0] | indices[1] == {each.attempt.index for each in asked} and not indices[0] & indices[1]
    for part in (one, other):
        assert {each.attempt.fault for each in part if not each.way} == set(FAULT_NAMES)
        assert {each.way for each in part if each.way} == set(WAYS)
        assert {each.attempt.wrong for each in part if each.way} == {form for forms in WAYS.values() for form in forms}


def misled(residual_m: float) -> MonteCarloHandover:
    return runner().run(Attempt(0, 0, wrong=WrongAssociation("shift", 0.8, residual_m), limit_s=4.0, whole=True))


def test_a_prior_on_a_look_alike_is_told_by_no_threshold_of_the_grid() -> None:
    """Decision 0209 says so, and the ROC leaves it out."""
    found = outcomes(misled(0.0).series, MethodConfig())
    k = index_of(Setting("center", 0.5, 0.5, 1.0))
    assert found.commit[k, 0] == WRONG


def test_the_quick_form_is_complete(result: TrialResult) -> None:
    summary = result.summary
    assert summary["default"]["mapping"] == "center" and summary["default"]["tau_min"] == MethodConfig().tau_min
    assert set(summary["auc"]) == set(MAPPINGS)
    for mapping in MAPPINGS:
        low, high = summary["auc"][mapping]["interval"]
        assert 0.0 <= low <= summary["auc"][mapping]["value"] <= high <= 1.0
        points = summary["roc_pairs"][mapping]
        assert points[0]["true"] == points[0]["false"] == 1.0
    assert len(summary["roc_hand_overs"]) == len(grid())
    assert summary["auc"]["center"]["value"] > summary["auc"]["corner"]["value"]


def test_its_tables_are_whole(result: TrialResult) -> None:
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    assert {row[0] for row in result.tables[1].rows} == set(WAYS)
    center, corner = (float(result.tables[3].rows[-1][k]) for k in (2, 3))
    assert center > corner + 0.3  # rolled by 90 degrees
