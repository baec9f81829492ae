"""The gate "evidence": a sequential test on the overlap S_k, with a stated bound on being fooled.

What can make boxes of different objects agree, and what is done about it:

1. *Persistent errors* (calibration, mounting, attitude, clocks, where a box's centre lies on the body) are drawn once.
   If they move D2's prior onto a look-alike, every later frame agrees: no number of frames tells, in this gate or in
   the paper's. They must be large for it: a mapped box agrees with D1's only when it is less than some ``r0`` off, so
   an object ``d`` away needs an error above ``d - r0``. For errors with standard deviation ``sigma`` per axis, and any
   number of objects at ``d`` or farther, however they move,

       P(persistent) <= exp(-((d - r0) / sigma)^2 / 2),                                       (``persistent_bound``)

   paid once per attempt. A high overlap makes ``r0`` small: that is why ``strength`` is asked for, and not IoU >= tau
   alone; and ``max_pose_sigma_m`` keeps ``sigma`` what it is said to be.

2. *What varies* around an offset of at least ``r0`` (aspect, attitude wander, noise) is strongly correlated: overlaps
   0.5 s apart still are. Nothing is derived for independent frames. A run of pairs is cut into blocks; a block agrees
   when every pair does and its mean strength ``(S - tau) / (1 - tau)`` suffices. By the chain rule, which holds under
   any dependence,

       P(n blocks agree) = P(first) P(second | first) ... <= first_rate * next_rate^(n - 1)

   with two rates that are *measured*, each given that all blocks before it agreed. Any miss, any gap and any weak block
   ends a run and all its evidence. The j-th run of an attempt may spend ``alpha / (j (j + 1))``, which sums to
   ``alpha`` however often it is tried: ``first_rate * next_rate^(n - 1) <= alpha / (j (j + 1))`` completes it.

Rates, ``r0`` and ``sigma`` come from simulation with persistent errors and look-alikes, see the decision record.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

from path.config import EvidenceConfig, MethodConfig
from path.observations import MissReason
from path.window import AgreementWindow, Evidence, FramePair, Gate


def make_gate(config: MethodConfig) -> Gate:
    """The gate that the settings name, for one attempt."""
    return EvidenceGate(config) if config.gate == "evidence" else AgreementWindow(config)


def strength(iou: float, tau: float) -> float:
    """By how much a pair agrees: 0 at the threshold, 1 for equal boxes; below 0 it does not agree."""
    return (iou - tau) / (1.0 - tau) if tau < 1.0 else iou - tau


def evidence_of(blocks: int, config: EvidenceConfig) -> float:
    """-log10 of the bound on so many blocks of a run agreeing although the boxes show different things."""
    if blocks <= 0:
        return 0.0
    return -math.log10(config.first_rate) - (blocks - 1) * math.log10(config.next_rate)


def evidence_needed(run: int, config: EvidenceConfig) -> float:
    """What the ``run``-th run of an attempt (1, 2, ...) must reach: each later one may spend less of ``alpha``."""
    return -math.log10(config.alpha / (run * (run + 1.0)))


def persistent_bound(distance_m: float, reach_m: float, sigma_m: float) -> float:
    """Bound on the probability that a persistent error makes an object that is not the target agree, 0..1.

    Args:
        distance_m: from the target to the nearest other object, across D2's line of sight.
        reach_m: offset ``r0`` from which on agreement is an accident.
        sigma_m: standard deviation of the persistent error, per axis across the line of sight.
    """
    if distance_m <= reach_m:
        return 1.0
    return math.exp(-0.5 * ((distance_m - reach_m) / sigma_m) ** 2) if sigma_m > 0.0 else 0.0


class EvidenceGate:
    """Blocks of agreeing pairs, on top of the paper's window that says what a pair is. One instance for one attempt."""

    def __init__(self, config: MethodConfig) -> None:
        own = config.evidence
        self._config = own
        self._run = AgreementWindow(replace(config, hold_frames=own.min_pairs, hold_s=own.min_s))
        self._block_ns = round(own.block_s * 1e9)
        self._runs = 0
        self._blocks = 0
        self._begin_ns = 0  # of the block under way
        self._pairs = 0
        self._sum = 0.0

    @property
    def count(self) -> int:
        return self._run.count

    @property
    def span_s(self) -> float:
        return self._run.span_s

    @property
    def blocks(self) -> int:
        """Of the run under way, those that agree."""
        return self._blocks if self._run.count else 0

    @property
    def evidence(self) -> Evidence:
        return Evidence(evidence_of(self.blocks, self._config), evidence_needed(max(1, self._runs), self._config))

    @property
    def complete(self) -> bool:
        evidence = self.evidence
        return self._run.complete and evidence.reached >= evidence.needed

    def agree(self, pair: FramePair, iou: float, tau: float) -> MissReason | None:
        if not iou >= tau:  # no pair that agrees: whoever says so is wrong, and gains nothing
            return self.disagree(pair.peer_sequence, pair.capture_ns)
        refusal = self._run.agree(pair)
        if refusal is not None:
            return refusal
        if self._run.count == 1:
            self._runs += 1
            self._blocks = 0
            self._begin(pair.capture_ns)
        self._pairs += 1
        self._sum += strength(iou, tau)
        if pair.capture_ns - self._begin_ns >= self._block_ns and self._pairs >= self._config.block_pairs:
            self._judge(pair.capture_ns)
        return None

    def disagree(self, peer_sequence: int, capture_ns: int) -> MissReason | None:
        return self._run.disagree(peer_sequence, capture_ns)

    def restart(self, stamp_ns: int) -> None:
        self._run.restart(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        return self._run.expire(instant_ns)

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self._run.refusal(peer_sequence)

    def _begin(self, capture_ns: int) -> None:
        self._begin_ns, self._pairs, self._sum = capture_ns, 0, 0.0

    def _judge(self, capture_ns: int) -> None:
        """A block is full: it adds to the run's evidence, or ends the run."""
        if self._sum >= self._config.strength * self._pairs:
            self._blocks += 1
            self._begin(capture_ns)
        else:
            self._run.restart(capture_ns)


T = TypeVar("T")


def _first(answers: list[T]) -> T:
    """That of the deciding gate, once all have been asked."""
    return answers[0]


class SideBySide:
    """Several gates fed with the same pairs: the first one decides, the others look on (to compare them)."""

    def __init__(self, first: Gate, *others: Gate) -> None:
        self.gates: tuple[Gate, ...] = (first, *others)

    @property
    def count(self) -> int:
        return self.gates[0].count

    @property
    def span_s(self) -> float:
        return self.gates[0].span_s

    @property
    def evidence(self) -> Evidence | None:
        return self.gates[0].evidence

    @property
    def complete(self) -> bool:
        return self.gates[0].complete

    def agree(self, pair: FramePair, iou: float, tau: float) -> MissReason | None:
        return _first([gate.agree(pair, iou, tau) for gate in self.gates])

    def disagree(self, peer_sequence: int, capture_ns: int) -> MissReason | None:
        return _first([gate.disagree(peer_sequence, capture_ns) for gate in self.gates])

    def restart(self, stamp_ns: int) -> None:
        for gate in self.gates:
            gate.restart(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        return _first([gate.expire(instant_ns) for gate in self.gates])

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self.gates[0].refusal(peer_sequence)
