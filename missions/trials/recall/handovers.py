"""Monte-Carlo hand-overs run once each, seen through detectors that miss and invent, and judged by both gates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.rig.parts import Rig
from flight.harness.montecarlo import Attempt, HandoverRunner, Series, Telling, WrongAssociation, tell
from missions.trials.recall.detectors import DetectorFaults, faulty_frames, with_detector
from path.config import GateKind, MethodConfig
from path.evidence import evidence_needed, evidence_of, make_gate

Group = Literal["true", "look-alike", "wrong object"]

GATES: tuple[GateKind, ...] = ("count", "evidence")
LIMIT_S = 10.0
FRAMES = 520  # more than any camera takes in that time
FAR_M, FAR_S = 0.15, 1.0
LATE_S = 0.5  # by that much, what was captured is judged later
LOCKED_M = (0.3, 0.4, 0.6, 1.0)  # from the target to the object that D2 sees instead of it, all the time


@dataclass(frozen=True, slots=True)
class AttemptOrder:
    """One attempt: a hand-over of its own, through one pair of detectors. ``cell``: number of that pair."""

    cell: int
    group: Group
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Pieces:
    """Attempts for one process. ``runner``: the class that runs them."""

    runner: type[HandoverRunner]
    rig: Rig
    detectors: Sequence[DetectorFaults]
    orders: Sequence[AttemptOrder]


@dataclass(frozen=True, slots=True)
class GateCommit:
    """The commit of a gate: its time since the attempt began, and whether the objects were right.

    Attributes:
        right: whether D2's box was of the designated object. ``same``: of the same one as D1's.
    """

    after_s: float
    right: bool
    same: bool


@dataclass(frozen=True, slots=True)
class AttemptCommits:
    """The result of one attempt by each gate, in the order of ``GATES``; None without a commit."""

    order: AttemptOrder
    commits: tuple[GateCommit | None, ...]


def orders(seed: int, detectors: int, of_each: int) -> list[AttemptOrder]:
    """Returns the attempts, each with a hand-over of its own.

    Half have nothing but the errors that last, a quarter a look-alike beside the target or driving past it, a quarter a
    D2 that sees only another object.
    """
    made: list[AttemptOrder] = []
    for index in range(detectors * of_each):
        cell, turn = index % detectors, index // detectors
        group: Group = ("true", "wrong object", "look-alike", "true")[turn % 4]
        attempt = Attempt(seed, index, limit_s=LIMIT_S, whole=True)
        if group == "look-alike":
            attempt = replace(attempt, fault=("look_alike_near", "look_alike_crossing")[turn // 4 % 2])
        elif group == "wrong object":
            attempt = replace(attempt, wrong=WrongAssociation("lock", LOCKED_M[turn // 4 % len(LOCKED_M)]))
        made.append(AttemptOrder(cell, group, attempt))
    return made


def run_pieces(pieces: Pieces) -> list[AttemptCommits]:
    runner = pieces.runner(pieces.rig).warmed()
    method = pieces.rig.method
    return [_judged(runner, order, pieces.detectors[order.cell], method) for order in pieces.orders]


def _judged(
    runner: HandoverRunner, order: AttemptOrder, detector: DetectorFaults, method: MethodConfig
) -> AttemptCommits:
    """One attempt, run for as long as either gate can still commit."""
    rng = np.random.default_rng([order.attempt.seed, order.attempt.index, 0x64657465])
    faults = faulty_frames(detector, FRAMES, rng)
    methods = [replace(method, gate=gate) for gate in GATES]
    telling = [Telling(make_gate(own), own) for own in methods]
    countable = faults.longest_clear >= method.hold_frames

    def decided(series: Series) -> bool:
        """Returns whether each gate has committed, or cannot any more."""
        seen = with_detector(series, faults, method)
        far = order.group == "wrong object" and stays_far(series)
        left_s = LIMIT_S - int(series.now_ns[-1] - series.capture_ns[0]) * 1e-9
        return all(
            told.on(seen) is not None
            or (own.gate == "count" and not countable)
            or (own.gate == "evidence" and far)
            or (not told.gate.count and left_s + LATE_S < shortest_s(own))
            for told, own in zip(telling, methods, strict=True)
        )

    seen = with_detector(runner.run(order.attempt, decided).series, faults, method)
    return AttemptCommits(order, tuple(_commit(seen, own) for own in methods))


def stays_far(series: Series) -> bool:
    """Returns whether D2, which sees only another object, has seen it nowhere near the target for long enough.

    The offset of its box wavers by 0.01 m (docs/gates.md); the gate "evidence" lets no mean above 0.074 m pass.
    """
    if (int(series.now_ns[-1]) - int(series.capture_ns[0])) * 1e-9 < FAR_S:
        return False
    return all(math.hypot(*offsets.target_m) > FAR_M for offsets in series.offsets.values())


def shortest_s(method: MethodConfig) -> float:
    """Returns from the first to the last frame of the shortest run with which the gate can be complete."""
    if method.gate == "count":
        return method.hold_s
    blocks, needed = 1, evidence_needed(1, method.evidence)
    while evidence_of(blocks, method.evidence) < needed:
        blocks += 1
    return max(method.evidence.min_s, blocks * method.evidence.block_s)


def _commit(series: Series, method: MethodConfig) -> GateCommit | None:
    done = tell(series, make_gate(method), method) if len(series) else None
    if done is None:
        return None
    after_s = (int(series.now_ns[done]) - int(series.capture_ns[0])) * 1e-9
    return GateCommit(after_s, bool(series.right[done]), bool(series.same[done]))
