"""Checks of what the drones see: whether the target is large enough, near enough and apart from
others for D1, and whether D2 has a place from which it sees marker and target.

Each takes what is flown and returns a Problem or None.
"""

from __future__ import annotations

import math
from dataclasses import replace

from flight.plan.errors import predict
from flight.plan.facts import Eye, Facts
from flight.plan.flown import Flown, Problem, along, at, has_viewpoint, placed
from flight.plan.geometry import apparent, depression_rad, tilts
from flight.plan.least_change import least, most
from flight.plan.ranging import range_of
from flight.rendezvous.viewpoint import NoViewpoint, Viewpoint
from path.camera.model import CameraModel

# of a box's shorter side: detectors lose objects below it (docs/detectors.md)
LEAST_TARGET_PX = 20.0
# of the target's box: boxes that lasting errors put farther apart do not overlap enough
MOST_OFFSET = 0.2
MOST_DEPTH_SIGMA = 1.0 / 3.0  # of the target's diameter
IN_WIND = 0.5  # of the margin to D2's image border: the rest is what wind may take


def target_px(of: Flown) -> Problem | None:
    seen = apparent(of.facts, of.range_m)
    if seen.short_px >= LEAST_TARGET_PX:
        return None
    nearer_m = of.range_m * seen.short_px / LEAST_TARGET_PX
    focal_px = of.facts.sender.camera.fx * LEAST_TARGET_PX / seen.short_px
    return Problem(
        "mission.follow",
        f"the target is {seen.short_px:.0f} px at the {of.range_m:.1f} m that D1 follows it from;"
        f" detectors need {LEAST_TARGET_PX:.0f}",
        f"{nearer_m:.1f} m would do, or f {focal_px:.0f} px",
    )


def fits(of: Flown) -> Problem | None:
    """Check that the whole target is inside D1's image."""
    camera = of.facts.sender.camera
    seen = apparent(of.facts, of.range_m)
    widest = max(seen.width_px / camera.width, seen.height_px / camera.height)
    if widest <= 1.0:
        return None
    return Problem(
        "mission.follow",
        f"the target fills {100.0 * widest:.0f} % of D1's image from {of.range_m:.1f} m",
        f"{of.range_m * widest * 1.15:.1f} m would do",
    )


def depth(of: Flown) -> Problem | None:
    """Check that D1's depth camera reaches the target, or something else tells how far away it
    is.
    """
    method = of.facts.method
    range_m = of.range_m
    if range_of(of.facts, range_m) is not None:
        return None
    return Problem(
        "mission.follow",
        f"the target is {range_m:.1f} m from D1's camera; depth is trusted from {method.min_depth_m:g} m to"
        f" {method.max_depth_m:g} m ([depth] min_m and max_m)",
        _within_reach(of),
    )


def _within_reach(of: Flown) -> str:
    """Return what would bring a target within reach of something that tells its range."""
    method = of.facts.method
    range_m = of.range_m
    nearer_m = min(max(range_m, method.min_depth_m), method.max_depth_m)
    ways: list[str] = []
    if fits(at(of.facts, of.mission, along(of, nearer_m / range_m))) is None:
        ways.append(f"{nearer_m:.1f} m")
    if range_m > method.max_depth_m:
        ways.append(f"[depth] max_m = {range_m:.1f}")
        if not of.facts.target.flies and _hides_m(of) <= of.facts.target.span_m:
            up_m = math.ceil(1.2 * of.mission.follow.height_m)
            ways.append(f"a rangefinder ([height] rangefinder_max_m = {up_m:d})")
    return f"{', or '.join(ways)} would do"


