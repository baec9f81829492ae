"""Intervals: what a figure from a limited number of samples says, and no more."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import betaincinv

from path.arrays import Array, Whole
from path.target.kernels import MAD_TO_SIGMA

Interval = tuple[float, float]
Statistic = Callable[[Array], Array]
"""A figure of each of several samples: of (k, n, ...) it makes (k,)."""

Z95 = 1.959963984540054
RESAMPLES = 2000
AT_ONCE = 1_000_000  # numbers that are resampled together


def wilson(successes: int, trials: int) -> Interval:
    """95 % interval of a proportion by Wilson's score, 0..1; (0, 1) without trials.

    Raises:
        ValueError: counts that cannot be.
    """
    _check(successes, trials)
    if trials == 0:
        return 0.0, 1.0
    p = successes / trials
    zz = Z95 * Z95 / trials
    middle = (p + 0.5 * zz) / (1.0 + zz)
    reach = math.sqrt(zz * (p * (1.0 - p) + 0.25 * zz)) / (1.0 + zz)
    low = 0.0 if successes == 0 else middle - reach
    high = 1.0 if successes == trials else middle + reach
    return max(0.0, low), min(1.0, high)


def upper_bound(
    events: int,
    trials: int,
    confidence: float = 0.95,
) -> float:
    """One-sided upper bound of a rate (Clopper and Pearson): events this rare are seen more often
    with ``confidence``.

    No event in n trials gives about 3 / n at 95 %.

    Raises:
        ValueError: counts that cannot be.
    """
    _check(events, trials)
    if events == trials:  # also without any trial
        return 1.0
    return float(betaincinv(events + 1, trials - events, confidence))


def bootstrap(
    values: Array,
    statistic: Statistic,
    rng: np.random.Generator,
    groups: Whole | None = None,
) -> Interval:
    """95 % percentile bootstrap of a statistic of ``values``, shape (n, ...).

    Args:
        groups: (n,) numbers of what was drawn together: samples that share an error are resampled
            together, otherwise the interval claims what repeating the same error cannot show.
    """
    member = np.arange(len(values)) if groups is None else np.unique(groups, return_inverse=True)[1]
    order = np.argsort(member, kind="stable")
    sizes = np.bincount(member)
    firsts = np.cumsum(sizes) - sizes
    draws = rng.integers(0, len(sizes), (RESAMPLES, len(sizes)))
    lengths = sizes[draws].sum(axis=1)
    figures: list[Array] = []
    # samples that are equally long are computed at once, but for what memory holds
    for length in np.unique(lengths):
        alike = draws[lengths == length]
        for some in np.array_split(
            alike, math.ceil(len(alike) * length * values[0].size / AT_ONCE)
        ):
            parts = sizes[some.ravel()]
            within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
            picks = order[np.repeat(firsts[some.ravel()], parts) + within]
            figures.append(statistic(values[picks].reshape(len(some), length, *values.shape[1:])))
    low, high = np.percentile(np.concatenate(figures), (2.5, 97.5))
    return float(low), float(high)


def means(samples: Array) -> Array:
    return np.asarray(np.mean(_flat(samples), axis=1), np.float64)


def medians(samples: Array) -> Array:
    return np.asarray(np.median(_flat(samples), axis=1), np.float64)


def percentiles(samples: Array, percent: float) -> Array:
    return np.asarray(np.percentile(_flat(samples), percent, axis=1), np.float64)


def p95s(samples: Array) -> Array:
    return percentiles(samples, 95.0)


def robust_sigmas(samples: Array) -> Array:
    """Standard deviations by the median size of errors around zero."""
    return MAD_TO_SIGMA * medians(np.abs(samples))


def figure_of(statistic: Statistic, values: Array) -> float:
    """The statistic of one sample (n, ...)."""
    return float(statistic(values[None])[0])


def _flat(samples: Array) -> Array:
    return samples.reshape(len(samples), -1)


def median(values: Array) -> float:
    return float(np.median(values))


def rms(values: Array | Sequence[float]) -> float:
    """Return nan without any."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan


def robust_sigma(errors: Array) -> float:
    """Standard deviation by the median size of errors around zero."""
    return MAD_TO_SIGMA * float(np.median(np.abs(errors)))


def _check(events: int, trials: int) -> None:
    if not 0 <= events <= trials:
        raise ValueError(f"{events} of {trials} cannot be")


def blocks_interval(
    values: Array,
    groups: Whole,
    rng: np.random.Generator,
) -> Interval:
    """95 % interval of the mean of values (n,), whole groups (n,) drawn together; (nan, nan)
    without any.
    """
    if not len(values):
        return math.nan, math.nan
    _, member = np.unique(groups, return_inverse=True)
    sums = np.bincount(member, values)
    counts = np.bincount(member)
    draws = rng.integers(0, len(sums), (RESAMPLES, len(sums)))
    low, high = np.percentile(sums[draws].sum(axis=1) / counts[draws].sum(axis=1), (2.5, 97.5))
    return float(low), float(high)


def whitened(error: Array, covariance: Array) -> float:
    """Squared error (any shape) over its stated covariance (n, n), by the number of its components:
    1 when honest.
    """
    e = error.ravel()
    return float(e @ np.linalg.solve(covariance, e)) / len(e)
