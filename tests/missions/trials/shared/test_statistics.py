"""Intervals against values from tables, and against what they promise."""

import math

import numpy as np
import pytest

from missions.trials.shared import statistics
from missions.trials.shared.statistics import bootstrap, means, medians, upper_bound, wilson


def test_wilson_matches_published_values() -> None:
    # Newcombe 1998, table I
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert wilson(29, 29) == pytest.approx((0.8830, 1.0), abs=1e-4)


def test_nothing_tried_says_nothing() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert upper_bound(0, 0) == 1.0


def test_upper_bound_of_no_event_is_the_rule_of_three() -> None:
    assert upper_bound(0, 10_000) == pytest.approx(1.0 - 0.05 ** (1 / 10_000), rel=1e-6)
    assert upper_bound(0, 10_000) == pytest.approx(3.0 / 10_000, rel=2e-3)
    assert upper_bound(2, 100) == pytest.approx(0.0616, abs=1e-4)  # Clopper-Pearson, one-sided


@pytest.mark.parametrize(("events", "trials"), [(-1, 5), (6, 5)])
def test_impossible_counts_are_refused(events: int, trials: int) -> None:
    with pytest.raises(ValueError, match="cannot be"):
        wilson(events, trials)
    with pytest.raises(ValueError, match="cannot be"):
        upper_bound(events, trials)


def test_bootstrap_covers_the_mean_as_often_as_it_says() -> None:
    covered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        low, high = bootstrap(rng.normal(1.0, 0.5, 60), means, rng)
        covered += low <= 1.0 <= high
    assert 51 <= covered <= 60


def test_samples_that_share_an_error_are_not_counted_as_independent() -> None:
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(8), 50)
    values = rng.normal(0.0, 1.0, 8)[groups] + rng.normal(0.0, 0.01, 400)
    alone = bootstrap(values, means, rng)
    together = bootstrap(values, means, rng, groups)
    assert together[1] - together[0] > 4.0 * (alone[1] - alone[0])
    assert together[1] - together[0] == pytest.approx(2.0 * 1.96 / math.sqrt(8), rel=0.5)


@pytest.mark.parametrize("at_once", [1_000_000, 700])
def test_samples_that_are_computed_at_once_are_those_that_are_drawn_one_by_one(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of groups that are not equally large, and in as many parts as memory asks for."""
    monkeypatch.setattr(statistics, "AT_ONCE", at_once)
    values = np.random.default_rng(2).normal(size=(40, 3))
    for groups in (None, np.random.default_rng(3).integers(0, 6, 40)):
        members = [np.array([k]) for k in range(40)] if groups is None else [
            np.flatnonzero(groups == group) for group in range(6)
        ]  # fmt: skip
        rng = np.random.default_rng(4)
        drawn = [
            float(
                np.median(
                    values[
                        np.concatenate(
                            [members[i] for i in rng.integers(0, len(members), len(members))]
                        )
                    ]
                )
            )
            for _ in range(statistics.RESAMPLES)
        ]
        low, high = np.percentile(drawn, (2.5, 97.5))
        assert bootstrap(values, medians, np.random.default_rng(4), groups) == (low, high)