def behind(of: Flown) -> Problem | None:
    """Check that depth tells the target from what is right behind it, which a detector may put into
    one box with it.
    """
    method = of.facts.method
    span_m = of.facts.target.span_m
    sigma_m = method.depth_sigma_at_1m_m * of.range_m**2
    most_m = MOST_DEPTH_SIGMA * span_m
    if of.range_m > method.max_depth_m:
        return _behind_without_depth(of)
    if sigma_m <= most_m or of.range_m < method.min_depth_m:
        return None
    nearer_m = of.range_m * math.sqrt(most_m / sigma_m)
    better_m = method.depth_sigma_at_1m_m * most_m / sigma_m
    return Problem(
        "depth.sigma_at_1m_m",
        f"depth errs by {sigma_m:.2f} m at the {of.range_m:.1f} m that D1 follows from; the target is {span_m:.2f} m"
        " across: it cannot be told from what is right behind it",
        f"{nearer_m:.1f} m would do, or a depth.sigma_at_1m_m of {better_m:.2g} m",
    )


def _behind_without_depth(of: Flown) -> Problem | None:
    """Check that, where ranges are of a whole box, nothing fits into a target's box behind it.

    Of two in one box the range by ground or size is of neither.
    """
    target = of.facts.target
    hides_m = _hides_m(of)
    if range_of(of.facts, of.range_m) is None or target.flies or hides_m <= target.span_m:
        return None
    return Problem(
        "mission.follow",
        f"the target is {of.range_m:.1f} m from D1's camera, and depth is trusted up to"
        f" {of.facts.method.max_depth_m:g} m: ground and size tell the range of a whole box only, and whoever stands"
        f" up to {hides_m:.1f} m behind a target {target.height_m:.2f} m high and {target.span_m:.2f} m across is in"
        " its box",
        _within_reach(of),
    )


def _hides_m(of: Flown) -> float:
    """Return how far behind its own place the target hides the ground from D1."""
    return of.facts.target.height_m / math.tan(depression_rad(of.facts))


def viewpoint(of: Flown) -> Problem | None:
    """Check that there is a place for D2, level and in the wind."""
    none = of.placed.viewpoint
    if isinstance(none, Viewpoint):
        return _viewpoint_in_wind(of)
    said = f"no place for D2: {_main_reason(none)}"
    side_m = least(
        of.facts.marker_side_m,
        10.0,
        lambda side_m: has_viewpoint(replace(of, facts=of.facts.with_side(side_m))),
    )
    ways: list[str] = []
    if side_m is not None:
        ways.append(f"a plate of {_mm(side_m)} would do")
    focal = least(
        1.0, 10.0, lambda times: has_viewpoint(replace(of, facts=_zoomed(of.facts, times)))
    )
    if focal is not None:
        ways.append(f"f {of.facts.receiver.camera.fx * focal:.0f} px of D2's camera")
    farther = least(
        1.0, 10.0, lambda times: has_viewpoint(at(of.facts, of.mission, along(of, times)))
    )
    if farther is not None:
        ways.append(f"D1 {farther * of.range_m:.1f} m from the target")
    return Problem("mission.rendezvous", said, ", or ".join(ways))


def _main_reason(none: NoViewpoint) -> str:
    name, count = max(none.rejected.items(), key=lambda each: each[1])
    total = sum(none.rejected.values())
    return f"{count} of {total} places are given up as '{name}'"


def _viewpoint_in_wind(of: Flown) -> Problem | None:
    """Check that a steady wind, from wherever, leaves D2 a viewpoint: it tilts D2 and its
    camera.
    """
    wind_mps = of.facts.site.wind_mps
    if sees_both(of, wind_mps):
        return None
    borne_mps = most(0.0, wind_mps, lambda speed_mps: sees_both(of, speed_mps))
    tilt_deg = of.facts.drone.tilt_per_mps_deg * wind_mps
    return Problem(
        "site.wind_mps",
        f"a wind of {wind_mps:g} m/s tilts D2 by {tilt_deg:.0f} deg, and its fixed camera with it: from some"
        " directions no place keeps marker and target in view",
        f"{borne_mps:.1f} m/s can be borne" if borne_mps > 0.0 else "",
    )


