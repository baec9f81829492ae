"""One frame: which of its boxes is of which track, and who is in whose box."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from path.belief.assignment import associate
from path.belief.boxes import Fit, Measured, fit_of, held, inside, size_fits
from path.belief.motion import ODD_TIMES, Array, density, mahalanobis2
from path.belief.track import SPELL_S, ObjectTrack

GATE2 = (2.0 * ODD_TIMES) ** 2
"""The squared distance from which on a box is of something else, however odd it may be."""
SHOWN = 0.9
"""The probability that a detector shows an object that it showed in the frame before."""
_ITS_OWN = 0.9  # of what a box may be of: the share from which on its depth is of whom it is given
_IN_IT = 0.25  # within a box's width and within its height, as likely as not


class Frame:
    """The boxes of a frame against all tracks, which are predicted to its stamp.

    Args:
        sees: whether the frame shows what is at a place, if nothing hides it. dt_s: since the frame
            before.

    Attributes:
        holders: by track, the measurement whose box it is expected inside, or None.
        assigned: by track, the measurement that is of it, or None. marginals: (tracks, measured).
        fits: by track and measurement.
        held: by track, how a box that is another one's holds it, or None.
        together: the measurements that have more than one object in their box.
    """

    def __init__(
        self,
        tracks: Sequence[ObjectTrack],
        measured: Sequence[Measured],
        sees: Callable[[Array], bool],
        dt_s: float,
    ) -> None:
        self.measured = measured
        self.sees = sees
        self.dt_s = dt_s
        self.fits = [[fit_of(track, each) for each in measured] for track in tracks]
        self.holders = [_holder(track, measured) for track in tracks]
        self.assigned, self.marginals = associate(self._weights(tracks))
        self.together = set[int]()
        for k, column in enumerate(self.assigned):
            if column is None:
                continue
            others = self._others(tracks, k, column)
            if others:
                share = self.marginals[k, column] / self.marginals[:, column].sum()
                its_own = bool(share >= _ITS_OWN)
                fit = fit_of(tracks[k], measured[column], others, its_own=its_own)
                self.fits[k][column] = fit
            if self.fits[k][column].larger:
                self.together.add(column)
        self.held = [self._held(tracks, i, column) for i, column in enumerate(self.holders)]

    def fit(self, k: int) -> tuple[Measured, Fit] | None:
        """Return the measurement that is of a track, and how; None when none is."""
        column = self.assigned[k]
        return None if column is None else (self.measured[column], self.fits[k][column])

    def is_around(self, i: int, column: int) -> bool:
        """Return whether a track is expected inside a box that is larger than it."""
        return self.holders[i] == column and self.fits[i][column].larger

    def _weights(self, tracks: Sequence[ObjectTrack]) -> Array:
        weights = np.zeros((len(tracks), len(self.measured)))
        for i, track in enumerate(tracks):
            likely = track.existence * again(track, self.dt_s)
            looked_for = self.sees(track.motion.place_m) and self.holders[i] is None
            unshown = 1.0 - (likely if looked_for else 0.5 * likely)
            known_m2 = track.motion.place_covariance_m2
            for j, each in enumerate(self.measured):
                fit = self.fits[i][j]
                if track.inferred and fit.larger:
                    continue  # that is the box of the one that it is in there with
                off_m = fit.place_m - track.motion.place_m
                anywhere_m2 = known_m2 + fit.within_m2
                if mahalanobis2(off_m, anywhere_m2, each.covariance_m2)[0] > GATE2:
                    continue
                likelihood = density(off_m, anywhere_m2, each.covariance_m2) * size_fits(
                    track, each
                )
                weights[i, j] = likely * likelihood / (unshown * each.elsewhere_m3)
        return weights

    def _others(self, tracks: Sequence[ObjectTrack], own: int, column: int) -> list[ObjectTrack]:
        """Return who else is in a box, and not shown otherwise."""
        return [
            other
            for i, other in enumerate(tracks)
            if i != own
            and (
                self.assigned[i] == column
                or (other.confirmed and self.holders[i] == column and self.assigned[i] is None)
            )
        ]

    def _held(self, tracks: Sequence[ObjectTrack], i: int, column: int | None) -> Fit | None:
        if column is None or self.assigned[i] is not None:
            return None
        others = self._others(tracks, i, column) if column in self.together else []
        each = self.measured[column]
        return held(tracks[i], each, others, np.asarray(each.sides_m))


def again(track: ObjectTrack, dt_s: float) -> float:
    """Return the probability that a frame shows an object that exists: misses last SPELL_S."""
    return SHOWN if track.shown else min(SHOWN, dt_s / SPELL_S)


def _holder(track: ObjectTrack, measured: Sequence[Measured]) -> int | None:
    around = (column for column, each in enumerate(measured) if inside(track.motion, each) > _IN_IT)
    return next(around, None)
