"""Where two keyframes could fit together: loose matches, votes for places, alignment on depth.

``path.common_view.estimate`` judges what is found here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from path.arrays import Array
from path.common_view.align_kernels import Known, Matches, View, corner_fit, depth_fit
from path.common_view.keyframe import Keyframe
from path.common_view.match_kernels import distances, nearest, peaks, spread, votes
from path.common_view.refine_kernels import refined
from path.values import frozen

# Log-likelihood ratio of a descriptor's distance, of the same place to another, by tens of bits
# from 5 on: measured on a kitchen, the same from 15 to 90 degrees between the views.
ALIKE = np.interp(
    np.arange(257),
    np.arange(5, 135, 10),
    (6.5, 6.5, 6.5, 6.2, 5.0, 3.6, 2.4, 1.5, 0.8, 0.2, -0.3, -0.8, -1.3),
)
REPEATED = 0.2
"""Share of one keyframe's corners that are corners in the other too; measured, 0.18-0.26."""
MATCHES_EACH = 12
MOST_BITS = 90
YAW_STEP = math.radians(2.0)
SIGMAS = 3.0
"""The prior's box is so many standard deviations to each side."""
CELL_OF_RANGE = 0.04
MOST_CELLS = 2_000_000
PEAKS = 40
LEAST_VOTES = 3.0
FINALISTS = 8
COARSE = np.array([0.08, 0.06, 0.05, 0.04])
FINE = np.array([0.05, 0.04, 0.035, 0.03, 0.03, 0.03, 0.03, 0.03])
COARSE_SAMPLES = 300
FINE_SAMPLES = 2400
CORNER_SIGMA = 0.025
"""Of a matched corner, as a share of the distance: descriptors bear so much of a shift."""
INDEPENDENT_PLANES = 200.0
INDEPENDENT_CORNERS = 2.0
INDEPENDENT_DEPTHS = 50.0
"""What the comparison of depth is worth: as if so many of all samples were independent."""
CORNERS_WORTH = 0.3
"""What the likelihood ratio of all corners is worth, which are not independent."""
FOUR = (3, 4, 5, 2)
"""Translation and yaw in a step of six."""


@frozen(eq=False)
class Prior:
    """What both drones' reports say of the second levelled frame in the first.

    Attributes:
        yaw_rad: about down. ``t_m``: (3,). Both with their standard deviations.
    """

    yaw_rad: float
    yaw_sigma_rad: float
    t_m: Array
    t_sigma_m: Array


@frozen(eq=False)
class Place:
    """A place of the second camera, aligned, and how well it explains both views.

    Attributes:
        R, t: from the second levelled frame to the first.
        covariance: (6, 6) of a turn from the left and translation.
        depth: mean log-likelihood ratio of depth, over all compared points.
        seen, agree, conflict: shares: of all compared points in both views, and of these.
        corner_gain: log-likelihood ratio of the corners. ``corners``: that have a match.
    """

    R: Array
    t: Array
    covariance: Array
    depth: float
    seen: float
    agree: float
    conflict: float
    corner_gain: float
    corners: int

    @property
    def gain(self) -> float:
        """Return the log-likelihood ratio of this place to any other inside of the prior."""
        return INDEPENDENT_DEPTHS * self.depth + CORNERS_WORTH * self.corner_gain

    @property
    def yaw_rad(self) -> float:
        return math.atan2(self.R[1, 0], self.R[0, 0])


def view_of(keyframe: Keyframe, most: int) -> View:
    """Return a keyframe's depth as the kernels take it, ``most`` points of it to be compared."""
    grid = keyframe.grid
    R = np.ascontiguousarray(keyframe.R_l_c)
    on_plane = np.flatnonzero(grid.points[:, 2] > 0.0)
    step = max(1, math.ceil(len(on_plane) / most))
    return View(
        grid.points @ R.T, grid.normals @ R.T, grid.depth, grid.lens, R, on_plane[::step],
        keyframe.depth_sigma_at_1m_m,
    )  # fmt: skip


