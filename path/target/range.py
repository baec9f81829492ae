"""The range of a target from everything that tells one: which ranges there are, and what they are
worth together.

A range is along the optical axis of one camera, to the surface of the target at the middle of its
box: where a depth camera has it. With ``z`` the range and ``s`` its standard deviation, lasting
errors included:

- *Depth* over the box (``path.target.place``): noise that grows with the square of the distance,
  and a scale that is off by ``DEPTH_SHARE``.
- *Size*: a body of known size is as far away as its box is small. Each side ``i`` of the box, of
  ``b_i`` pixels, gives ``z = f a_i / b_i``, where ``a_i`` is what an upright cylinder of the body's
  span and height fills (``reach_m``). How much less a body fills than its cylinder depends on how
  it heads: ``USUAL_SPAN`` of the span, give or take ``SPAN_SIGMA``. What hides a part of it makes
  the range too long.
- *Ground*: the line of sight comes down to the height of the target's middle. With ``h`` from there
  up to the camera, and a ray that sinks by ``d`` and goes ``l`` along the ground for every metre of
  the optical axis, ``z = h / d``, and ``s^2 = (s_h / d)^2 + (z l / d * s_angle)^2``. The height is
  the drone's own, or a rangefinder's.

Ranges that are given are held against each other. For a set of ``n`` of them with the weighted mean
``m``, ``chi2 = sum (z - m)^2 / s^2`` has ``n - 1`` degrees of freedom. The largest set with a chi2
that happens to one in a thousand is believed, and of equally large ones the surest; the others are
told of as contradicted. Where those that are contradicted are as many as those that are believed,
nobody knows which are right: the variance then holds both. A size that is farther off than all
others is no such witness: a part of the target is hidden. Nothing here has a unit: a world so many
times as large decides the same.

Pure: D1's follower calls it for each frame (``flight.tracking.ranging``), and the plan beforehand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

from path.camera.model import CameraModel
from path.messages import Vec3
from path.observations import Box, Depth, RangeSource
from path.target.cylinder import AT_THE_CAMERA, behind_m, off_middle, reach_m
from path.target.monocular import tells_size
from path.values import value

DEPTH_SHARE = 0.01  # the scale of a depth camera (docs/errors.md)
USUAL_SPAN = 0.88  # of its diagonal, what a body up to twice as long as wide shows as it turns
SPAN_SIGMA = 0.18
HEIGHT_SIGMA = 0.05  # of a body's height in its box: it steps, bends, carries something
LEAST_DESCENT = 0.2  # of a line of sight, per metre along the optical axis
CHI2 = (0.0, 10.83, 13.82, 16.27, 18.47)  # one in a thousand, by degrees of freedom


@value
class Body:
    """The upright cylinder that the target fits into, whichever way it heads. 0: not known."""

    span_m: float = 0.0
    height_m: float = 0.0

    @property
    def known(self) -> bool:
        return self.span_m > 0.0


UNKNOWN = Body()


@value
class Sight:
    """The line of sight to a box's middle, per metre along the optical axis.

    Attributes:
        ray_c: right, down and 1, in the camera's frame.
        gravity_c: unit vector of gravity there.
    """

    ray_c: Vec3
    gravity_c: Vec3

    @property
    def sinking(self) -> float:
        """Return by how much it comes down."""
        return sum(a * b for a, b in zip(self.ray_c, self.gravity_c, strict=True))

    @property
    def level(self) -> float:
        """Return how far it goes along the ground."""
        x, y, z = self.ray_c
        return math.sqrt(max(0.0, x * x + y * y + z * z - self.sinking**2))


@value
class Ranged:
    """What all ranges together say.

    Attributes:
        depth: the range, and what most of it rests on.
        by: all that it rests on, the surest first.
        against: what contradicts that, and is not believed.
        chi2: of the contradicted one that is the farthest off, against those that are believed; 0
            without any.
    """

    depth: Depth
    by: tuple[RangeSource, ...]
    against: tuple[RangeSource, ...] = ()
    chi2: float = 0.0


def by_size(
    box: Box,
    camera: CameraModel,
    sight: Sight,
    body: Body,
    pixel_sigma_px: float,
) -> Depth | None:
    """Return the range of a body of known size.

    None for a box that the image cuts or that is too small.
    """
    if not (body.known and tells_size(box, camera)):
        return None
    flat_wide, flat_high = reach_m(AT_THE_CAMERA, sight.ray_c, sight.gravity_c, body.span_m, 0.0)
    tall_wide, tall_high = reach_m(AT_THE_CAMERA, sight.ray_c, sight.gravity_c, 0.0, body.height_m)
    sides = (
        (camera.fx / box.w, box.w, flat_wide, tall_wide),
        (camera.fy / box.h, box.h, flat_high, tall_high),
    )
    total = weighted = 0.0
    for per_m, side_px, flat_m, tall_m in sides:
        usual_m = USUAL_SPAN * flat_m + tall_m
        of_body = math.hypot(SPAN_SIGMA * USUAL_SPAN * flat_m, HEIGHT_SIGMA * tall_m) / usual_m
        # an edge's noise is 1.4 times a centre's, a side's twice
        of_pixels = 2.0 * pixel_sigma_px / side_px
        weight = 1.0 / (of_body**2 + of_pixels**2)
        weighted += weight * math.log(per_m * usual_m)
        total += weight
    middle_z_m = math.exp(weighted / total)
    return _of_surface(middle_z_m, middle_z_m / math.sqrt(total), sight, body, RangeSource.SIZE)


def by_ground(
    above_m: float,
    above_sigma_m: float,
    angle_sigma_rad: float,
    sight: Sight,
    body: Body,
    source: RangeSource,
) -> Depth | None:
    """Return the range at which a line of sight comes down to the target's middle.

    None where it hardly does.

    Args:
        above_m: from the target's middle up to the camera, with its standard deviation.
        angle_sigma_rad: of the line of sight against gravity.
        body: where its size is known, it is reckoned with that a box's middle is not the body's.
    """
    sinking = sight.sinking
    if sinking < LEAST_DESCENT or not above_m > 0.0:
        return None
    z_m = above_m / sinking
    if body.known:
        # the point in the box's middle is so much above or below the body's, at this depth
        x, y, z = (z_m * each for each in sight.ray_c)
        off_c = off_middle((x, y, z), sight.gravity_c, body.span_m, body.height_m)
        z_m += sum(a * b for a, b in zip(off_c, sight.gravity_c, strict=True)) / sinking
    of_angle_m = z_m * sight.level / sinking * angle_sigma_rad
    sigma_m = math.hypot(above_sigma_m / sinking, of_angle_m)
    return _of_surface(z_m, sigma_m, sight, body, source)


def together(ranges: Sequence[Depth]) -> Ranged | None:
    """Fuse all ranges that do not contradict one another; None when there is none.

    One alone comes back as it is.
    """
    given = [each for each in ranges if _sound(each)]
    if len(given) <= 1:
        return Ranged(given[0], (given[0].source,)) if given else None
    witnesses = [each for each in given if not _hides(each, given)]
    best = max(
        _consistent(witnesses), key=lambda chosen: (len(chosen), -_mean(witnesses, chosen)[1])
    )
    return _fused(given, witnesses, best)


def _hides(one: Depth, given: Sequence[Depth]) -> bool:
    """Return whether size says that the target is farther off than all else has it.

    Then a part of it is hidden.
    """
    others = [each for each in given if each.source is not RangeSource.SIZE]
    if one.source is not RangeSource.SIZE or not others:
        return False
    return all(
        one.z_m > each.z_m
        and (one.z_m - each.z_m) ** 2 > CHI2[1] * (variance_of(one) + variance_of(each))
        for each in others
    )


def _sound(one: Depth) -> bool:
    return math.isfinite(one.z_m + one.sigma_m) and one.z_m > 0.0 and one.sigma_m >= 0.0


def variance_of(one: Depth) -> float:
    """Return the variance of a range with the errors in it that last, m2."""
    lasting_m = DEPTH_SHARE * one.z_m if one.source is RangeSource.DEPTH else 0.0
    return max(one.sigma_m**2 + lasting_m**2, 1e-12 * one.z_m**2)


def _consistent(given: Sequence[Depth]) -> list[tuple[int, ...]]:
    """Return every set of ranges that do not contradict one another, by indices.

    Single ones always.
    """
    found: list[tuple[int, ...]] = [(k,) for k in range(len(given))]
    for size in range(2, len(given) + 1):
        limit = CHI2[min(size - 1, len(CHI2) - 1)]
        found += [
            chosen
            for chosen in combinations(range(len(given)), size)
            if _chi2(given, chosen) <= limit
        ]
    return found


def _mean(given: Sequence[Depth], chosen: Sequence[int]) -> tuple[float, float]:
    """Return the weighted mean and its variance."""
    weights = [1.0 / variance_of(given[k]) for k in chosen]
    total = sum(weights)
    mean_m = sum(weight * given[k].z_m for weight, k in zip(weights, chosen, strict=True)) / total
    return mean_m, 1.0 / total


def _chi2(given: Sequence[Depth], chosen: Sequence[int]) -> float:
    mean_m, _ = _mean(given, chosen)
    return sum((given[k].z_m - mean_m) ** 2 / variance_of(given[k]) for k in chosen)


def _fused(
    given: Sequence[Depth],
    witnesses: Sequence[Depth],
    chosen: Sequence[int],
) -> Ranged:
    mean_m, variance = _mean(witnesses, chosen)
    believed = sorted((witnesses[k] for k in chosen), key=variance_of)
    others = [each for k, each in enumerate(witnesses) if k not in chosen]
    against = [each for each in given if each not in believed]
    chi2 = max(
        ((each.z_m - mean_m) ** 2 / (variance_of(each) + variance) for each in against), default=0.0
    )
    if len(others) >= len(chosen):
        # as many say the opposite: the mean square about this one, as likely as not to be the wrong
        # one
        about = [variance_of(each) + (each.z_m - mean_m) ** 2 for each in others]
        variance = 0.5 * (variance + sum(about) / len(about))
    by = tuple(each.source for each in believed)
    depth = Depth(mean_m, math.sqrt(variance), by[0])
    return Ranged(depth, by, tuple(each.source for each in against), chi2)


def _of_surface(
    z_m: float,
    sigma_m: float,
    sight: Sight,
    body: Body,
    source: RangeSource,
) -> Depth:
    """Return a range to the body's middle as one to its surface, where its size is known."""
    if not body.known:
        return Depth(z_m, sigma_m, source)
    x, y, z = sight.ray_c
    per_m = math.sqrt(x * x + y * y + z * z)
    nearer_m = behind_m(sight.sinking / per_m, body.span_m, body.height_m) / per_m
    return Depth(max(z_m - nearer_m, 0.5 * z_m), sigma_m, source)
