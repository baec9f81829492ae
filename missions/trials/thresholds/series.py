"""Monte-Carlo hand-overs for the thresholds: true ones, and ones where D2 is made to answer with another object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np

from flight.harness.montecarlo import PAIR, Attempt, FaultName, WrongAssociation
from missions import rig_library
from missions.trials.handshake.handovers import runner_of
from missions.trials.thresholds.grid import Outcomes, outcomes

FAULT_NAMES: tuple[FaultName, ...] = get_args(FaultName)
REACHES = (0.6, 0.8, 1.0, 1.25, 1.5)
ROLLS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 90.0)
TRUE_LIMIT_S, WRONG_LIMIT_S, ROLL_LIMIT_S = 12.0, 9.0, 0.6
WRONG_FIRST, ROLL_FIRST = 1_000_000, 2_000_000  # indices, so that no attempt is drawn like another
BESIDE_M, ON_M = 0.12, 0.03  # of a prior from a look-alike, per axis: somewhere in D2's search region; on it
ABSENT = "the target is absent for D2, a look-alike is where nobody looks"
NEAR = "D2 sees a look-alike instead of the target, the prior is right"
BESIDE = "D2's pose is off: its prior falls beside a look-alike"
ON = "D2's pose is off: its prior falls on a look-alike"
WAYS: Mapping[str, tuple[WrongAssociation, ...]] = {
    ABSENT: tuple(WrongAssociation("lock", d) for d in (0.5, 0.7, 1.0)),
    NEAR: tuple(WrongAssociation("lock", d, crossing=past) for d in (0.2, 0.25, 0.3, 0.4) for past in (False, True)),
    BESIDE: tuple(WrongAssociation(kind, d, BESIDE_M) for d in (0.4, 0.5, 0.7, 1.0, 1.5) for kind in ("shift", "turn")),
    ON: tuple(WrongAssociation(kind, d, ON_M) for d in (0.4, 0.5, 0.7, 1.0, 1.5) for kind in ("shift", "turn")),
}
"""Values that are forced, by name."""


@dataclass(frozen=True, slots=True)
class RigAttempt:
    """One attempt with a rig (its file). ``way``: of ``WAYS``, empty for a true one."""

    rig: str
    way: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class GridAttempt:
    """One attempt under every setting of the grid."""

    way: str
    attempt: Attempt
    outcomes: Outcomes


@dataclass(frozen=True, slots=True)
class Rolled:
    """Overlaps of one attempt with a rolled camera: medians of both mappings; None without a pair."""

    roll_deg: float
    iou: tuple[float, float] | None


def true_attempts(rig: str, seed: int, count: int) -> list[RigAttempt]:
    """Returns attempts with every kind of fault, from every distance."""
    names, reaches = FAULT_NAMES, REACHES
    return [
        RigAttempt(
            rig,
            "",
            Attempt(seed, k, names[k % len(names)], reach=reaches[k % len(reaches)], limit_s=TRUE_LIMIT_S, whole=True),
        )
        for k in range(count)
    ]


def wrong_attempts(rig: str, seed: int, each: int) -> list[RigAttempt]:
    """``each`` for every way: its distances and D1's reach one after the other."""
    asked: list[RigAttempt] = []
    for way, forms in WAYS.items():
        for k in range(each):
            reach = REACHES[(k // len(forms)) % len(REACHES)]
            attempt = Attempt(
                seed, WRONG_FIRST + len(asked), wrong=forms[k % len(forms)], reach=reach, limit_s=WRONG_LIMIT_S,
                whole=True,
            )  # fmt: skip
            asked.append(RigAttempt(rig, way, attempt))
    return asked


def rolled_attempts(rig: str, seed: int, each: int) -> list[RigAttempt]:
    return [
        RigAttempt(rig, "", Attempt(seed, ROLL_FIRST + k, roll_deg=roll, limit_s=ROLL_LIMIT_S, whole=True))
        for roll in ROLLS_DEG
        for k in range(each)
    ]  # fmt: skip


def sweep(asked: RigAttempt) -> GridAttempt:
    """Run once, try every setting."""
    found = runner_of(asked.rig).run(asked.attempt)
    return GridAttempt(asked.way, asked.attempt, outcomes(found.series, rig_library.load(asked.rig).method))


def roll(asked: RigAttempt) -> Rolled:
    found = runner_of(asked.rig).run(asked.attempt)
    compared = found.series.iou[found.series.kind == PAIR]
    medians = np.median(compared, axis=0).tolist() if len(compared) else None
    return Rolled(asked.attempt.roll_deg, None if medians is None else (medians[0], medians[1]))
