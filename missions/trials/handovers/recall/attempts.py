"""Monte-Carlo hand-overs run once each, seen through detectors that miss and invent, and judged by
both gates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from flight.harness.montecarlo import (
    Attempt,
    HandoverRunner,
    Series,
    Telling,
    WrongAssociation,
    agreeing,
)
from missions.trials.handovers.judging import GATES, JudgedAttempt, Verdict, verdict_of
from missions.trials.handovers.recall.detectors import (
    DetectorFaults,
    FaultyFrames,
    faulty_frames,
    with_detector,
)
from missions.trials.handovers.recall.identity import NOTHING_STATED, StatedCounts, counted
from path.config import GateKind, MethodConfig
from path.gate.evidence import evidence_needed, evidence_of, make_gate
from path.gate.window import Gate
from path.values import frozen

Group = Literal["true", "look-alike", "wrong object"]

ALL_GATES: tuple[GateKind, ...] = (*GATES, "likelihood")

LIMIT_S = 10.0
FRAME_S = 0.02  # from one frame to the next, of both cameras
FRAMES = 520  # more than any camera takes in that time
FAR_M = 0.15
FAR_S = 1.0
LATE_S = 0.5  # by less than that, what was captured is judged later
# from the target to the object that D2 sees instead of it, all the time
LOCKED_M = (0.3, 0.4, 0.6, 1.0)
FAULT_STREAM = 0x64657465


@frozen
class AttemptOrder:
    """One attempt: a hand-over of its own, through one pair of detectors. ``cell``: number of that
    pair.
    """

    cell: int
    detector: DetectorFaults
    group: Group
    attempt: Attempt


@frozen
class RecallAttempt(JudgedAttempt):
    """One attempt by all gates. ``identity``: what D1 stated of the object that it followed."""

    likelihood: Verdict
    identity: StatedCounts = NOTHING_STATED

    def by(self, gate: GateKind) -> Verdict | None:
        """Return the verdict of a gate."""
        return self.likelihood if gate == "likelihood" else JudgedAttempt.by(self, gate)


def orders(
    seed: int,
    detectors: Sequence[DetectorFaults],
    of_each: int,
) -> list[AttemptOrder]:
    """Return the attempts, each with a hand-over of its own.

    Half have nothing but the errors that last, a quarter a look-alike beside the target or driving
    past it, a quarter a D2 that sees only another object.
    """
    made: list[AttemptOrder] = []
    for index in range(len(detectors) * of_each):
        turn, cell = divmod(index, len(detectors))
        group: Group = ("true", "wrong object", "look-alike", "true")[turn % 4]
        attempt = Attempt(seed, index, limit_s=LIMIT_S, whole=True)
        if group == "look-alike":
            attempt = replace(
                attempt, fault=("look_alike_near", "look_alike_crossing")[turn // 4 % 2]
            )
        elif group == "wrong object":
            distance_m = LOCKED_M[turn // 4 % len(LOCKED_M)]
            attempt = replace(attempt, wrong=WrongAssociation("lock", distance_m))
        made.append(AttemptOrder(cell, detectors[cell], group, attempt))
    return made


def faults_of(order: AttemptOrder) -> FaultyFrames:
    """Return the frames in which the detectors of an attempt err."""
    rng = np.random.default_rng([order.attempt.seed, order.attempt.index, FAULT_STREAM])
    return faulty_frames(order.detector, FRAMES, rng)


def judge(
    runner: HandoverRunner,
    method: MethodConfig,
    order: AttemptOrder,
) -> RecallAttempt:
    """Run one attempt for as long as any gate can still commit."""
    faults = faults_of(order)
    methods = [replace(method, gate=gate) for gate in ALL_GATES]
    telling = [Telling(make_gate(own), own) for own in methods]

    def decided(series: Series) -> bool:
        """Return whether each gate has committed, or cannot any more."""
        seen = with_detector(series, faults, method)
        far = order.group == "wrong object" and stays_far(series)
        for told, own in zip(telling, methods, strict=True):
            if told.on(seen) is not None:
                continue
            if not can_complete(told.gate, own, seen, faults):
                continue
            given_up = far and (own.gate != "count" or not agreeing(series, own).any())
            if not given_up:
                return False
        return True

    ran = runner.run(order.attempt, decided)
    seen = with_detector(ran.series, faults, method)
    count, evidence, likelihood = (verdict_of(seen, method, gate) for gate in ALL_GATES)
    return RecallAttempt(order.attempt.index, count, evidence, likelihood, counted(ran.identity))


def can_complete(
    gate: Gate,
    method: MethodConfig,
    series: Series,
    faults: FaultyFrames,
) -> bool:
    """Return whether a gate that was told a series may be complete before the attempt's limit.

    The run under way may go on, or another begin with what is captured next. "count" needs a
    stretch of frames for it in which both detectors see the target and nothing else.
    """
    span_s = gate.span_s
    first_ns = int(series.capture_ns[0])
    left_s = LIMIT_S - (int(series.now_ns[-1]) - first_ns) * 1e-9
    if left_s + LATE_S < shortest_s(method) - span_s:
        return False
    if method.gate != "count":
        return True
    begins_s = (int(series.capture_ns[-1]) - first_ns) * 1e-9 - span_s - LATE_S
    return faults.longest_clear(int(begins_s / FRAME_S)) >= method.hold_frames


def stays_far(series: Series) -> bool:
    """Return whether D2, which sees only another object, has seen it nowhere near the target for
    long enough.

    The offset of its box wavers by 0.01 m (docs/gates.md); "evidence" and "likelihood" let no mean
    above 0.074 m pass.
    """
    if (int(series.now_ns[-1]) - int(series.capture_ns[0])) * 1e-9 < FAR_S:
        return False
    return all(math.hypot(*offsets.target_m) > FAR_M for offsets in series.offsets.values())


def shortest_s(method: MethodConfig) -> float:
    """Return from the first to the last frame of the shortest run with which the gate can be
    complete.
    """
    if method.gate == "count":
        return method.hold_s
    if method.gate == "likelihood":
        return method.evidence.min_s
    blocks = 1
    needed = evidence_needed(1, method.evidence)
    while evidence_of(blocks, method.evidence) < needed:
        blocks += 1
    return max(method.evidence.min_s, blocks * method.evidence.block_s)
