"""What a rig cannot do, found before anything moves, each with the smallest change that makes it
possible. Pure.

A check takes facts and geometry and returns a Problem or None. The smallest change is found by
asking the same check again with the fact changed, and halving what lies between what fails and what
passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from drivers.rig.parts import Rig
from drivers.rig.tables import Problems, decode_table
from flight.config import MissionConfig
from flight.guidance import Vec3, from_heading
from flight.plan.derive import GRAVITY_MPS2, MOST_WAY_OUT_M, way_out_m
from flight.plan.errors import predict
from flight.plan.facts import Eye, Facts, facts_of
from flight.plan.geometry import (
    Floats,
    Layout,
    apparent,
    depression_rad,
    followed_at,
    layout,
    tilts,
)
from flight.plan.ranging import range_of
from flight.rendezvous.viewpoint import NoViewpoint, Viewpoint
from flight.tracking.association import UNSEEN_S
from path.camera.model import CameraModel
from path.values import frozen

# of a box's shorter side: detectors lose objects below it (docs/detectors.md)
LEAST_TARGET_PX = 20.0
# of the target's box: boxes that lasting errors put farther apart do not overlap enough
MOST_OFFSET = 0.2
MOST_DEPTH_SIGMA = 1.0 / 3.0  # of the target's diameter
CATCH_UP = 1.15  # times the target's speed, to come closer at all
FRAMES_TO_FOLLOW = 2.0  # within the time after which what was not seen may be anything
IN_WIND = 0.5  # of the margin to D2's image border: the rest is what wind may take
_HALVINGS = 24
_FINE = 1.001


@frozen
class Problem:
    """Something that this rig cannot do. ``change``: the smallest that would do, "" when none was
    found.
    """

    where: str
    what: str
    change: str = ""

    def __str__(self) -> str:
        return f"{self.what}; {self.change}" if self.change else self.what


@frozen
class Flown:
    """The facts and the geometry that a mission's settings have both drones fly."""

    facts: Facts
    mission: MissionConfig
    placed: Layout

    @property
    def range_m(self) -> float:
        """Return the distance from D1's camera to the target."""
        return self.placed.range_m


def flown(facts: Facts, mission: MissionConfig) -> Flown:
    """Work out the geometry that a mission's settings lead to."""
    return _at(facts, mission, followed_at(mission))


def check_plan(rig: Rig) -> None:
    """Raise RigError with everything that a rig's drones cannot do, each with the smallest change
    that would do.
    """
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    found = Problems()
    for problem in problems(flown(facts_of(rig, mission), mission)):
        found.add(rig.where(problem.where), str(problem))
    found.raise_any()


def problems(of: Flown) -> Iterator[Problem]:
    """Yield everything that cannot be done."""
    for check in (
        _target_px,
        _fits,
        _depth,
        _behind,
        _viewpoint,
        _site,
        _ceiling,
        _offset,
        _wind,
        _speed,
        _way_out,
        _height,
        _rate,
        _latency,
    ):
        found = check(of)
        if found is not None:
            yield found


def _at(facts: Facts, mission: MissionConfig, target_h: Floats) -> Flown:
    return Flown(facts, mission, _placed(facts, mission, target_h))


def _times(of: Flown, share: float) -> Floats:
    """Return a place on the line from D1 to the target, so many times as far."""
    return share * of.placed.target_h


def _placed(
    facts: Facts,
    mission: MissionConfig,
    target_h: Floats,
    *,
    share: float = 1.0,
    tilt_h: Floats | None = None,
) -> Layout:
    """Plan D2's viewpoint. ``share``: of the margin to the image's border that is asked for."""
    rendezvous = mission.rendezvous
    margin_px = share * rendezvous.image_margin_px
    return layout(
        facts,
        target_h,
        mission.target.half_size_m,
        mission.separation,
        replace(rendezvous, image_margin_px=margin_px),
        tilt_h=tilt_h,
    )


def _target_px(of: Flown) -> Problem | None:
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


def _fits(of: Flown) -> Problem | None:
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


