"""Checks of room, motion and time: whether both drones fit between walls and ceiling, bear the wind,
are fast enough, and have frames enough to agree in time.

Each takes what is flown and returns a Problem or None.
"""

from __future__ import annotations

import math

import numpy as np

from flight.guidance import GRAVITY_MPS2, Vec3, from_heading
from flight.plan.derive import MOST_WAY_OUT_M, way_out_m
from flight.plan.facts import Facts
from flight.plan.flown import Flown, Problem
from flight.plan.geometry import Floats
from flight.plan.least_change import most
from flight.plan.sight import sees_both
from flight.rendezvous.viewpoint import Viewpoint
from flight.tracking.association import UNSEEN_S

CATCH_UP = 1.15  # times the target's speed, to come closer at all
FRAMES_TO_FOLLOW = 2.0  # within the time after which what was not seen may be anything


def site(of: Flown) -> Problem | None:
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


def obstacles(of: Flown) -> Problem | None:
    """Check that both drones can climb from their homes, and that the target's place is free."""
    mission = of.mission
    fence = mission.fence
    homes = {
        "D1": (mission.target.home_m, mission.take_off_height_m),
        "D2": (mission.rendezvous.home_m, mission.receiver_take_off_height_m),
    }
    for name, (home_m, height_m) in homes.items():
        if not home_m:
            continue
        north, east = home_m
        free = fence.nearest((north, east, -height_m), lowest_m=0.0)
        short_m = math.dist(free[:2], home_m)
        if fence.obstacles and short_m > 0.0:
            return Problem(
                "site.obstacles",
                f"{name} would take off too near to one: it keeps {fence.body_m:.1f} m, for its radius,"
                " drone.hold_m and twice site.position_m",
                f"a home {short_m:.1f} m farther off would do, at {free[0]:.1f}, {free[1]:.1f}",
            )
    target = mission.target
    place = target.north_m, target.east_m, -target.height_m
    if any(each.distance_m(place) == 0.0 for each in fence.obstacles):
        return Problem("site.obstacles", "the target is designated inside one")
    return None


def ceiling(of: Flown) -> Problem | None:
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


def wind(of: Flown) -> Problem | None:
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
        f"a wind of {upright_wind_mps(of):.1f} m/s can be borne, or {leans_deg + corrects_deg:.0f} deg of tilt"
        " would do",
    )


def _corrects_deg(of: Flown) -> float:
    """Return the tilt that following takes."""
    return math.degrees(math.atan(of.mission.max_accel_mps2 / GRAVITY_MPS2))


def upright_wind_mps(of: Flown) -> float:
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
    upright_mps = upright_wind_mps(of)
    if not isinstance(of.placed.viewpoint, Viewpoint) or math.isinf(upright_mps):
        return upright_mps
    if sees_both(of, upright_mps):
        return upright_mps
    return most(0.0, upright_mps, lambda speed_mps: sees_both(of, speed_mps))


def speed(of: Flown) -> Problem | None:
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


def way_out(of: Flown) -> Problem | None:
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


def height(of: Flown) -> Problem | None:
    """Check that it is said how high a target is that flies."""
    if not of.facts.target.flies or of.mission.target.height_m > 0.0:
        return None
    return Problem(
        "mission.target.height_m",
        "the target flies, and it is not said how high",
        "the height of its middle above the ground, when it is pointed at, would do",
    )


def rate(of: Flown) -> Problem | None:
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


def agreement_s(facts: Facts, rate_hz: float) -> float:
    """Return how long the views must agree before the hand-over at a rate of frames, when nothing
    is missed.
    """
    evidence = facts.method.evidence
    least_s = facts.method.hold_s if facts.method.gate == "count" else evidence.min_s
    return max(least_s, facts.method.needed_pairs / rate_hz) + 0.5
