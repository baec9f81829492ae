"""What a box says of an object: where its middle is, how large it is, and whether it is alone in
there.

A box is a measurement of its object's place. Its noise is what the rig states for such a box at
its own range. Where the box is larger than its object, something else is in it; where it is
smaller, a part of the object is hidden or outside the image. Either way the object's middle is
within half the difference d of the sides:

    R = R_box + (d/2)^2    along each side

That stays off for as long as it lasts, so that many frames say no more than one: a place is
never known better by it than to d/2, and one that is known better already is told nothing. One
box may so be of two objects: whoever is expected inside a box that is assigned to another, by
its direction and at any range, is held by it, and not missed.

Of such a box each edge is of the one that surely reaches farthest there, and gives its middle,

    middle = edge -+ side / 2

and its depth is of the one that is surely the nearest, or else of the one whose the box surely is.
Where neither is known, an object is anywhere in the box, at the range at which it was. An edge that
the image's border cuts is of nobody, and its side a lower bound: P(side >= box) takes the place of
the density of the side, and nothing smaller is learnt from it.

A side is as uncertain as an object may have turned since it was seen. Where a box holds somebody
else, whom no other box shows, what it is larger by is that one's: d is all that exceeds the
sides that were known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from path.belief.motion import Array, Motion
from path.belief.track import ObjectTrack
from path.compiled import kernel
from path.values import value

# standard deviations of a side's logarithm: what is farther off has more in its box, or less
FITS = 2.0
# of the order of two in an image, from which on an edge of their box is of the one that reaches
# farther there
_SURE = 3.0
UNKNOWN_SIZE = 1.0  # variance of a side's logarithm
_SIZE_TAIL = 3.0
_SIZE_DENSITY = 0.5  # of a side's logarithm, of anything: between 1 / e and e times as large
# the share of an axis' variance with which a measurement along it counts for nothing
_NOTHING = 1e-4
_NOWHERE_ELSE = np.zeros((3, 3))
_WHOLE = ((False, False), (False, False))


@value
class Measured:
    """A box as a measurement of a place in the local frame.

    Attributes:
        place_m: shape (3,). covariance_m2: (3, 3), of the frame's noise.
        eye_m: (3,) place of the camera.
        axes: (3, 3) rotation of the camera in the local frame; columns right, down, ahead.
        sides_m: width and height of the box at its range.
        side_sigma: standard deviation of either side's logarithm.
        most_m: the largest sides that a box of the target alone can have there; infinite where that
            is not known.
        elsewhere_m3: density per m^3 of boxes of nothing that is known, inventions among them.
        newcomers_m3_s: of objects that come into view, per m^3 and s.
        cut_edges: whether the image's border cuts it where its width and its height begin, and
            where they end.
    """

    place_m: Array
    covariance_m2: Array
    eye_m: Array
    axes: Array
    sides_m: tuple[float, float]
    side_sigma: float
    most_m: tuple[float, float]
    elsewhere_m3: float
    newcomers_m3_s: float
    cut_edges: tuple[tuple[bool, bool], tuple[bool, bool]] = _WHOLE

    @property
    def cut(self) -> tuple[bool, bool]:
        """Return whether its width is cut, and its height: the object is larger."""
        (left, top), (right, bottom) = self.cut_edges
        return left or right, top or bottom


@dataclass(frozen=True, slots=True)
class Fit:
    """A measurement, if it is of a track's object.

    Attributes:
        place_m: (3,) of the object's middle.
        within_m2: covariance (3, 3) of that, beside the box's own noise. It is bounded: a box may
            err more than its noise has it, but an object is inside its box.
        noise_m2: what the track is updated with.
        larger: whether something else is in its box.
    """

    place_m: Array
    within_m2: Array
    noise_m2: Array
    larger: bool


def fit_of(
    track: ObjectTrack,
    measured: Measured,
    others: Sequence[ObjectTrack] = (),
    *,
    its_own: bool = True,
) -> Fit:
    """Return how a measurement is of a track's object.

    Args:
        others: those who are in its box too, and not shown otherwise: what it is larger by than the
            object was is theirs, and the object need not have turned.
        its_own: the box is surely of this one, rather than of one of those.
    """
    turned = 0.0 if others else 1.0
    beyond, larger = _beyond(
        track.log_sides, turned * track.size_variances, measured.sides_m, measured.side_sigma, measured.most_m,
    )  # fmt: skip
    if others and larger:
        return held(track, measured, others, beyond, its_own=its_own)
    if not beyond.any():
        return Fit(measured.place_m, _NOWHERE_ELSE, measured.covariance_m2, larger=False)
    noise = measured.covariance_m2 + _bounded(track.motion, beyond, measured.axes)
    return Fit(measured.place_m, within(beyond, measured.axes), noise, larger)


@kernel
def _beyond(
    log_sides: Array,
    variances: Array,
    sides_m: tuple[float, float],
    side_sigma: float,
    most_m: tuple[float, float],
) -> tuple[Array, bool]:
    """Return by how much the sides of a box are off those of an object, and whether it is larger."""
    beyond = np.empty(2)
    smallest = np.empty(2)
    larger = False
    for k in range(2):
        factor = math.exp(FITS * math.sqrt(variances[k] + side_sigma**2))
        expected = min(math.exp(log_sides[k]), most_m[k])
        smallest[k] = expected / factor
        more = max(sides_m[k] - min(factor * expected, most_m[k]), 0.0)
        beyond[k] = expected - sides_m[k] if smallest[k] > sides_m[k] else more
        larger |= more > 0.0
    if larger:  # it may be as small as that, anywhere in there
        for k in range(2):
            beyond[k] = max(sides_m[k] - smallest[k], beyond[k])
    return beyond, larger


def held(
    track: ObjectTrack,
    around: Measured,
    others: Sequence[ObjectTrack],
    beyond_m: Array,
    *,
    its_own: bool = False,
) -> Fit:
    """Return what a box with more than one object in it says of one of them.

    It is in that direction, where an edge is surely its own; how far off, the box says of the
    nearest.

    Args:
        others: who else is in it; none where the box is as large as one, and hides the object.
        beyond_m: by how much its middle is unknown, right and down, where no edge is its own.
        its_own: the box is of this one, which is the nearest unless another surely is.
    """
    motion = track.motion
    ahead = around.axes[:, 2]
    known_m2 = float(ahead @ motion.place_covariance_m2 @ ahead)
    shift, beyond = _parted(track, around, others, beyond_m)
    nearer = [_nearer(motion, other.motion, ahead) for other in others]
    surely = bool(nearer) and min(nearer) > _SURE
    if surely or (its_own and min(nearer) > -_SURE):
        times = 1.0
        beyond = np.append(beyond, max(beyond_m))
    else:
        times = max(_times_as_far(motion.place_m, around), 1e-9)
        beyond = np.append(beyond, 2.0 * math.sqrt(known_m2) / times)
    middle_m = around.place_m + around.axes[:, :2] @ shift
    place_m = around.eye_m + times * (middle_m - around.eye_m)
    noise_m2 = around.covariance_m2 + _bounded(motion, times * beyond, around.axes)
    return Fit(place_m, within(times * beyond, around.axes), noise_m2, larger=True)


def _nearer(one: Motion, other: Motion, ahead: Array) -> float:
    """Return by how many standard deviations one object is nearer than another."""
    behind_m = float(ahead @ (other.place_m - one.place_m))
    unsure_m2 = float(ahead @ (one.place_covariance_m2 + other.place_covariance_m2) @ ahead)
    return behind_m / math.sqrt(unsure_m2)


def _parted(
    track: ObjectTrack, measured: Measured, others: Sequence[ObjectTrack], beyond_m: Array
) -> tuple[Array, Array]:
    """Return what an object's middle is off the middle of a box around it and others, right and
    down, and by how much that is unknown, all at the box's range.
    """
    low, high, variances = _edges(track, measured)
    first, last = ~np.asarray(measured.cut_edges) & bool(others)
    for other in others:
        low_other, high_other, variances_other = _edges(other, measured)
        unsure = _SURE * np.sqrt(variances + variances_other)
        first &= low + unsure < low_other
        last &= high - unsure > high_other
    own = high - low
    off = 0.5 * (np.asarray(measured.sides_m) - own)
    shift = np.where(first ^ last, off * (last.astype(float) - first.astype(float)), 0.0)
    known = own * np.sqrt(track.size_variances) + np.where(first & last, np.abs(off), 0.0)
    return shift, np.where(first | last, np.minimum(known, beyond_m), beyond_m)


def _edges(track: ObjectTrack, measured: Measured) -> tuple[Array, Array, Array]:
    """Return where an object's box is expected to begin and end, right and down of a box's middle
    at its range, and the variance of either.
    """
    times = max(_times_as_far(track.motion.place_m, measured), 1e-9)
    across = measured.axes[:, :2]
    middle = _beside(track.motion.place_m, measured, times)
    half = 0.5 * track.sides_m(measured.most_m) / times
    known = np.einsum("ij,ik,kj->j", across, track.motion.place_covariance_m2, across)
    return middle - half, middle + half, known / times**2 + half**2 * track.size_variances


def size_fits(track: ObjectTrack, measured: Measured) -> float:
    """Return how much likelier the sides of a box are, if it is of this track's object, than of
    anything: with Student's density of each, or, of one that is cut, the probability that the
    object is as large as that.
    """
    return _likelier(
        track.log_sides, track.size_variances, measured.sides_m, measured.side_sigma, measured.cut
    )


@kernel
def _likelier(
    log_sides: Array,
    variances: Array,
    sides_m: tuple[float, float],
    side_sigma: float,
    cut: tuple[bool, bool],
) -> float:
    likelier = 1.0
    for k in range(2):
        sigma = math.sqrt(variances[k] + side_sigma**2)
        off = (math.log(sides_m[k]) - log_sides[k]) / (sigma * math.sqrt(_SIZE_TAIL))
        if cut[k]:
            likelier *= 0.5 - (off / (1.0 + off * off) + math.atan(off)) / math.pi
        else:
            tail = (1.0 + off * off) ** (-0.5 * (_SIZE_TAIL + 1.0))
            likelier *= 0.3675 / sigma * tail / _SIZE_DENSITY
    return likelier


def is_part(measured: Measured, track: ObjectTrack, taken: Measured | None) -> bool:
    """Return whether a box is of a track's object, a second time.

    It is when what it covers together with the box that the track has in this frame, or is expected
    to have, is no larger than that object.
    """
    if not track.confirmed:
        return False
    expected = track.sides_m(measured.most_m)
    place_m, sides = (
        (track.motion.place_m, expected)
        if taken is None
        else (taken.place_m, np.asarray(taken.sides_m))
    )
    off = np.abs(measured.axes[:, :2].T @ (place_m - measured.place_m))
    own = np.asarray(measured.sides_m)
    covered = np.maximum(np.maximum(sides, own), off + 0.5 * (sides + own))
    spread = np.exp(FITS * np.sqrt(track.size_variances + measured.side_sigma**2))
    return bool(np.all(covered <= np.minimum(expected * spread, measured.most_m)))


def inside(motion: Motion, measured: Measured) -> float:
    """Return how likely an object is seen in a box, by its direction, at any range."""
    times = _times_as_far(motion.place_m, measured)
    if not times > 0.0:
        return 0.0
    off = _beside(motion.place_m, measured, times)
    return _inside(off, motion.covariance, measured.axes, times, measured.sides_m)


@kernel
def _inside(
    off_m: Array, covariance: Array, axes: Array, times: float, sides_m: tuple[float, float]
) -> float:
    either = 1.0
    for k in range(2):
        across_m2 = 0.0
        for i in range(3):
            for j in range(3):
                across_m2 += axes[i, k] * covariance[i, j] * axes[j, k]
        spread = math.sqrt(2.0 * across_m2) / times
        half = 0.5 * sides_m[k]
        first = math.erf((half - off_m[k]) / spread)
        either *= 0.5 * (first + math.erf((half + off_m[k]) / spread))
    return either


def within(beyond_m: Array, axes: Array) -> Array:
    """Return the covariance (3, 3) of a middle that is within half of so much of a box's."""
    return (axes * _halves(beyond_m)) @ axes.T


