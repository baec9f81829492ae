"""Ways through a field with more than two drones on it. Pure; NED, metres and seconds."""

from __future__ import annotations

import math

from flight.guidance import Anchor, Vec3, bearing, subtract

_PUSH_PER_S = 0.8


def keep_clear(
    velocity_n_mps: Vec3,
    own_n_m: Vec3,
    other_n_m: Vec3,
    clear_m: float,
) -> Vec3:
    """A velocity that does not lead within ``clear_m`` of a place, looked at from above, and leads
    out of there.
    """
    north = own_n_m[0] - other_n_m[0]
    east = own_n_m[1] - other_n_m[1]
    away_m = math.hypot(north, east)
    if away_m >= clear_m or away_m < 1e-6:
        return velocity_n_mps
    n = north / away_m
    e = east / away_m
    outward = velocity_n_mps[0] * n + velocity_n_mps[1] * e
    missing = max(0.0, _PUSH_PER_S * (clear_m - away_m) - outward)
    return velocity_n_mps[0] + missing * n, velocity_n_mps[1] + missing * e, velocity_n_mps[2]


def way_home(aside: Anchor, above_home_n_m: Vec3) -> tuple[Anchor, Anchor, Anchor]:
    """First aside at the height of the others, then up, then home above everything."""
    north, east, _ = aside.position_n_m
    up = Anchor((north, east, above_home_n_m[2]), aside.yaw_rad)
    return aside, up, Anchor(above_home_n_m, bearing(subtract(above_home_n_m, up.position_n_m)))
