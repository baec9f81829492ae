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

A side is as uncertain as an object may have turned since it was seen. Where a box holds somebody
else, whom no other box shows, what it is larger by is that one's: d is all that exceeds the
sides that were known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from path.belief.motion import Array, Motion
from path.belief.track import ObjectTrack
from path.values import value

# standard deviations of a side's logarithm: what is farther off has more in its box, or less
FITS = 2.0
_SIZE_TAIL = 3.0
_SIZE_DENSITY = 0.5  # of a side's logarithm, of anything: between 1 / e and e times as large
# the share of an axis' variance with which a measurement along it counts for nothing
_NOTHING = 1e-4
_NOWHERE_ELSE = np.zeros((3, 3))


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


@dataclass(frozen=True, slots=True)
class Fit:
    """A measurement, if it is of a track's object.

    Attributes:
        within_m2: covariance (3, 3) of the object's middle in its box, beside the box's own noise.
            It is bounded: a box may err more than its noise has it, but an object is inside its
            box.
        noise_m2: what the track is updated with.
        larger: whether something else is in its box.
    """

    within_m2: Array
    noise_m2: Array
    larger: bool


def fit_of(track: ObjectTrack, measured: Measured, *, shared: bool = False) -> Fit:
    """Return how a measurement is of a track's object. ``shared``: another one that is not shown is
    in its box too, so that what it is larger by than the object was is that one's: the object need
    not have turned.
    """
    sides = np.asarray(measured.sides_m)
    turned = 0.0 if shared else track.size_variance
    factor = math.exp(FITS * math.sqrt(turned + measured.side_sigma**2))
    expected = np.minimum(np.exp(track.log_sides), measured.most_m)
    more = np.maximum(sides - np.minimum(factor * expected, measured.most_m), 0.0)
    beyond = np.maximum(expected / factor - sides, more)
    if more.any():  # it may be as small as that, anywhere in there
        beyond = np.maximum(sides - expected / factor, beyond)
    if not beyond.any():
        return Fit(_NOWHERE_ELSE, measured.covariance_m2, larger=False)
    noise = measured.covariance_m2 + _bounded(track.motion, beyond, measured.axes)
    return Fit(within(beyond, measured.axes), noise, bool(more.any()))


def size_fits(track: ObjectTrack, measured: Measured) -> float:
    """Return how much likelier the sides of a box are, if it is of this track's object, than of
    anything.
    """
    variance = track.size_variance + measured.side_sigma**2
    off = np.log(measured.sides_m) - track.log_sides
    tails = (1.0 + off * off / (variance * _SIZE_TAIL)) ** (-0.5 * (_SIZE_TAIL + 1.0))
    return float(np.prod(0.3675 / math.sqrt(variance) * tails)) / _SIZE_DENSITY**2


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
    spread = math.exp(FITS * math.sqrt(track.size_variance + measured.side_sigma**2))
    return bool(np.all(covered <= np.minimum(expected * spread, measured.most_m)))


def inside(motion: Motion, measured: Measured, sigmas: float = 0.0) -> bool:
    """Return whether an object is seen in a box, by its direction and at any range, or may be
    within so many standard deviations.
    """
    times = _times_as_far(motion.place_m, measured)
    if not times > 0.0:
        return False
    across = measured.axes[:, :2]
    seen_m = measured.eye_m + (motion.place_m - measured.eye_m) / times
    off = np.abs(across.T @ (seen_m - measured.place_m))
    spread = np.sqrt(np.diag(across.T @ motion.place_covariance_m2 @ across)) / times
    return bool(np.all(off <= 0.5 * np.asarray(measured.sides_m) + sigmas * spread))


def hold(motion: Motion, measured: Measured) -> None:
    """Keep an object in a box that is another one's: in its direction, at any range."""
    times = max(_times_as_far(motion.place_m, measured), 1e-9)
    wide, high = measured.sides_m
    ahead = measured.axes[:, 2]
    known_m = math.sqrt(float(ahead @ motion.place_covariance_m2 @ ahead))
    bounds = _bounded(motion, np.array([times * wide, times * high, 2.0 * known_m]), measured.axes)
    place_m = measured.eye_m + times * (measured.place_m - measured.eye_m)
    motion.update(place_m, measured.covariance_m2 + bounds)


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
    left = np.maximum(known - bounds, _NOTHING * bounds + 1e-12)
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
