"""Attempts run, told to both gates, and what the blocks of the gate "evidence" did in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.rig.parts import Rig
from flight.harness.montecarlo import PAIR, Attempt, HandoverRunner, Series, agreeing, tell
from path.config import MethodConfig
from path.gate.evidence import EvidenceGate, make_gate
from path.gate.window import AgreementWindow

NEVER = 1e-300
LAGS = (1, 5, 10, 25, 50, 75)  # pairs of a 50 Hz stream
ENOUGH_PAIRS = 100


@dataclass(frozen=True, slots=True)
class Batch:
    """Attempts for one process. ``runner``: the class that runs them."""

    runner: type[HandoverRunner]
    rig: Rig
    method: MethodConfig
    attempts: Sequence[Attempt]


@dataclass(frozen=True, slots=True)
class GateTime:
    """The decision of a gate: when it was complete, after the first agreeing pair, and whether with the right box."""

    after_s: float | None
    right: bool


@dataclass(frozen=True, slots=True)
class Blocks:
    """Blocks judged and agreeing: the first of their run, and those after agreeing ones."""

    first: tuple[int, int]
    later: tuple[int, int]


@dataclass(frozen=True, slots=True)
class EvidenceAttempt:
    """One attempt.

    Attributes:
        strength: mean over all pairs, agreeing or not; NaN with too few of them.
        blocks: for each test that the gate makes (``EvidenceConfig.paces``).
        correlation: (len(LAGS),) of the overlap in its series; NaN with too few pairs.
    """

    attempt: Attempt
    evidence: GateTime
    papers: GateTime
    strength: float
    blocks: tuple[Blocks, ...]
    correlation: NDArray[np.float64]


def run_batch(batch: Batch) -> list[EvidenceAttempt]:
    """Run the attempts and tell both gates, whatever either says."""
    runner = batch.runner(batch.rig, batch.method).warmed()
    return [_told(runner, batch.method, attempt) for attempt in batch.attempts]


def _told(runner: HandoverRunner, method: MethodConfig, attempt: Attempt) -> EvidenceAttempt:
    series = runner.run(replace(attempt, whole=True)).series
    agrees = agreeing(series, method)
    begin_ns = int(series.capture_ns[np.argmax(agrees)]) if agrees.any() else 0
    return EvidenceAttempt(
        attempt=attempt,
        evidence=_decided(series, tell(series, make_gate(method), method), begin_ns),
        papers=_decided(series, tell(series, AgreementWindow(method), method), begin_ns),
        strength=mean_strength(series, method),
        blocks=tuple(_blocks(series, replace(method, evidence=own)) for own in method.evidence.paces),
        correlation=correlation(series.iou[series.kind == PAIR, 0]),
    )


def _blocks(series: Series, method: MethodConfig) -> Blocks:
    """Blocks of a test that goes on whatever it says."""
    never = EvidenceGate(replace(method, evidence=replace(method.evidence, alpha=NEVER)))
    tell(series, never, method)
    first, later = never.judged.first, never.judged.later
    return Blocks((first[0], first[1]), (later[0], later[1]))


def _decided(series: Series, done: int | None, begin_ns: int) -> GateTime:
    if done is None:
        return GateTime(None, True)
    return GateTime((int(series.now_ns[done]) - begin_ns) * 1e-9, bool(series.right[done]))


def mean_strength(series: Series, method: MethodConfig) -> float:
    """Returns the mean strength of all pairs whose boxes were compared, as the gate takes it."""
    pairs = series.kind == PAIR
    if np.sum(pairs) < ENOUGH_PAIRS:
        return float("nan")
    scale = np.minimum(1.0, (method.z0_m / series.z_m[pairs]) ** 2)
    tau = method.tau_min + (method.tau_max - method.tau_min) * scale
    entries = zip(np.flatnonzero(pairs).tolist(), series.iou[pairs, 0].tolist(), strict=True)
    overlaps = np.array([series.placed_iou.get(entry, overlap) for entry, overlap in entries])
    return float(np.mean((overlaps - tau) / (1.0 - tau)))


def correlation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Autocorrelation at ``LAGS``; NaN for a series that is too short or constant."""
    off = values - np.mean(values) if len(values) else values
    variance = float(np.mean(off * off)) if len(values) >= 3 * LAGS[-1] else 0.0
    if variance <= 0.0:
        return np.full(len(LAGS), np.nan)
    return np.array([float(np.mean(off[:-lag] * off[lag:])) / variance for lag in LAGS])
