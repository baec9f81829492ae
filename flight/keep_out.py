"""Where a drone may come down: out of the reach of every body that it tracks. Pure.

A body that was at x with velocity v is within

    reach(t) = min(fastest t + 2 s(0), |v| t + 2 s(t))

of x a time t later, s(t) being the standard deviation of its place along the ground, carried on
(``path.belief.motion``), and ``fastest`` the rig's. A drone at height h is on the ground after h /
LANDING_MPS, and by then no body may be nearer than the drones' least separation. One that does not
fly is in nobody's way who is higher above it than that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from flight.config import MissionConfig
from flight.fence import on_edge
from flight.guidance import Vec3, from_heading, norm, subtract
from flight.tracking.candidates import Candidate
from flight.tracking.target_track import TargetTrack
from flight.way_out import FARTHEST, LANDING_MPS
from path.belief.motion import Motion
from path.belief.objects import FORGET_S
from path.values import value

_SIGMAS = 2.0
_HEADINGS = 16  # in which a place to land is looked for
_RINGS = 4  # and as many distances


@value
class Body:
    """What a drone tracks, as it was when it was seen last.

    ``half_m``: its reach around its middle. ``top_m``: height above the local frame's origin up to
    which it is; infinite for what flies.
    """

    motion: Motion
    half_m: float
    top_m: float

    @property
    def place_n_m(self) -> Vec3:
        north, east, down = self.motion.mean[:3].tolist()
        return north, east, down

    def reach_m(self, within_s: float, config: MissionConfig) -> float:
        """Return how far along the ground its middle may be from where it was, so much later."""
        north, east, _ = self.motion.mean[3:].tolist()
        later_ns = self.motion.stamp_ns + round(within_s * 1e9)
        later = self.motion.ahead(later_ns, config.follow.target_accel_mps2)
        by_speed_m = config.target.fastest_mps * within_s + _SIGMAS * self.motion.level_sigma_m
        by_motion_m = math.hypot(north, east) * within_s + _SIGMAS * later.level_sigma_m
        return min(by_speed_m, by_motion_m)


def followed(track: TargetTrack, config: MissionConfig, now_ns: int) -> list[Body]:
    """Return the object that a drone follows, and all others beside it that were seen lately."""
    flies = config.target.flies
    own = track.motion
    half_m = config.target.half_size_m
    bodies = [Body(own, half_m, _top_m(own, half_m, flies=flies))]
    belief = None if track.identity is None else track.identity.belief
    for each in () if belief is None else belief.tracks:
        wide_m, high_m = np.exp(each.log_sides).tolist()
        if each.confirmed and now_ns - each.seen_ns <= FORGET_S * 1e9:
            top_m = _top_m(each.motion, 0.5 * high_m, flies=flies)
            bodies.append(Body(each.motion, 0.5 * wide_m, top_m))
    return _lately(bodies, now_ns)


def seen(candidates: Iterable[Candidate], config: MissionConfig, now_ns: int) -> list[Body]:
    """Return the objects in view of a drone that has no target."""
    half_m = config.target.half_size_m
    flies = config.target.flies
    bodies = [
        Body(each.motion, half_m, _top_m(each.motion, half_m, flies=flies)) for each in candidates
    ]
    return _lately(bodies, now_ns)


def level_m(one: Vec3, other: Vec3) -> float:
    """Return the distance along the ground."""
    return math.hypot(one[0] - other[0], one[1] - other[1])


def clear(
    place_n_m: Vec3,
    bodies: Sequence[Body],
    config: MissionConfig,
    now_ns: int,
    away_m: float = 0.0,
) -> float:
    """Return the room that is left around a drone when it is down, m; negative: a body may be
    nearer than the least separation.

    Args:
        away_m: the way to the place before it lands there.
    """
    least_m = math.inf
    down_s = away_m / config.follow.max_speed_mps - place_n_m[2] / LANDING_MPS
    for body in bodies:
        since_s = max(0.0, (now_ns - body.motion.stamp_ns) * 1e-9)
        clear_m = config.separation.minimum_m + body.half_m
        reach_m = body.reach_m(since_s + max(0.0, down_s), config)
        least_m = min(least_m, level_m(place_n_m, body.place_n_m) - clear_m - reach_m)
    return least_m


def clear_height_m(bodies: Sequence[Body], config: MissionConfig) -> float:
    """Return the height down to which a drone is in nobody's way."""
    top_m = max((body.top_m for body in bodies), default=-math.inf)
    return top_m + config.separation.minimum_m


def place_to_land(
    here_n_m: Vec3,
    bodies: Sequence[Body],
    other_n_m: Vec3 | None,
    config: MissionConfig,
    now_ns: int,
) -> Vec3:
    """Return the nearest place around that is clear for a landing, else that with the most room, as
    high as the drone is, or as low as it may come beside them.

    Args:
        other_n_m: where the other drone is; the way there leads no nearer to it than it may.
    """
    if clear(here_n_m, bodies, config, now_ns) >= 0.0:
        return here_n_m
    low_m = min(-here_n_m[2], clear_height_m(bodies, config))
    best = here_n_m[0], here_n_m[1], -low_m
    most_m = clear(best, bodies, config, now_ns)
    for ring in range(1, _RINGS + 1):
        if most_m >= 0.0:
            break
        away_m = FARTHEST * config.depart_m * ring / _RINGS
        for k in range(_HEADINGS):
            aside = from_heading((away_m, 0.0, 0.0), 2.0 * math.pi * k / _HEADINGS)
            there = here_n_m[0] + aside[0], here_n_m[1] + aside[1], -low_m
            room_m = clear(there, bodies, config, now_ns, away_m)
            if room_m > most_m and _may_go(here_n_m, there, bodies, other_n_m, config):
                best = there
                most_m = room_m
    return best


def _may_go(
    here: Vec3,
    there: Vec3,
    bodies: Sequence[Body],
    other: Vec3 | None,
    config: MissionConfig,
) -> bool:
    """Return whether a way stays inside the fence, off the other drone, and off bodies as high."""
    if norm(subtract(config.fence.nearest(there, lowest_m=0.0), there)) > 1e-6:
        return False
    rooms = [
        (body.place_n_m, config.separation.minimum_m + body.half_m)
        for body in bodies
        if -here[2] < body.top_m + config.separation.minimum_m
    ]
    if other is not None:
        unsure_m = config.rendezvous.positions_within_m
        rooms.append((other, config.separation.minimum_m + unsure_m))
    return all(
        _nearest_m(here, there, place) >= min(clear_m, level_m(here, place)) - 1e-6
        for place, clear_m in rooms
    )


def _nearest_m(here: Vec3, there: Vec3, place: Vec3) -> float:
    """Return how near a straight way along the ground comes to a place."""
    return math.dist(place[:2], on_edge(place[:2], here[:2], there[:2]))


def _lately(bodies: list[Body], now_ns: int) -> list[Body]:
    """Return those that were seen so lately that it says where they are."""
    return [body for body in bodies if now_ns - body.motion.stamp_ns <= FORGET_S * 1e9]


def _top_m(motion: Motion, half_m: float, *, flies: bool) -> float:
    return math.inf if flies else half_m - float(motion.mean[2])
