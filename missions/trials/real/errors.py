"""Errors of corners against the board, with the print as the views show it: what all views agree on
is the print's.

So is the shape of a sheet that is not flat. A height moves a corner along the image of the board's
normal, in every view another way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from missions.trials.pose.corners.methods import FoundMarker
from missions.trials.real.board import SetSeen, growth, robust_solution
from missions.trials.real.corners import Corners
from missions.trials.real.set import RealSet
from path.arrays import Array
from path.geometry.transforms import Matrix
from path.values import frozen

FEWEST_VIEWS = 3  # that tell a print from the errors of its views
FEWEST_FOR_HEIGHT = 6  # the same of the paper's shape
# of paper that is expected, against errors of this size
HEIGHT_SIGMA_M = 3e-4
CORNER_PX = 0.1


@frozen(eq=False)
class SeenMarker:
    """One marker in one view.

    Attributes:
        nominal_px: (4, 2), found minus where the board says it is, all markers printed alike.
        error_px: the same without what all views of this marker have in common; scaled for what
            that takes away.
        slopes: (4, 2, 2) px / m on the board. ``rises``: (4, 2) px / m of height above it.
        doubt_px2: (8, 8), the covariance of where the board says it is; None where markers tell
            that themselves.
        lifted_px: (4, 2), the share of what is taken away that the paper's heights make.
    """

    view: int
    marker_id: int
    found: FoundMarker
    nominal_px: Array
    error_px: Array
    slopes: Array
    rises: Array
    doubt_px2: Array | None = None
    lifted_px: Array = field(default_factory=lambda: np.zeros((4, 2)))

    @property
    def along_px(self) -> Array:
        """The errors (4,) in the direction in which paper that is not flat moves a corner, and what
        it moves it.
        """
        return np.einsum("ki,ki->k", self.error_px + self.lifted_px, self._upwards)

    @property
    def across_px(self) -> Array:
        """The errors (4,) in the other direction: of the image and the print alone."""
        return np.einsum("ki,ki->k", self.error_px, self._upwards[:, ::-1] * np.array([-1.0, 1.0]))

    @property
    def _upwards(self) -> Array:
        return self.rises / np.maximum(np.linalg.norm(self.rises, axis=1, keepdims=True), 1e-9)

    @property
    def chi2(self) -> float:
        """Squared error over stated covariance, per number; nan without a covariance."""
        if self.found.covariance_px2 is None:
            return math.nan
        return self._over(self.found.covariance_px2)

    @property
    def chi2_with_doubt(self) -> float:
        """The same over what is stated and what the board leaves in doubt; nan without either."""
        if self.found.covariance_px2 is None or self.doubt_px2 is None:
            return math.nan
        return self._over(self.found.covariance_px2 + self.doubt_px2)

    def _over(self, covariance_px2: Array) -> float:
        e = self.error_px.ravel()
        return float(e @ np.linalg.solve(covariance_px2, e)) / len(e)

    @property
    def side_px(self) -> float:
        corners = self.found.corners_px
        return float(np.mean(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)))


@frozen(eq=False)
class MethodPoses:
    """All markers of one method, and the print as it sees it.

    Attributes:
        growth: how much larger all markers are than the file says, relative.
        print_m: by id, (4, 3) metres by which corners are off beyond that: on the board, and their
            heights above it.
    """

    seen: tuple[SeenMarker, ...]
    growth: float
    print_m: dict[int, Array]


def printed(
    own: RealSet,
    larger: float,
    marker_id: int,
) -> Matrix:
    """A marker's corners (4, 3) on the board, all markers so much larger than the file says."""
    corners = own.markers[marker_id].corners_o
    middle = corners.mean(axis=0)
    return middle + (corners - middle) * (1.0 + larger)


def measure_set(
    own: RealSet,
    seen: SetSeen,
    found: Sequence[Corners],
) -> MethodPoses:
    """Errors of what a method found in each view."""
    raw: list[SeenMarker] = []
    pairs = list(zip(seen.boards, found, strict=True))
    sizes = [
        (one.corners_px, board, own.markers[i].corners_o)
        for board, some in pairs
        for i, one in some.items()
    ]
    larger = growth(sizes) if sizes else 0.0
    for view, (board, corners) in enumerate(pairs):
        for marker_id, one in corners.items():
            points = printed(own, larger, marker_id)
            error = one.corners_px - board.pixels(points)
            doubt = None if own.board is None else board.doubt_px2(points)
            raw.append(
                SeenMarker(
                    view,
                    marker_id,
                    one,
                    error,
                    error,
                    board.slopes(points),
                    board.rises(points),
                    doubt,
                )
            )
    by_id: dict[int, list[SeenMarker]] = {}
    for marker in raw:
        by_id.setdefault(marker.marker_id, []).append(marker)
    print_m = {
        i: _print_of(markers, own.file.flat)
        for i, markers in by_id.items()
        if len(markers) >= FEWEST_VIEWS
    }
    measured = [
        _without_print(m, print_m.get(m.marker_id), len(by_id[m.marker_id]), own.file.flat)
        for m in raw
    ]
    return MethodPoses(tuple(measured), larger, print_m)


def _print_of(markers: Sequence[SeenMarker], flat: bool) -> Array:
    errors = np.stack([m.nominal_px for m in markers])
    pulls = np.stack([np.concatenate([m.slopes, m.rises[:, :, None]], axis=2) for m in markers])
    if _in_plane(len(markers), flat):
        places = [
            robust_solution(pulls[:, c, :, :2].reshape(-1, 2), errors[:, c].ravel())
            for c in range(4)
        ]
        return np.column_stack([np.stack(places), np.zeros(4)])
    expected = np.array([[0.0, 0.0, CORNER_PX / HEIGHT_SIGMA_M]])
    designs = [np.concatenate([pulls[:, c].reshape(-1, 3), expected]) for c in range(4)]
    return np.stack(
        [robust_solution(d, np.append(errors[:, c].ravel(), 0.0)) for c, d in enumerate(designs)]
    )


def _without_print(
    marker: SeenMarker,
    print_m: Array | None,
    views: int,
    flat: bool,
) -> SeenMarker:
    if print_m is None:
        return marker
    lifted = marker.rises * print_m[:, 2:]
    left = marker.nominal_px - np.einsum("kij,kj->ki", marker.slopes, print_m[:, :2]) - lifted
    unknowns = 2 if _in_plane(views, flat) else 3
    return replace(
        marker,
        error_px=left * math.sqrt(2 * views / (2 * views - unknowns)),
        lifted_px=lifted,
    )


def _in_plane(views: int, flat: bool) -> bool:
    """Return whether a marker's corners are taken to lie in the board's plane."""
    return flat or views < FEWEST_FOR_HEIGHT
