"""Attempts told to both gates, and what the blocks of the gate "evidence" did in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flight.harness.montecarlo import PAIR, Attempt, HandoverRunner, Series, tell
from missions.trials.handovers.judging import JudgedAttempt, verdict_of
from path.arrays import Array
from path.config import MethodConfig
from path.gate.evidence import EvidenceGate
from path.values import frozen

NEVER = 1e-300
LAGS = (1, 5, 10, 25, 50, 75)  # pairs of a 50 Hz stream
ENOUGH_PAIRS = 100


@frozen
class Blocks:
    """Blocks judged and agreeing: the first of their run, and those after agreeing ones."""

    first: tuple[int, int]
    later: tuple[int, int]


@frozen
class EvidenceAttempt(JudgedAttempt):
    """One attempt, told to both gates whatever either says.

    Attributes:
        limit_s: of the attempt.
        strength: mean over all pairs, agreeing or not; NaN with too few of them.
        blocks: for each test that the gate makes (``EvidenceConfig.paces``).
        correlation: (len(LAGS),) of the overlap in its series; NaN with too few pairs.
    """

    limit_s: float
    strength: float
    blocks: tuple[Blocks, ...]
    correlation: Array


def judge(
    runner: HandoverRunner,
    method: MethodConfig,
    attempt: Attempt,
) -> EvidenceAttempt:
    """Run one attempt to its end."""
    series = runner.run(replace(attempt, whole=True)).series
    return EvidenceAttempt(
        index=attempt.index,
        count=verdict_of(series, method, "count"),
        evidence=verdict_of(series, method, "evidence"),
        limit_s=attempt.limit_s,
        strength=mean_strength(series, method),
        blocks=tuple(
            _blocks(series, replace(method, evidence=own)) for own in method.evidence.paces
        ),
        correlation=correlation(series.iou[series.kind == PAIR, 0]),
    )


def _blocks(series: Series, method: MethodConfig) -> Blocks:
    """Return the blocks of a test that goes on whatever it says."""
    never = EvidenceGate(replace(method, evidence=replace(method.evidence, alpha=NEVER)))
    tell(series, never, method)
    first = never.judged.first
    later = never.judged.later
    return Blocks((first[0], first[1]), (later[0], later[1]))


def mean_strength(series: Series, method: MethodConfig) -> float:
    """Return the mean strength of all pairs whose boxes were compared, as the gate takes it."""
    pairs = series.kind == PAIR
    if np.sum(pairs) < ENOUGH_PAIRS:
        return float("nan")
    scale = np.minimum(1.0, (method.z0_m / series.z_m[pairs]) ** 2)
    tau = method.tau_min + (method.tau_max - method.tau_min) * scale
    entries = zip(np.flatnonzero(pairs).tolist(), series.iou[pairs, 0].tolist(), strict=True)
    overlaps = np.array([series.placed_iou.get(entry, overlap) for entry, overlap in entries])
    return float(np.mean((overlaps - tau) / (1.0 - tau)))


def correlation(values: Array) -> Array:
    """Autocorrelation at ``LAGS``; NaN for a series that is too short or constant."""
    off = values - np.mean(values) if len(values) else values
    variance = float(np.mean(off * off)) if len(values) >= 3 * LAGS[-1] else 0.0
    if variance <= 0.0:
        return np.full(len(LAGS), np.nan)
    return np.array([float(np.mean(off[:-lag] * off[lag:])) / variance for lag in LAGS])
