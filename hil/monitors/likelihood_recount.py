"""What offsets say for the target by the gate "likelihood", recounted over whole runs from the
records alone.

The records have the nearest object beside the target, not each: against those D1 sees the gate is
held only to having D2's box nearer to the target than to the nearest of them, in the mean. Against
an object that nobody sees it is held to the pair (``path.gate.likelihood`` has the equations).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from path.arrays import Array
from path.config import EvidenceConfig
from path.gate.likelihood import CORRELATED_S, ODD, PRIOR_PAIRS, REACH_SIGMAS

Offsets = Sequence[tuple[int, Any, Any]]
"""Of each agreeing pair: its capture stamp, D2's box from the target, and from the nearest object
beside it.
"""


def recounted(
    offsets: Offsets,
    first_ns: int,
    odd: int,
    own: EvidenceConfig,
) -> float:
    """Return log10 of the most evidence that a run can have; never below 0.

    Args:
        first_ns: capture stamp of the run's first pair.
        odd: how many pairs were compared and did not agree.
    """
    if not offsets:
        return 0.0
    targets = np.array([target for _, target, _ in offsets], float)
    near = [(target, rival) for _, target, rival in offsets if rival is not None]
    if near:
        then, beside = (np.array(column, float) for column in zip(*near, strict=True))
        if _length2(then) >= _length2(beside):
            return 0.0
    span_s = (offsets[-1][0] - first_ns) * 1e-9
    many = _independent(targets, span_s)
    variance = own.offset_sigma_m**2 + _variance(targets) / many
    reach_m = REACH_SIGMAS * own.offset_sigma_m
    of_target = -own.offset_known * math.log1p(
        0.5 * _length2(targets) / variance / own.offset_known
    )
    reached = of_target - math.log(own.unseen) + math.log(0.5 * reach_m**2 / variance)
    share = odd / (len(targets) + odd)
    odds = many * (share * math.log(2.0 * ODD) + (1.0 - share) * math.log(2.0 * (1.0 - ODD)))
    return max(0.0, (reached + min(0.0, odds)) / math.log(10.0))


def _length2(offsets: Array) -> float:
    return float(np.sum(np.mean(offsets, axis=0) ** 2))


def _variance(offsets: Array) -> float:
    return 0.5 * max(0.0, float(np.mean(np.sum(offsets**2, axis=1))) - _length2(offsets))


def _independent(offsets: Array, span_s: float) -> float:
    """Return how many independent offsets a run is worth."""
    count = len(offsets)
    if count < 2 or not span_s > 0.0:
        return 1.0
    variance = _variance(offsets)
    correlation = 0.0
    if count > 2 and variance > 0.0:
        together = float(np.sum(offsets[1:] * offsets[:-1])) / (count - 1) - _length2(offsets)
        correlation = min(0.999, max(0.0, 0.5 * together / variance))
    step_s = span_s / (count - 1)
    prior = math.exp(-step_s / CORRELATED_S)
    mixed = (PRIOR_PAIRS * prior + count * correlation) / (PRIOR_PAIRS + count)
    return 1.0 + 0.5 * span_s * -math.log(max(1e-6, mixed)) / step_s
