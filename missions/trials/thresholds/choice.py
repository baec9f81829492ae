"""ROC of pairs, shares of hand-overs by setting, and the rule by which a setting is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missions.trials.shared.statistics import RESAMPLES, Interval
from missions.trials.thresholds.grid import BINS, FRAMES, MAPPINGS, RIGHT, WRONG, Setting, grid
from missions.trials.thresholds.series import BESIDE, NEAR, GridAttempt
from path.config import BoxMapping

Array = NDArray[np.float64]

MAY_COST = 0.01  # share of the true attempts that a choice may lose against the best setting
PAPER_N = FRAMES.index(350)
SHORTEST = 0


@dataclass(frozen=True, slots=True)
class Shares:
    """The shares of attempts, by setting and window length, (settings, FRAMES).

    Attributes:
        right: hand-overs of the target in time, of the true attempts.
        wrong: hand-overs of something else, of the forced ones.
        slipped: hand-overs of something else in the true attempts: what D1 had lost to another object by itself, too.
    """

    right: Array
    wrong: Array
    slipped: Array

    @classmethod
    def of(cls, tried: Sequence[GridAttempt]) -> Shares:
        true, forced = commits(tried, forced=False), commits(tried, forced=True)
        return cls(_mean(true == RIGHT), _mean(forced == WRONG), _mean(true == WRONG))


def commits(tried: Sequence[GridAttempt], *, forced: bool) -> NDArray[np.int8]:
    """(attempts, settings, FRAMES) of the forced or of the true ones."""
    some = [each.outcomes.commit for each in tried if bool(each.way) == forced]
    return np.stack(some) if some else np.zeros((0, len(grid()), len(FRAMES)), np.int8)


def _mean(flags: NDArray[np.bool_]) -> Array:
    return flags.mean(axis=0) if len(flags) else np.zeros(flags.shape[1:])


def choose(shares: Shares) -> int:
    """The strictest setting that costs (nearly) no true hand-over, with the paper's window; an index into the grid.

    Among all settings that lose at most ``MAY_COST`` of the true attempts against the best one: the fewest wrong
    hand-overs; then the fewest with the shortest window, which shows differences that the long one hides; then the
    most true ones.
    """
    right = shares.right[:, PAPER_N]
    eligible = right >= right.max() - MAY_COST
    order = np.lexsort((-right, shares.wrong[:, SHORTEST], shares.wrong[:, PAPER_N], ~eligible))
    return int(order[0])


def halves(tried: Sequence[GridAttempt]) -> tuple[list[GridAttempt], list[GridAttempt]]:
    """Returns attempts to choose on, and to report on: neighbours by turns, so that both have all of every kind."""
    parts: tuple[list[GridAttempt], list[GridAttempt]] = ([], [])
    turn: dict[tuple[str, object], int] = {}
    for each in tried:
        kind = (each.way, each.attempt.wrong or each.attempt.fault)
        turn[kind] = turn.get(kind, 0) + 1
        parts[turn[kind] % 2].append(each)
    return parts


def difference(tried: Sequence[GridAttempt], a: int, b: int, *, forced: bool, rng: np.random.Generator) -> Interval:
    """95 % interval of the difference between two settings, b minus a, in right (or wrong) hand-overs."""
    found = commits(tried, forced=forced)[:, :, PAPER_N] == (WRONG if forced else RIGHT)
    if not len(found):
        return -1.0, 1.0
    off = found[:, b].astype(float) - found[:, a]
    means = off[rng.integers(0, len(off), (RESAMPLES, len(off)))].mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


# --- pairs --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RocCurve:
    """ROC of pairs for one mapping with a fixed threshold.

    Attributes:
        tau: (BINS,) thresholds.
        true, false: (BINS,) share of pairs with at least that overlap: of the target, of something else.
        auc: chance that a pair of the target overlaps more than one of something else.
        interval: of ``auc``, attempts resampled.
        pairs: of the target, of something else.
    """

    mapping: BoxMapping
    tau: Array
    true: Array
    false: Array
    auc: float
    interval: Interval
    pairs: tuple[int, int]


def curve(tried: Sequence[GridAttempt], mapping: BoxMapping, rng: np.random.Generator) -> RocCurve | None:
    """Returns the curve of the target's pairs in true attempts against pairs of something else; None without either.

    The other pairs are of attempts whose prior is not on that other thing.
    """
    k = MAPPINGS.index(mapping)
    right = np.array([each.outcomes.pairs[1, k] for each in tried if not each.way], float)
    wrong = np.array([each.outcomes.pairs[0, k] for each in tried if each.way in (NEAR, BESIDE)], float)
    if not right.sum() or not wrong.sum():
        return None
    resampled = [
        _auc(_weighted(right, rng), _weighted(wrong, rng))
        for _ in range(RESAMPLES)
    ]  # fmt: skip
    low, high = np.nanpercentile(resampled, (2.5, 97.5))
    true, false = right.sum(axis=0), wrong.sum(axis=0)
    above = [counts[::-1].cumsum()[::-1] / counts.sum() for counts in (true, false)]
    return RocCurve(
        mapping, np.arange(BINS) / BINS, above[0], above[1], _auc(true, false), (float(low), float(high)),
        (int(true.sum()), int(false.sum())),
    )  # fmt: skip


def _weighted(rows: Array, rng: np.random.Generator) -> Array:
    """Sum of as many rows, drawn with replacement."""
    return rng.multinomial(len(rows), np.full(len(rows), 1.0 / len(rows))) @ rows


def _auc(right: Array, wrong: Array) -> float:
    """Returns the area under the curve from histograms of the overlap; equal bins count half."""
    total = right.sum() * wrong.sum()
    below = np.concatenate(([0.0], wrong.cumsum()[:-1]))
    return float((right * (below + 0.5 * wrong)).sum() / total) if total else float("nan")


def index_of(setting: Setting) -> int:
    return grid().index(setting)
