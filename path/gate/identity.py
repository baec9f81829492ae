"""The object that D2's box is of: the target, one that D1 sees beside it, or one that nobody sees.

How well boxes agree, frame after frame, says that D2 sees the same thing all the time, not which.
What could move another object's box onto the target's are errors that last: drawn once, the same in
every frame, so that more frames do not help. They are normal, with ``offset_sigma_m`` per axis in
D1's image, and so known that a run is worth one observation: the mean offset of D2's box from the
target, and from what it could be of instead. A ratio of likelihoods decides:

- against an object that D1 sees (``path.target.rivals``), where errors that last move both offsets
  alike: p(offset from the target) / p(offset from that object). By Markov's inequality it exceeds 1
      / a with a probability of
  at most a when the box is of that object, wherever it stands. One that is nearer to the target
  than the errors reach leaves nothing to be decided: no evidence, however many frames. D2 need not
  see it, and need not see both.
- against one that D1 does not see: it may be anywhere that D2 looks, ``REACH_SIGMAS`` of those
  errors around its prior, and there is one in a share ``unseen`` of all hand-overs at most, in
  which D2 does not see the target either. No frame tells more of it: p(offset from the target) /
  (unseen * p(anywhere)).

- against D1's own: where an object is nearer than ``apart_m`` to what D1 follows, D1 may have gone
  over to it, in a share ``swap`` of such hand-overs. Both boxes agree then for ever, so that
  nothing beyond 1 / swap can be reached while it is there, which is for ``rival_s`` after D1 has
  seen it.

The run's evidence is the smallest of these and of what the blocks say (``path.gate.evidence``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from path.config import EvidenceConfig
from path.gate.likelihood import REACH_SIGMAS
from path.gate.window import Offset, Offsets

NOTHING = 0.0


def log_likelihood(offset_m: Offset, config: EvidenceConfig) -> float:
    """Return log10 of how likely a mean offset is, 0 for no offset.

    When the box is of the object that it is measured from.

    The tail is that of errors whose size is known from ``offset_known`` measurements.
    """
    x, y = offset_m
    half = 0.5 * (x * x + y * y) / (config.offset_sigma_m * config.offset_sigma_m)
    return -config.offset_known * math.log10(1.0 + half / config.offset_known)


def against_unseen(target_m: Offset, config: EvidenceConfig) -> float:
    """log10 of the likelihood ratio against an object that D1 does not see."""
    density = 0.5 * REACH_SIGMAS**2
    return log_likelihood(target_m, config) + math.log10(density) - math.log10(config.unseen)


def against_rival(
    target_m: Offset,
    rival_m: Offset,
    config: EvidenceConfig,
) -> float:
    """log10 of the likelihood ratio against an object that D1 sees beside the target."""
    return log_likelihood(target_m, config) - log_likelihood(rival_m, config)


def nearest_rival(offsets: Offsets) -> Offset | None:
    """Of the objects beside the target, the offset from the one that D2's box is of most likely."""
    return min(offsets.rivals_m, key=lambda each: math.hypot(*each), default=None)


@dataclass(slots=True)
class Identity:
    """Mean offsets of the agreeing pairs of one run."""

    pairs: int = 0
    target: Offset = (0.0, 0.0)  # sums
    beside: int = 0
    target_then: Offset = (0.0, 0.0)  # of the pairs in which there was something beside the target
    rival: Offset = (0.0, 0.0)
    near_m: float = math.inf  # in the newest pair, from what D1 follows to the nearest other object

    def note(self, offsets: Offsets) -> None:
        self.pairs += 1
        self.near_m = min(
            (math.dist(each, offsets.target_m) for each in offsets.rivals_m), default=math.inf
        )
        self.target = _sum(self.target, offsets.target_m)
        rival = nearest_rival(offsets)
        if rival is not None:
            self.beside += 1
            self.target_then = _sum(self.target_then, offsets.target_m)
            self.rival = _sum(self.rival, rival)

    def reached(self, config: EvidenceConfig) -> float:
        """log10 of the evidence for the target; none before a pair was noted."""
        if not self.pairs:
            return NOTHING
        found = against_unseen(_mean(self.target, self.pairs), config)
        if self.beside:
            target_m = _mean(self.target_then, self.beside)
            rival_m = _mean(self.rival, self.beside)
            found = min(found, against_rival(target_m, rival_m, config))
        if self.near_m < config.apart_m:
            found = min(found, -math.log10(config.swap))
        return max(NOTHING, found)


def _sum(a: Offset, b: Offset) -> Offset:
    return a[0] + b[0], a[1] + b[1]


def _mean(total: Offset, count: int) -> Offset:
    return total[0] / count, total[1] / count
