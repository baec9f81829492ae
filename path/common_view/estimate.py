"""The pose of one RGB-D camera in another's frame, from one keyframe of each.

Gravity is known to both, so four numbers are asked for: yaw and translation, inside of what the
drones report. Loose matches of corners vote for translations at each yaw; the highest places are
aligned on depth; and each is judged by how well both depths agree, which of their points lie in
front of what the other measured, and which corners look alike where they would be the same. What
several places explain equally well is not known, and is said to be unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from path.arrays import Array
from path.common_view.align_kernels import Known
from path.common_view.keyframe import Keyframe
from path.common_view.search import FOUR, Place, Prior, aligned, candidates, loose_matches
from path.values import frozen

LEAST_POINTS = 50
ERROR_OF_RANGE = 0.01
"""Standard deviation that no residual shows, as a share of the median distance: of depth that is
bent alike over a whole image, and of what moved between the views."""
ERROR_OF_YAW_RAD = math.radians(0.6)
ERROR_OF_GAIN = 0.05
"""Share of a log-likelihood ratio that is worth nothing when places are compared: of two that both
explain nearly everything, it is chance which has more in view."""


class Why(Enum):
    """Why the pose is unknown."""

    FEW_POINTS = "few_points"
    """One of the views has hardly any depth or corners."""
    NOTHING_COMMON = "nothing_common"
    """No place inside of the prior explains both views."""
    AMBIGUOUS = "ambiguous"
    """Several places explain both views."""
    UNCONSTRAINED = "unconstrained"
    """What both views show does not hold all four numbers: a bare floor, a wall."""


@frozen
class Settings:
    """When a pose is known.

    Attributes:
        least_evidence: log-likelihood ratio of a place to any other inside of the prior.
        most_conflict: share of common points that lie in front of what the other measured.
        most_sigma: of the translation along its widest axis, as a share of the median distance.
        most_yaw_sigma_rad: of yaw.
        least_corners: that look alike where they would be the same. A floor with few things on it
            agrees with itself wherever it is put: depth alone was off by a metre there, and sure.
    """

    least_evidence: float = 12.0
    most_conflict: float = 0.1
    most_sigma: float = 0.06
    most_yaw_sigma_rad: float = math.radians(3.0)
    least_corners: int = 0


@frozen(eq=False)
class CommonView:
    """Where the second camera is.

    Attributes:
        yaw_rad, t_m: of the second levelled frame in the first: ``p1 = R p2 + t``.
        R_l1_l2: (3, 3), yaw and what is left of both gravities' errors.
        covariance: (4, 4) of translation and yaw, m and rad.
        likelihood: that it is this place, among all that were found.
        agreement, conflict: shares of the points in both views that agree, and that lie in front of
            what the other measured.
        common: share of all compared points that are in both views.
        corners: corners that look alike where they would be the same.
        evidence: log-likelihood ratio to any other place inside of the prior.
    """

    yaw_rad: float
    t_m: Array
    R_l1_l2: Array
    covariance: Array
    likelihood: float
    agreement: float
    conflict: float
    common: float
    corners: int
    evidence: float


@frozen(eq=False)
class Unknown:
    """Why there is no pose. ``best``: the likeliest place all the same, to be looked at and not
    used.
    """

    why: Why
    best: CommonView | None = None


def common_view(
    first: Keyframe,
    second: Keyframe,
    prior: Prior,
    settings: Settings | None = None,
) -> CommonView | Unknown:
    """Return where the second keyframe's camera is in the first's levelled frame.

    Args:
        first: may be thinned for a link. ``second``: the fuller it is, the better.
        prior: the box that is searched.
    """
    asked = settings or Settings()
    matches = loose_matches(first, second)
    known_depth = first.grid.depth[first.grid.depth > 0.0]
    points = min(np.count_nonzero(frame.grid.points[:, 2]) for frame in (first, second))
    if len(matches.corner) == 0 or points < LEAST_POINTS:
        return Unknown(Why.FEW_POINTS)
    range_m = float(np.median(known_depth))
    tilt = first.gravity_sigma_rad**2 + second.gravity_sigma_rad**2
    known = Known(
        prior.yaw_rad,
        prior.t_m,
        prior.yaw_sigma_rad**-2,
        prior.t_sigma_m**-2,
        1.0 / tilt,
    )
    guesses = candidates(matches, prior, range_m)
    places = aligned(first, second, matches, known, guesses)
    if not places:
        return Unknown(Why.NOTHING_COMMON)
    return judged(places, known, range_m, asked)


def judged(
    places: Sequence[Place],
    known: Known,
    range_m: float,
    asked: Settings,
) -> CommonView | Unknown:
    """Return the likeliest place, or why it is not known. ``places``: at least one.

    What is said is one Gaussian around the likeliest place with the spread of all of them: another
    place close by widens it, and one far away, unless it is very unlikely, makes it useless.
    """
    likeliest = max(range(len(places)), key=lambda k: log_mass(places[k], known, 1.0))
    place = places[likeliest]
    unsure = 1.0 + ERROR_OF_GAIN * max(0.0, place.gain)
    masses = np.array([log_mass(other, known, unsure) for other in places])
    shares = np.exp(masses - masses.max())
    shares /= shares.sum()
    own = stated(place, range_m)
    covariance = np.zeros((4, 4))
    for share, other in zip(shares, places, strict=True):
        off = np.append(other.t - place.t, math.remainder(other.yaw_rad - place.yaw_rad, math.tau))
        covariance += share * (stated(other, range_m) + np.outer(off, off))
    best = CommonView(
        place.yaw_rad, place.t, place.R, covariance, float(shares[likeliest]), place.agree,
        place.conflict, place.seen, place.corners, place.gain,
    )  # fmt: skip
    if best.conflict > asked.most_conflict or best.evidence < asked.least_evidence:
        return Unknown(Why.NOTHING_COMMON, best)
    if too_wide(own, range_m, asked) or best.corners < asked.least_corners:
        return Unknown(Why.UNCONSTRAINED, best)
    if too_wide(covariance, range_m, asked):
        return Unknown(Why.AMBIGUOUS, best)
    return best


def too_wide(
    covariance: Array,
    range_m: float,
    asked: Settings,
) -> bool:
    """Return whether a pose with this covariance (4, 4) is of no use."""
    widest = math.sqrt(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    yaw_sigma = math.sqrt(float(covariance[3, 3]))
    return widest > asked.most_sigma * range_m or yaw_sigma > asked.most_yaw_sigma_rad


def stated(place: Place, range_m: float) -> Array:
    """Return a place's covariance (4, 4) of translation and yaw, with what no residual shows."""
    covariance = place.covariance[np.ix_(FOUR, FOUR)].copy()
    covariance[:3, :3] += (ERROR_OF_RANGE * range_m) ** 2 * np.eye(3)
    covariance[3, 3] += ERROR_OF_YAW_RAD**2
    return covariance


def log_mass(
    place: Place,
    known: Known,
    unsure: float,
) -> float:
    """Return the logarithm of a place's probability but for a constant: prior and likelihood where
    it is highest, times the room around it. ``unsure``: log-likelihood ratios are divided by it.
    """
    off_t = place.t - known.t
    off_yaw = math.remainder(place.yaw_rad - known.yaw, math.tau)
    before = -0.5 * (float(known.of_t @ off_t**2) + known.of_yaw * off_yaw**2)
    _, room = np.linalg.slogdet(place.covariance)
    return place.gain / unsure + before + 0.5 * float(room)