def sees_both(of: Flown, wind_mps: float) -> bool:
    """Return whether D2 has a viewpoint in a wind from each of eight directions."""
    angle = math.radians(of.facts.drone.tilt_per_mps_deg * wind_mps)
    found = [
        placed(of.facts, of.mission, of.placed.target_h, share=IN_WIND, tilt_h=tilt)
        for tilt in tilts(angle)
    ]
    return all(isinstance(each.viewpoint, Viewpoint) for each in found)


def _zoomed(facts: Facts, times: float) -> Facts:
    """Return facts with more focal length in D2's camera, and as many more pixels: the same field
    of view.
    """
    lens = facts.receiver.camera
    camera = CameraModel(
        round(times * lens.width),
        round(times * lens.height),
        times * lens.fx,
        times * lens.fy,
        times * lens.cx,
        times * lens.cy,
        lens.distortion,
    )
    return replace(facts, receiver=Eye(camera, facts.receiver.mount, facts.receiver.rate_hz))


def _mm(length_m: float) -> str:
    return f"{math.ceil(1000.0 * length_m - 1e-6):d} mm"


def offset(of: Flown) -> Problem | None:
    """Check that errors that last leave both boxes over each other."""
    if not isinstance(of.placed.viewpoint, Viewpoint) or _overlap(of):
        return None
    expected = predict(of.facts, of.placed)
    most_m = _most_offset_m(of)
    worst = max(expected.sources, key=lambda source: source.sigma_m)
    share = most(0.0, 1.0, lambda share: _overlap(at(of.facts, of.mission, along(of, share))))
    return Problem(
        "method",
        f"errors that last put D2's box {expected.offset_sigma_m:.2f} m off, most of it by {worst.name}"
        f" ({worst.sigma}: {worst.sigma_m:.2f} m); the views of a target of this size agree up to {most_m:.2f} m",
        f"{share * of.range_m:.1f} m from the target would do" if share > 0.0 else "",
    )


def _most_offset_m(of: Flown) -> float:
    seen = apparent(of.facts, of.range_m)
    return MOST_OFFSET * min(seen.width_m, seen.height_m)


def _overlap(of: Flown) -> bool:
    """Return whether there is a viewpoint from which lasting errors leave both boxes over each
    other.
    """
    if not isinstance(of.placed.viewpoint, Viewpoint):
        return False
    return predict(of.facts, of.placed).offset_sigma_m <= _most_offset_m(of)


def latency(of: Flown) -> Problem | None:
    """Check that D2 can still tell where the target is when D1's word of it comes late."""
    if not isinstance(of.placed.viewpoint, Viewpoint):
        return None
    method = of.facts.method
    link = of.facts.link
    searched_px = _searched_px(of, link.latency_s)
    if searched_px <= method.max_search_px:
        return None
    most_s = most(
        0.0, link.latency_s, lambda late_s: _searched_px(of, late_s) <= method.max_search_px
    )
    return Problem(
        "link.latency_s",
        f"what D1 says comes {link.latency_s:g} s late: D2 would have to search {searched_px:.0f} px around the target;"
        f" method.max_search_px is {method.max_search_px:g}",
        f"{most_s:.2f} s would do" if most_s > 0.0 else "",
    )


def _searched_px(of: Flown, late_s: float) -> float:
    """Return the half side of D2's search when the target is foretold over a latency and half of it
    again.
    """
    method = of.facts.method
    foretold_m = 0.5 * method.relative_accel_mps2 * (1.5 * late_s) ** 2
    focal_px = of.facts.receiver.camera.fx
    return method.search_sigmas * focal_px * foretold_m / of.placed.receiver_range_m


def nearest_told_apart_m(of: Flown) -> float:
    """Return how near to the target a look-alike may be for the boxes to tell them apart, m; NaN
    without a viewpoint.

    A likelihood ratio of 1 / alpha between an offset of 0 and one of d, with standard deviation s,
    asks for d = s sqrt(2 ln(1 / alpha)).
    """
    if not isinstance(of.placed.viewpoint, Viewpoint):
        return math.nan
    sigma_m = predict(of.facts, of.placed).offset_sigma_m
    return sigma_m * math.sqrt(2.0 * math.log(1.0 / of.facts.method.evidence.alpha))
