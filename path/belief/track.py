"""One object that a drone sees: where it is, how large, whether it exists, and how likely it is the
designated one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from path.belief.motion import Array, Motion

SPELL_S = 0.1
"""For so long, in the mean, a detector goes on to miss an object, or to invent one."""
HIDDEN = 0.05
"""The share of objects that are not shown, where one is looked for, because something hides
them.
"""
CONFIRMED = 0.95
LOG_ODDS_CONFIRMED = math.log(CONFIRMED / (1.0 - CONFIRMED))


@dataclass(slots=True)
class ObjectTrack:
    """One object.

    Attributes:
        log_sides: logarithms of the sides of its box in m. size_variances: of each.
        log_odds: that it exists. owed: of new ones, by other track, the share of its identity that
            is this one's if it exists.
        shown: whether the newest frame that could have did show it, in a box of its own.
        seen_ns: when it was last shown, alone or not.
        inferred: whether it was never shown in a box of its own: it is the other one in a box that
            is larger than the target can be.
        identity: the probability that it is the designated object, without what new tracks are
            owed, and doubts.
        replaced: the probability that it follows something else than before, and the object is near
            and can be seen;
        hidden: and cannot.
    """

    number: int
    motion: Motion
    log_sides: Array
    size_variances: Array
    log_odds: float
    seen_ns: int
    shown: bool = True
    inferred: bool = False
    identity: float = 0.0
    owed: dict[int, float] = field(default_factory=dict[int, float])
    replaced: float = 0.0
    hidden: float = 0.0

    def doubted(self, share: float, unseen_s: float = 0.0) -> None:
        """Something else may have come to where the object was, with this probability, and the
        object be near: hidden rather than missed, the longer it was not seen.
        """
        added = (1.0 - self.doubt) * share
        hidden = HIDDEN / (HIDDEN + (1.0 - HIDDEN) * math.exp(-unseen_s / SPELL_S))
        self.replaced += added * (1.0 - hidden)
        self.hidden += added * hidden

    @property
    def doubt(self) -> float:
        return min(1.0, self.replaced + self.hidden)

    @property
    def existence(self) -> float:
        return 1.0 / (1.0 + math.exp(-self.log_odds))

    @property
    def confirmed(self) -> bool:
        return self.log_odds >= LOG_ODDS_CONFIRMED

    def sides_m(self, most_m: tuple[float, float]) -> Array:
        return np.minimum(np.exp(self.log_sides), most_m)
