"""Outcomes by the paper's definitions, and the thresholds that are best for a baseline."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Literal

import numpy as np

from missions.trials.shared.statistics import wilson
from path.baselines.association import choose
from path.values import frozen

Outcome = Literal["tp", "tn", "fp", "fn"]
OUTCOMES: tuple[Outcome, ...] = ("tp", "tn", "fp", "fn")
MAX_LEAD = 12


def outcome(
    present: bool,
    chosen: bool,
    right: bool,
) -> Outcome:
    """Return the outcome by the paper: an incorrect candidate is a false positive, with the target
    present or not.

    Args:
        chosen: D2 selected something.
        right: what it selected is the target.
    """
    if chosen:
        return "tp" if present and right else "fp"
    return "fn" if present else "tn"


@frozen
class FrameTally:
    """Frames by outcome. Rates are of all frames, as the paper's are (7 of 350 = 2.0 %)."""

    tp: int = 0
    tn: int = 0
    fp: int = 0
    fn: int = 0

    @classmethod
    def of(cls, outcomes: Iterable[Outcome]) -> FrameTally:
        counts = dict.fromkeys(OUTCOMES, 0)
        for each in outcomes:
            counts[each] += 1
        return cls(**counts)

    @property
    def frames(self) -> int:
        return self.tp + self.tn + self.fp + self.fn

    @property
    def accuracy(self) -> float:
        return (self.tp + self.tn) / max(1, self.frames)

    def interval(self, *outcomes: Outcome) -> tuple[float, float]:
        """95 % interval (Wilson) of the share of frames with one of these outcomes."""
        return wilson(sum(getattr(self, each) for each in outcomes), self.frames)

    def summary(self) -> dict[str, Any]:
        frames = max(1, self.frames)
        return {
            **{each: getattr(self, each) for each in OUTCOMES},
            "accuracy": self.accuracy,
            "accuracy_interval": list(self.interval("tp", "tn")),
            "fp_rate": self.fp / frames,
            "fp_interval": list(self.interval("fp")),
            "fn_rate": self.fn / frames,
            "fn_interval": list(self.interval("fn")),
        }


@frozen
class Ballot:
    """The choice that a baseline had in one frame, in each of its variants.

    Attributes:
        owners: the person each of D2's boxes really shows; None: no person.
        votes: verified matches of each box, by variant.
    """

    present: bool
    owners: tuple[int | None, ...]
    votes: tuple[tuple[int, ...], ...]

    def only(self, variants: Sequence[int]) -> Ballot:
        """The same with some of the variants, by number."""
        return replace(self, votes=tuple(self.votes[i] for i in variants))

    def outcome(self, rule: Rule) -> Outcome:
        box = choose(self.votes[rule.variant], rule.min_inliers, rule.min_lead)
        return outcome(self.present, box is not None, box is not None and self.owners[box] == 0)


@frozen
class Rule:
    """The decision rule of a baseline: which variant of it, and its thresholds."""

    variant: int
    min_inliers: int
    min_lead: int


def tally(ballots: Sequence[Ballot], rule: Rule) -> FrameTally:
    return FrameTally.of(ballot.outcome(rule) for ballot in ballots)


def best_rule(ballots: Sequence[Ballot], variants: int) -> Rule:
    """The variant and thresholds of the highest accuracy on these frames; of equals that with fewer
    false ones.

    On the frames it is judged by this is more than a baseline can know: an upper bound.
    """
    present = np.array([ballot.present for ballot in ballots])
    best: tuple[tuple[int, int], Rule] | None = None
    for variant in range(variants):
        most, lead, right = (
            np.array(column)
            for column in zip(*(_first(ballot, variant) for ballot in ballots), strict=True)
        )
        # others decide as one of these
        needs = sorted({max(1, int(count)) for count in most} | {int(most.max()) + 1})
        for needed, least in product(needs, range(MAX_LEAD + 1)):
            chosen = (most >= needed) & (lead >= least)
            tp = int(np.count_nonzero(chosen & present & right))
            worth = (
                tp + int(np.count_nonzero(~chosen & ~present)),
                tp - int(np.count_nonzero(chosen)),
            )
            if best is None or worth > best[0]:
                best = worth, Rule(variant, needed, least)
    assert best is not None
    return best[1]


def _first(ballot: Ballot, variant: int) -> tuple[int, int, bool]:
    """Votes of the box with the most, how many more than the next, and whether it is the
    target's.
    """
    votes = ballot.votes[variant]
    box = choose(votes, 1, 0)
    if box is None:
        return 0, 0, False
    return (
        votes[box],
        votes[box] - max((v for i, v in enumerate(votes) if i != box), default=0),
        ballot.owners[box] == 0,
    )