def _bounded(motion: Motion, beyond_m: Array, axes: Array) -> Array:
    """Return what to add to a noise so that a place is known to half of so much afterwards, and no
    better.

    What is off stays off for as long as it lasts: however many frames say it, they are one. An axis
    along which the place is known better already is told nothing.
    """
    bounds = _halves(beyond_m)
    known = np.einsum("ij,ik,kj->j", axes, motion.place_covariance_m2, axes)
    left = np.maximum(known - bounds, _NOTHING * bounds + 1e-300)
    return (axes * (bounds * np.maximum(known, bounds) / left)) @ axes.T


def _halves(beyond_m: Array) -> Array:
    """Return the variances of a middle that is within half of so much, right, down and ahead: there
    by default as much as the larger one.
    """
    ahead_m = beyond_m[2] if len(beyond_m) > 2 else max(beyond_m)
    halves = 0.5 * np.array([beyond_m[0], beyond_m[1], ahead_m])
    return halves * halves


def _times_as_far(place_m: Array, measured: Measured) -> float:
    """Return how many times as far ahead of the camera as a box's middle a place is."""
    ahead = measured.axes[:, 2]
    box_m = float(ahead @ (measured.place_m - measured.eye_m))
    return float(ahead @ (place_m - measured.eye_m)) / box_m


def _beside(place_m: Array, measured: Measured, times: float) -> Array:
    """Return where a place so many times as far as a box is seen, right and down of the box's
    middle at its range.
    """
    seen_m = measured.eye_m + (place_m - measured.eye_m) / times
    return measured.axes[:, :2].T @ (seen_m - measured.place_m)