def _depth(of: Flown) -> Problem | None:
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
    if _fits(_at(of.facts, of.mission, _times(of, nearer_m / range_m))) is None:
        ways.append(f"{nearer_m:.1f} m")
    if range_m > method.max_depth_m:
        ways.append(f"[depth] max_m = {range_m:.1f}")
        if not of.facts.target.flies and _hides_m(of) <= of.facts.target.span_m:
            up_m = math.ceil(1.2 * of.mission.follow.height_m)
            ways.append(f"a rangefinder ([height] rangefinder_max_m = {up_m:d})")
    return f"{', or '.join(ways)} would do"


def _behind(of: Flown) -> Problem | None:
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


def _viewpoint(of: Flown) -> Problem | None:
    """Check that there is a place for D2, level and in the wind."""
    none = of.placed.viewpoint
    if isinstance(none, Viewpoint):
        return _viewpoint_in_wind(of)
    said = f"no place for D2: {_main_reason(none)}"
    side_m = _least(
        of.facts.marker_side_m,
        10.0,
        lambda side_m: _has_viewpoint(replace(of, facts=of.facts.with_side(side_m))),
    )
    ways: list[str] = []
    if side_m is not None:
        ways.append(f"a plate of {_mm(side_m)} would do")
    focal = _least(
        1.0, 10.0, lambda times: _has_viewpoint(replace(of, facts=_zoomed(of.facts, times)))
    )
    if focal is not None:
        ways.append(f"f {of.facts.receiver.camera.fx * focal:.0f} px of D2's camera")
    farther = _least(
        1.0, 10.0, lambda times: _has_viewpoint(_at(of.facts, of.mission, _times(of, times)))
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
    if _sees_both(of, wind_mps):
        return None
    borne_mps = _most(0.0, wind_mps, lambda speed_mps: _sees_both(of, speed_mps))
    tilt_deg = of.facts.drone.tilt_per_mps_deg * wind_mps
    return Problem(
        "site.wind_mps",
        f"a wind of {wind_mps:g} m/s tilts D2 by {tilt_deg:.0f} deg, and its fixed camera with it: from some"
        " directions no place keeps marker and target in view",
        f"{borne_mps:.1f} m/s can be borne" if borne_mps > 0.0 else "",
    )


def _sees_both(of: Flown, wind_mps: float) -> bool:
    """Return whether D2 has a viewpoint in a wind from each of eight directions."""
    angle = math.radians(of.facts.drone.tilt_per_mps_deg * wind_mps)
    found = [
        _placed(of.facts, of.mission, of.placed.target_h, share=IN_WIND, tilt_h=tilt)
        for tilt in tilts(angle)
    ]
    return all(isinstance(each.viewpoint, Viewpoint) for each in found)


def _site(of: Flown) -> Problem | None:
    """Check that both drones have room inside the site where they hand over a target at its
    designated place.
    """
    fence = of.mission.fence
    target = of.mission.target
    if not fence.corners_m:
        return None
    heading = math.radians(of.mission.heading_deg)
    middle = of.placed.target_h
    places = {"D1": np.zeros(3)}
    if of.placed.T_h_c2 is not None:
        places["D2"] = of.placed.T_h_c2.t
    missing: dict[str, float] = {}
    for name, place_h in places.items():
        offset = from_heading(vec3(place_h - middle), heading)
        room_m = fence.room_m(target.north_m + offset[0], target.east_m + offset[1])
        if room_m < fence.body_m:
            missing[name] = fence.body_m - room_m
    if not missing:
        return None
    name, most_m = max(missing.items(), key=lambda each: each[1])
    return Problem(
        "site.corners_m",
        f"with the target where it is designated {name} would be {most_m:.1f} m too near to a wall, or behind it:"
        f" it keeps {fence.body_m:.1f} m, for its radius, drone.hold_m and twice site.position_m",
        f"a target {most_m:.1f} m farther ahead, another mission.heading_deg, or a site that is {most_m:.1f} m longer"
        " would do",
    )


def _ceiling(of: Flown) -> Problem | None:
    """Check that both drones have room below the ceiling of a site that has edges."""
    fence = of.mission.fence
    if not fence.corners_m:
        return None
    follow_m = of.mission.follow.height_m
    heights = {
        "D1": max(follow_m, of.mission.take_off_height_m),
        "D2": of.mission.receiver_take_off_height_m,
    }
    if of.placed.T_h_c2 is not None:
        heights["D2"] = max(heights["D2"], follow_m - float(of.placed.T_h_c2.t[2]))
    name, most_m = max(heights.items(), key=lambda each: each[1])
    missing_m = most_m - fence.highest_m
    if missing_m <= 0.0:
        return None
    return Problem(
        "site.ceiling_m",
        f"{name} would fly {most_m:.1f} m high; below a ceiling at {fence.height_m:.1f} m there is room up to"
        f" {fence.highest_m:.1f} m: it keeps {fence.body_m:.1f} m, as from walls",
        f"a ceiling at {fence.height_m + missing_m:.1f} m would do",
    )


def vec3(of: Floats) -> Vec3:
    """Return three numbers of an array."""
    x, y, z = of.tolist()
    return x, y, z


def _offset(of: Flown) -> Problem | None:
    """Check that errors that last leave both boxes over each other."""
    if not isinstance(of.placed.viewpoint, Viewpoint) or _overlap(of):
        return None
    expected = predict(of.facts, of.placed)
    most_m = _most_offset_m(of)
    worst = max(expected.sources, key=lambda source: source.sigma_m)
    share = _most(0.0, 1.0, lambda share: _overlap(_at(of.facts, of.mission, _times(of, share))))
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


def _wind(of: Flown) -> Problem | None:
    """Check that wind and gusts leave the drones enough of their tilt to follow with."""
    drone = of.facts.drone
    site = of.facts.site
    leans_deg = drone.tilt_per_mps_deg * (site.wind_mps + 2.0 * site.gust_mps)
    corrects_deg = _corrects_deg(of)
    if leans_deg + corrects_deg <= drone.max_tilt_deg:
        return None
    return Problem(
        "site.wind_mps",
        f"a wind of {site.wind_mps:g} m/s with gusts takes {leans_deg:.0f} deg of tilt and following"
        f" {corrects_deg:.0f}; the drones tilt by drone.max_tilt_deg = {drone.max_tilt_deg:g} deg at most",
        f"a wind of {_upright_wind_mps(of):.1f} m/s can be borne, or {leans_deg + corrects_deg:.0f} deg of tilt"
        " would do",
    )


def _corrects_deg(of: Flown) -> float:
    """Return the tilt that following takes."""
    return math.degrees(math.atan(of.mission.max_accel_mps2 / GRAVITY_MPS2))


def _upright_wind_mps(of: Flown) -> float:
    """Return the mean wind in which gusts and following still leave the drones within their
    tilt.
    """
    drone = of.facts.drone
    if drone.tilt_per_mps_deg <= 0.0:
        return math.inf
    room_deg = max(0.0, drone.max_tilt_deg - _corrects_deg(of))
    return max(0.0, room_deg / drone.tilt_per_mps_deg - 2.0 * of.facts.site.gust_mps)


def most_wind_mps(of: Flown) -> float:
    """Return the mean wind that can be borne: D2 sees marker and target, and both drones keep to
    their tilt.
    """
    upright_mps = _upright_wind_mps(of)
    if not isinstance(of.placed.viewpoint, Viewpoint) or math.isinf(upright_mps):
        return upright_mps
    if _sees_both(of, upright_mps):
        return upright_mps
    return _most(0.0, upright_mps, lambda speed_mps: _sees_both(of, speed_mps))


def _speed(of: Flown) -> Problem | None:
    """Check that D1 is faster than what it follows."""
    needed_mps = CATCH_UP * of.facts.target.max_speed_mps
    limit_mps = of.mission.follow.max_speed_mps
    if limit_mps >= needed_mps:
        return None
    return Problem(
        "mission.follow.max_speed_mps",
        f"the target may move at {of.facts.target.max_speed_mps:g} m/s, D1 follows at {limit_mps:g} m/s",
        f"{needed_mps:.1f} m/s would do",
    )


def _way_out(of: Flown) -> Problem | None:
    """Check that a drone that lands finds a place that the target cannot reach meanwhile."""
    height_m = of.mission.follow.height_m
    needed_m = way_out_m(of.facts, height_m)
    if needed_m <= MOST_WAY_OUT_M:
        return None
    target = of.facts.target
    lower_m = height_m * (MOST_WAY_OUT_M - target.span_m) / (needed_m - target.span_m)
    return Problem(
        "target.max_speed_mps",
        f"while a drone lands from {height_m:.1f} m the target gets so far that it would have to go"
        f" {needed_m:.0f} m aside first; {MOST_WAY_OUT_M:.0f} m are the most",
        f"{lower_m:.1f} m of height would do",
    )


def _height(of: Flown) -> Problem | None:
    """Check that it is said how high a target is that flies."""
    if not of.facts.target.flies or of.mission.target.height_m > 0.0:
        return None
    return Problem(
        "mission.target.height_m",
        "the target flies, and it is not said how high",
        "the height of its middle above the ground, when it is pointed at, would do",
    )


def _rate(of: Flown) -> Problem | None:
    """Check that enough pairs come before the views have to agree."""
    rates = [eye.rate_hz for eye in (of.facts.sender, of.facts.receiver) if eye.rate_hz is not None]
    if not rates:
        return None
    every_s = 1.0 / min(rates)
    if FRAMES_TO_FOLLOW * every_s > UNSEEN_S:
        return Problem(
            "perception.rate_hz",
            f"frames come {every_s:g} s apart; what was not seen for {UNSEEN_S:g} s may be anything by then",
            f"{FRAMES_TO_FOLLOW / UNSEEN_S:g} frames a second would do",
        )
    takes_s = agreement_s(of.facts, min(rates))
    wait_s = of.mission.deadlines.verify_s
    if takes_s <= wait_s:
        return None
    return Problem(
        "mission.deadlines.verify_s",
        f"{of.facts.method.needed_pairs} pairs at {min(rates):g} frames a second take {takes_s:.0f} s;"
        f" {wait_s:g} s are given",
        f"{takes_s:.0f} s would do",
    )


def _latency(of: Flown) -> Problem | None:
    """Check that D2 can still tell where the target is when D1's word of it comes late."""
    if not isinstance(of.placed.viewpoint, Viewpoint):
        return None
    method = of.facts.method
    link = of.facts.link
    searched_px = _searched_px(of, link.latency_s)
    if searched_px <= method.max_search_px:
        return None
    most_s = _most(
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


def agreement_s(facts: Facts, rate_hz: float) -> float:
    """Return how long the views must agree before the hand-over at a rate of frames, when nothing
    is missed.
    """
    evidence = facts.method.evidence
    least_s = facts.method.hold_s if facts.method.gate == "count" else evidence.min_s
    return max(least_s, facts.method.needed_pairs / rate_hz) + 0.5


def _has_viewpoint(of: Flown) -> bool:
    return isinstance(_placed(of.facts, of.mission, of.placed.target_h).viewpoint, Viewpoint)


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


def _least(fails: float, passes: float, holds: Callable[[float], bool]) -> float | None:
    """Return the least value that holds between one that fails and a larger one; None when that
    fails too.
    """
    if not holds(passes):
        # what is too large may fail for another reason: try on the way up
        value = fails
        while value < passes and not holds(value):
            value *= 1.25
        if value >= passes:
            return None
        passes = value
    for _ in range(_HALVINGS):
        middle = math.sqrt(fails * passes)
        if passes / fails < _FINE:
            break
        if holds(middle):
            passes = middle
        else:
            fails = middle
    return passes


def _most(holds_at: float, fails: float, holds: Callable[[float], bool]) -> float:
    """Return the largest value that holds between one that is taken to hold and one that fails."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (holds_at + fails)
        if holds(middle):
            holds_at = middle
        else:
            fails = middle
    return holds_at


def _mm(length_m: float) -> str:
    return f"{math.ceil(1000.0 * length_m - 1e-6):d} mm"


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
