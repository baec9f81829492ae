"""The gate "evidence": a sequential test on the overlap S_k, with a stated bound on being fooled.

What can make boxes of different objects agree, and what is done about it:

1. *Persistent errors* (calibration, mounting, attitude, clocks, where a box's centre lies on the
  body) are drawn once.
   If they move D2's prior onto a look-alike, every later frame agrees: no number of frames tells,
   in this gate or in the paper's. They must be large for it: a mapped box agrees with D1's only
   when it is less than some ``r0`` off, so an object ``d`` away needs an error above ``d - r0``
   (``persistent_bound``), paid once per attempt. A high overlap makes ``r0`` small: that is why
   ``strength`` is asked for, and not IoU >= tau alone; and ``max_pose_sigma_m`` keeps the errors
   what they are said to be.

2. *What varies* around an offset of at least ``r0`` (aspect, attitude wander, noise) is strongly
  correlated: overlaps
   0.5 s apart still are. Nothing is derived for independent frames. The pairs of a run are cut into
   blocks; a block agrees when most of its pairs do and their median strength ``(S - tau) / (1 -
   tau)`` suffices. Where the rig states the target's size, the strength is that of the overlap with
   D2's box moved to where such a body has its middle (``path.target.rivals.placed``); what S itself
   says of a pair stays as it is. Whatever the dependence, with different things in the boxes

       P(a run's first block agrees) <= first_rate,   P(a later one agrees | all before it) <= next_rate

   with two rates that are *measured*. A run's evidence E is a bet against these: the first block
   multiplies it by 1 / first_rate or ends the run; a later one by ``gain`` when it agrees and by
   ``setback`` when it does not, with

       next_rate * gain + (1 - next_rate) * setback = 1,

   so that E is expected not to grow, and exceeds 1 / a at any time with a probability of at most a
   (Ville). The j-th run of an attempt may spend ``alpha / (j (j + 1))``, which sums to ``alpha``
   however often it is tried. What speaks against errors that last (``identity``) is asked for the
   first run's share in every run: all runs of an attempt have the same errors, so that another run
   tries nothing new.

A frame without a box, of either camera, is no disagreement: a detector misses one object as it
misses another. It adds nothing, and nothing is assumed for it: blocks are of pairs that were
compared, and wait until they have enough of them. Boxes are not carried on from other frames. After
``max_gap_s`` without an agreeing pair the run ends: by then it may be about something else. A box
in the wrong place (a false positive) is a pair that disagrees: few of them cost nothing, many the
block.

Boxes that errors that last put far apart are weak in every block, and no less of one object. A
second test may be made beside the first, in longer blocks, which waver less and so may be weaker
(``TwoPaces``). Each has rates of its own and a share of ``alpha`` for accidents, so that both
together stay below it.

Rates, ``r0`` and the errors come from simulation with persistent errors, misses and look-alikes,
see the decision records.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from statistics import median

from path.config import EvidenceConfig, MethodConfig
from path.gate.identity import Identity
from path.gate.likelihood import LikelihoodGate
from path.gate.window import AgreementWindow, Evidence, FramePair, Gate
from path.observations import MissReason


def make_gate(config: MethodConfig) -> Gate:
    """The gate that the settings name, for one attempt."""
    if config.gate == "count":
        return AgreementWindow(config)
    if config.gate == "likelihood":
        return LikelihoodGate(config)
    if config.evidence.patient_block_s:
        return TwoPaces(config)
    return EvidenceGate(config)


def strength(iou: float, tau: float) -> float:
    """Return by how much a pair agrees: 0 at the threshold, 1 for equal boxes.

    Below 0 it does not agree.
    """
    if tau >= 1.0:
        return iou - tau
    return (iou - tau) / (1.0 - tau)


def gain(config: EvidenceConfig) -> float:
    """Return the factor of an agreeing block after the first: all that the setbacks allow."""
    lost = (1.0 - config.next_rate) * config.setback
    return (1.0 - lost) / config.next_rate


def evidence_of(
    blocks: int,
    config: EvidenceConfig,
    setbacks: int = 0,
) -> float:
    """log10 of a run's evidence after so many agreeing blocks, and others that did not agree."""
    if blocks <= 0:
        return 0.0
    by_first = -math.log10(config.first_rate)
    later = blocks - 1
    gained = later * math.log10(gain(config))
    taken = setbacks * math.log10(config.setback)
    return gained + taken + by_first


