"""What D1's range of the target will be worth: by depth, by the ground and by the target's size.
Pure.
"""

from __future__ import annotations

import math

from flight.plan.facts import Facts
from flight.plan.geometry import Floats, apparent, depression_rad
from path.observations import Box, Depth, RangeSource
from path.target.range import DEPTH_SHARE, Body, Ranged, Sight, by_ground, by_size, together

DEPTH_BIAS_M = 0.003  # docs/errors.md
# from take-off to the hand-over: so long a height without a rangefinder has drifted
FLOWN_MIN = 3.0


def range_of(facts: Facts, range_m: float) -> Ranged | None:
    """Return the range along D1's optical axis with what lasts of its errors; None where nothing
    tells it.

    Without ``[height]`` depth is all there is.
    """
    method = facts.method
    found: list[Depth] = []
    if method.min_depth_m <= range_m <= method.max_depth_m:
        found.append(Depth(range_m, DEPTH_BIAS_M))
    if facts.height is not None:
        found += [
            each
            for each in (_ground(facts, range_m), _size(facts, range_m, bool(found)))
            if each is not None
        ]
    # All are of one target: what they say is as far away as it is, and only their deviations
    # differ.
    return together([Depth(range_m, each.sigma_m, each.source) for each in found])


def lasting_m(facts: Facts, range_m: float, target_h: Floats) -> float:
    """Return the standard deviation of what lasts of the error of D1's range.

    Args:
        target_h: the target's middle, shape (3,).
    """
    by_depth_m = math.hypot(DEPTH_SHARE * range_m, DEPTH_BIAS_M)
    ranged: Ranged | None = None
    if facts.size_sigma > 0.0:
        by_size_m = facts.size_sigma * range_m
        by_height = _by_own_height(facts, range_m, target_h)
        found = [Depth(range_m, by_size_m, RangeSource.SIZE)]
        found += [] if by_height is None else [Depth(range_m, by_height.sigma_m)]
        ranged = together(found)
    elif range_m > facts.method.max_depth_m:
        ranged = range_of(facts, range_m)
    return by_depth_m if ranged is None else ranged.depth.sigma_m


def _by_own_height(facts: Facts, range_m: float, target_h: Floats) -> Depth | None:
    if facts.height_sigma_m <= 0.0:
        return None
    T_b_c = facts.sender.mount.T_b_c
    x, y, z = T_b_c.inverse().apply(target_h).tolist()
    gx, gy, gz = T_b_c.R[2].tolist()
    sight = Sight((x / z, y / z, 1.0), (gx, gy, gz))
    return _over_ground(facts, range_m, sight, facts.height_sigma_m, RangeSource.GROUND)


def _over_ground(
    facts: Facts, range_m: float, sight: Sight, known_m: float, source: RangeSource
) -> Depth | None:
    """Return the range by a height over the ground that is known so well, m."""
    pixels = facts.method.pixel_sigma_px / facts.sender.camera.fy
    angle = math.hypot(facts.attitude_sigma_rad, pixels)
    return by_ground(range_m * sight.sinking, known_m, angle, sight, _body(facts), source)


def _sight(facts: Facts) -> Sight:
    angle = depression_rad(facts)
    return Sight((0.0, 0.0, 1.0), (0.0, math.cos(angle), math.sin(angle)))


def _body(facts: Facts) -> Body:
    return Body(facts.target.span_m, facts.target.height_m)


def _ground(facts: Facts, range_m: float) -> Depth | None:
    height = facts.height
    if height is None or facts.target.flies:
        return None
    sight = _sight(facts)
    above_m = range_m * sight.sinking
    reaches = (
        height.rangefinder_min_m < above_m + 0.5 * facts.target.height_m < height.rangefinder_max_m
    )
    known_m = height.rangefinder_sigma_m if reaches else height.drift_m * math.sqrt(FLOWN_MIN)
    source = RangeSource.RANGEFINDER if reaches else RangeSource.GROUND
    return _over_ground(facts, range_m, sight, math.hypot(known_m, height.uneven_m), source)


def _size(facts: Facts, range_m: float, measured: bool) -> Depth | None:
    """Asked as in flight: only where there is no depth."""
    if measured:
        return None
    camera = facts.sender.camera
    seen = apparent(facts, range_m)
    left = camera.cx - 0.5 * seen.width_px
    top = camera.cy - 0.5 * seen.height_px
    box = Box(left, top, seen.width_px, seen.height_px)
    return by_size(box, camera, _sight(facts), _body(facts), facts.method.pixel_sigma_px)