def loose_matches(first: Keyframe, second: Keyframe) -> Matches:
    """Return the most similar corners of the second for each of the first; few of them are right."""
    each = min(MATCHES_EACH, len(second.points_c))
    near = np.zeros((len(first.points_c), each), np.int64)
    if near.size == 0:
        nothing = np.zeros((0, 3))
        return Matches(nothing, nothing, np.zeros(0, np.int64), np.zeros(0))
    hamming = distances(first.descriptors.view(np.uint64), second.descriptors.view(np.uint64))
    nearest(hamming, each, near)
    corner = np.repeat(np.arange(len(near)), each)
    other = near.ravel()
    bits = hamming[corner, other]
    alike = bits < MOST_BITS
    corner = corner[alike]
    return Matches(
        (first.points_c @ first.R_l_c.T)[corner],
        (second.points_c @ second.R_l_c.T)[other[alike]],
        corner,
        np.exp(ALIKE[bits[alike]]),
    )


def candidates(
    matches: Matches,
    prior: Prior,
    range_m: float,
) -> list[tuple[Array, Array]]:
    """Return rotations and translations for which the most matches vote, inside of the prior."""
    reach = SIGMAS * prior.yaw_sigma_rad
    many = 2 * math.ceil(reach / YAW_STEP) + 1
    yaws = prior.yaw_rad + np.linspace(-reach, reach, many)
    box = 2.0 * SIGMAS * prior.t_sigma_m
    # A box that is wide for its scene is looked at more coarsely, not with more memory.
    finest = float(np.prod(box) * many / MOST_CELLS) ** (1.0 / 3.0)
    cell = max(CELL_OF_RANGE * range_m, finest)
    low = prior.t_m - 0.5 * box
    size = np.maximum(np.ceil(box / cell).astype(np.int64), 1)
    raw = np.zeros((many, *size), np.float32)
    votes(matches.first, matches.second, np.log(matches.gain), yaws, low, cell, raw)
    smooth = np.empty_like(raw)
    spread(raw, smooth)
    cells = np.zeros((PEAKS, 4), np.int64)
    held = peaks(smooth, LEAST_VOTES, cells, np.zeros(PEAKS))
    return [
        (about_down(float(yaws[a])), low + (np.array([i, j, k]) + 0.5) * cell)
        for a, i, j, k in cells[:held].tolist()
    ]


def about_down(yaw: float) -> Array:
    """Return the rotation (3, 3) by a yaw."""
    c = math.cos(yaw)
    s = math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def aligned(
    first: Keyframe, second: Keyframe, matches: Matches, known: Known,
    guesses: Sequence[tuple[Array, Array]],
) -> list[Place]:  # fmt: skip
    """Return the likeliest places, best first: all guesses aligned coarsely, few finely."""
    one = view_of(first, COARSE_SAMPLES)
    two = view_of(second, COARSE_SAMPLES)
    coarse = [_aligned(one, two, matches, known, R, t, COARSE) for R, t in guesses]
    coarse = distinct(coarse)[:FINALISTS]
    one = view_of(first, FINE_SAMPLES)
    two = view_of(second, FINE_SAMPLES)
    return distinct([_aligned(one, two, matches, known, at.R, at.t, FINE) for at in coarse])


def distinct(places: Sequence[Place | None]) -> list[Place]:
    """Return places by likelihood, without those that ended where a likelier one did."""
    kept: list[Place] = []
    for place in sorted((p for p in places if p is not None), key=lambda p: -p.gain):
        if not any(_same(place, other) for other in kept):
            kept.append(place)
    return kept


def _same(one: Place, other: Place) -> bool:
    """Return whether two places are within three of their standard deviations."""
    off = np.empty(4)
    off[:3] = one.t - other.t
    off[3] = math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    spread_of = other.covariance[np.ix_(FOUR, FOUR)] + one.covariance[np.ix_(FOUR, FOUR)]
    return float(off @ np.linalg.solve(spread_of, off)) < 9.0


def _aligned(
    one: View,
    two: View,
    matches: Matches,
    known: Known,
    R0: Array,
    t0: Array,
    bounds: Array,
) -> Place | None:
    """Return the place that a guess leads to; None where nothing holds it."""
    R = R0.copy()
    t = t0.copy()
    covariance = np.empty((6, 6))
    held = refined(
        one, two, matches, known, R, t, bounds, CORNER_SIGMA, REPEATED,
        INDEPENDENT_PLANES, INDEPENDENT_CORNERS, covariance,
    )  # fmt: skip
    if not held:
        return None
    depth, seen, agree, conflict = depth_fit(one, two, R, t)
    gain, corners = corner_fit(matches, R, t, CORNER_SIGMA, REPEATED)
    compared = len(one.samples) + len(two.samples)
    return Place(
        R, t, covariance, depth / compared, seen / compared, agree / max(seen, 1),
        conflict / max(seen, 1), gain, corners,
    )  # fmt: skip