def evidence_needed(run: int, config: EvidenceConfig) -> float:
    """Return the evidence that the ``run``-th run of an attempt needs (1, 2, ...).

    Each later one may spend less of what accidents may.
    """
    of_accidents = config.alpha * config.accident_share
    of_this_run = of_accidents / (run * (run + 1.0))
    return -math.log10(of_this_run)


def persistent_bound(
    distance_m: float,
    reach_m: float,
    sigma_m: float,
    measured: int,
) -> float:
    """Bound the probability that a persistent error makes another object agree, 0..1.

    For errors that are normal about zero with an unknown standard deviation, the same along both
    axes, that was estimated from ``measured`` attempts: the tail of the ratio is heavier than that
    of a normal distribution.

    Args:
        distance_m: from the target to the nearest other object, across D2's line of sight.
        reach_m: offset ``r0`` from which on agreement is an accident.
        sigma_m: standard deviation of the persistent error, per axis across the line of sight, as
            estimated.
    """
    if distance_m <= reach_m:
        return 1.0
    if sigma_m <= 0.0:
        return 0.0
    sigmas = (distance_m - reach_m) / sigma_m
    return (1.0 + 0.5 * sigmas**2 / measured) ** -measured


@dataclass(slots=True)
class BlockCounts:
    """Numbers of blocks that a gate judged, and of those that agreed.

    First ones of a run, and later ones.
    """

    first: list[int] = field(default_factory=lambda: [0, 0])
    later: list[int] = field(default_factory=lambda: [0, 0])

    def note(self, later: bool, agrees: bool) -> None:
        counts = self.first
        if later:
            counts = self.later
        counts[0] += 1
        counts[1] += agrees


