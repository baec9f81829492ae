"""The effect of a detector's misses and false positives on the pairs of a Monte-Carlo hand-over run
without them.

Both drones' detectors have spells of misses and spells of inventions, each a chain of two states. A
frame of D2 that is missed is no candidate; one of D1 leaves nothing to compare with, and D2 without
a target once D1's newest sample is too old. An invented box is taken for the target: it overlaps
with nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flight.harness.montecarlo import MISS, OWN_MISS, PAIR, Series
from path.arrays import Flags, Whole
from path.config import MethodConfig
from path.observations import MissReason
from path.values import frozen

Generator = np.random.Generator

REASONS = list(MissReason)
LINK_S = 0.02  # from D1's frame to D2's use of it, at least
SEQUENCES = 1 << 16


@frozen
class DetectorFaults:
    """The errors of both drones' detectors.

    Attributes:
        recall: share of the frames with the target in which it is found.
        miss_frames: mean length of a spell without it; of a spell of inventions, too.
        false_positives: share of the frames with a box of nothing that is taken for the target.
    """

    recall: float = 1.0
    miss_frames: float = 1.0
    false_positives: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.recall:g} / {self.miss_frames:g} / {self.false_positives:.0%}"


def spells(
    share: float,
    mean_frames: float,
    count: int,
    rng: Generator,
) -> Flags:
    """(count,) a chain of two states that is on in ``share`` of the frames, for ``mean_frames`` at
    a time in the mean.

    Where so short spells cannot make up so large a share, the pauses between them are of one frame.
    """
    if share <= 0.0:
        return np.zeros(count, bool)
    ends = 1.0 / mean_frames
    begins = min(1.0, share * ends / (1.0 - share))
    on = np.empty(count, bool)
    state = rng.random() < share
    draws = rng.random(count)
    for k, draw in enumerate(draws.tolist()):
        on[k] = state
        state = draw >= ends if state else draw < begins
    return on


def unwrapped(sequence: Whole) -> Whole:
    """u16 numbers of frames as they were counted, from the first on; entries may be a little out of
    order.
    """
    steps = (np.diff(sequence, prepend=sequence[:1]) + SEQUENCES // 2) % SEQUENCES - SEQUENCES // 2
    return np.cumsum(steps)


@frozen
class FaultyFrames:
    """The frames of D1 and D2 in which detectors miss, and in which they invent: (n,) each, from
    the first on.
    """

    missed: tuple[Flags, Flags]
    false: tuple[Flags, Flags]

    def longest_clear(self, first: int = 0) -> int:
        """Frames of the longest stretch from one on in which both detectors see the target and
        nothing else.
        """
        begin = min(max(0, first), len(self.missed[0]))
        faulty = np.flatnonzero(np.any((*self.missed, *self.false), axis=0)[begin:])
        edges = np.concatenate(([-1], faulty, [len(self.missed[0]) - begin]))
        return int(np.diff(edges).max()) - 1


def faulty_frames(
    detector: DetectorFaults,
    many: int,
    rng: Generator,
) -> FaultyFrames:
    share = 1.0 - detector.recall
    missed = (
        spells(share, detector.miss_frames, many, rng),
        spells(share, detector.miss_frames, many, rng),
    )
    rate = detector.false_positives
    length = detector.miss_frames
    return FaultyFrames(missed, (spells(rate, length, many, rng), spells(rate, length, many, rng)))


def with_detector(
    series: Series,
    faults: FaultyFrames,
    method: MethodConfig,
) -> Series:
    """The series as it would have been with these detectors on both drones.

    D1's own misses add no entries: a pair that would have needed the frame is a miss.
    """
    pairs = series.kind == PAIR
    if not pairs.any():
        return series
    answered = series.kind != OWN_MISS
    number = np.zeros(len(series), np.int64)
    number[answered] = unwrapped(series.sequence[answered])
    number -= number.min()
    first = series.own[pairs, 0].min()
    before, after = (np.where(pairs, series.own[:, k] - first, 0) for k in (0, 2))
    (missed_1, missed_2), (false_1, false_2) = faults.missed, faults.false
    silent = _silent(series, missed_1, before, method)
    reason = series.reason.copy()
    reason[pairs & silent] = REASONS.index(MissReason.LINK_SILENT)
    reason[pairs & (missed_1[before] | missed_1[after])] = REASONS.index(MissReason.NO_TRACK)
    reason[pairs & missed_2[number]] = REASONS.index(MissReason.NO_CANDIDATE)
    lost = pairs & (reason >= 0)
    iou = series.iou.copy()
    iou[pairs & (false_1[before] | false_1[after] | false_2[number])] = 0.0
    return replace(series, kind=np.where(lost, MISS, series.kind), reason=reason, iou=iou)


def _silent(
    series: Series,
    missed_1: Flags,
    before: Whole,
    method: MethodConfig,
) -> Flags:
    """Return where D2 has no target that is new enough to carry on."""
    seen = np.where(missed_1, -1, np.arange(len(missed_1)))
    newest = np.maximum.accumulate(seen)[before]
    period_s = float(np.median((series.own[:, 3] - series.own[:, 1])[series.kind == PAIR])) * 1e-9
    return (before - newest) * period_s + LINK_S > method.max_extrapolation_s