class EvidenceGate:
    """Blocks of compared pairs, over the paper's window that says which pairs are new.

    One instance an attempt.

    Attributes:
        judged: of all blocks so far, those of runs that ended included.
    """

    def __init__(self, config: MethodConfig) -> None:
        own = config.evidence
        self._config = own
        window = replace(
            config,
            hold_frames=own.min_pairs,
            hold_s=own.min_s,
            max_gap_s=own.max_gap_s,
        )
        self._run = AgreementWindow(window)
        self._block_ns = round(own.block_s * 1e9)
        self._shared = -math.log10(own.accident_share)
        self._runs = 0
        self._blocks = 0
        self._setbacks = 0
        self._agreed = False  # the newest pair that was compared
        self._begin_ns = 0  # of the block under way
        self._strengths: list[float] = []  # of its pairs
        self._identity = Identity()  # of the run under way
        self.judged = BlockCounts()
        # blocks and setbacks, and what evidence follows from them
        self._counted = (0, 0)
        self._by_blocks = 0.0

    @property
    def count(self) -> int:
        return self._run.count

    @property
    def span_s(self) -> float:
        return self._run.span_s

    @property
    def blocks(self) -> int:
        """The number of agreeing blocks in the run under way."""
        return self._blocks if self._run.count else 0

    @property
    def evidence(self) -> Evidence:
        config = self._config
        counted = (self.blocks, self._setbacks)
        if counted != self._counted:
            self._counted = counted
            self._by_blocks = evidence_of(
                self.blocks,
                config,
                self._setbacks,
            )

        needed = evidence_needed(1, config)
        later = 0.0
        if self._runs > 1:
            later = evidence_needed(self._runs, config) - needed
        # Errors that last are drawn once: another run or test is another chance for an accident,
        # not for them.
        lasting = self._identity.reached(config)
        lasting += later
        lasting += self._shared
        reached = min(self._by_blocks, lasting)
        return Evidence(reached, needed + later)

    @property
    def complete(self) -> bool:
        if not self._agreed:
            return False
        if not self._run.complete:
            return False
        evidence = self.evidence
        return evidence.reached >= evidence.needed

    def agree(
        self,
        pair: FramePair,
        iou: float,
        tau: float,
    ) -> MissReason | None:
        if not iou >= tau:
            # No pair that agrees: whoever says so is wrong, and gains nothing.
            return self.disagree(
                pair.peer_sequence,
                pair.capture_ns,
                strength(iou, tau),
            )
        if pair.oversize > self._config.size_sigmas:
            # There may be two objects in the box.
            refusal = self.disagree(
                pair.peer_sequence,
                pair.capture_ns,
                -math.inf,
            )
            return refusal or MissReason.AMBIGUOUS_TARGET
        refusal = self._run.agree(pair)
        if refusal is not None:
            return refusal

        begins = self._run.count == 1
        if begins:
            self._runs += 1
            self._blocks = 0
            self._setbacks = 0
            self._identity = Identity()
            self._begin(pair.capture_ns)
        if pair.offsets is not None:
            self._identity.note(pair.offsets)
        overlap = iou
        if pair.placed_iou is not None:
            overlap = pair.placed_iou
        by = strength(overlap, tau)
        self._compared(pair.capture_ns, by)
        return None

    def disagree(
        self,
        peer_sequence: int,
        capture_ns: int,
        by: float | None = None,
    ) -> MissReason | None:
        refusal = self._run.skip(peer_sequence, capture_ns)
        if refusal is not None:
            return refusal
        if by is not None and self._run.count:
            if not by < 0.0:
                # Whatever the boxes' overlap was: the pair counts as one that disagrees.
                by = -math.inf
            self._compared(capture_ns, by)
        return None

    def restart(self, stamp_ns: int) -> None:
        """D1 missed the target: that costs no evidence; the pairs around it cannot be compared."""

    def end_run(self, stamp_ns: int) -> None:
        """The next run is one more of this attempt, and may spend what that one may."""
        self._run.restart(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        return self._run.expire(instant_ns)

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self._run.refusal(peer_sequence)

    def _begin(self, capture_ns: int) -> None:
        self._begin_ns = capture_ns
        self._strengths = []

    def _compared(self, capture_ns: int, by: float) -> None:
        self._agreed = by >= 0.0
        self._strengths.append(by)
        is_long = capture_ns - self._begin_ns >= self._block_ns
        has_enough = len(self._strengths) >= self._config.block_pairs
        if is_long and has_enough:
            self._judge(capture_ns)

    def _judge(self, capture_ns: int) -> None:
        """A block is full: it adds to the run's evidence, takes from it, or ends the run."""
        own = self._config
        strengths = self._strengths
        agreeing = sum(each >= 0.0 for each in strengths)
        is_strong = median(strengths) >= own.strength
        most_agree = agreeing >= own.block_share * len(strengths)
        agrees = is_strong and most_agree
        self.judged.note(later=self._blocks > 0, agrees=agrees)
        if agrees:
            self._blocks += 1
        else:
            self._setbacks += 1
        left = evidence_of(self._blocks, own, self._setbacks)
        if left > 0.0:
            self._begin(capture_ns)
        else:
            self._run.restart(capture_ns)


class TwoPaces:
    """Two tests on the same pairs, in short and in long blocks.

    The first to be complete decides. One instance an attempt.
    """

    def __init__(self, config: MethodConfig) -> None:
        self.paces: list[EvidenceGate] = []
        for own in config.evidence.paces:
            of_this_pace = replace(config, evidence=own)
            self.paces.append(EvidenceGate(of_this_pace))

    @property
    def count(self) -> int:
        """Pairs of the run under way of the test that ``evidence`` is of."""
        return self._foremost.count

    @property
    def span_s(self) -> float:
        """The longer run's."""
        return max(pace.span_s for pace in self.paces)

    @property
    def evidence(self) -> Evidence:
        """Of the test that has most of what it needs."""
        return self._foremost.evidence

    @property
    def complete(self) -> bool:
        return any(pace.complete for pace in self.paces)

    @property
    def _foremost(self) -> EvidenceGate:
        def share(pace: EvidenceGate) -> float:
            evidence = pace.evidence
            return evidence.reached / evidence.needed

        return max(self.paces, key=share)

    def agree(
        self,
        pair: FramePair,
        iou: float,
        tau: float,
    ) -> MissReason | None:
        answers = [pace.agree(pair, iou, tau) for pace in self.paces]
        return answers[0]

    def disagree(
        self,
        peer_sequence: int,
        capture_ns: int,
        by: float | None = None,
    ) -> MissReason | None:
        answers = [pace.disagree(peer_sequence, capture_ns, by) for pace in self.paces]
        return answers[0]

    def restart(self, stamp_ns: int) -> None:
        """D1 missed the target: that costs no evidence."""

    def end_run(self, stamp_ns: int) -> None:
        for pace in self.paces:
            pace.end_run(stamp_ns)

    def expire(self, instant_ns: int) -> bool:
        expired = [pace.expire(instant_ns) for pace in self.paces]  # each must be told
        return any(expired)

    def refusal(self, peer_sequence: int) -> MissReason | None:
        return self.paces[0].refusal(peer_sequence)
