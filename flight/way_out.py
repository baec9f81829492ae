"""How far a drone goes before it lands, so that the target it watched cannot be below it by then.
Pure.
"""

from __future__ import annotations

from flight.config import MissionConfig
from flight.guidance import Vec3, subtract, way_until_away
from flight.tracking.target_track import TargetTrack

LANDING_MPS = 0.5  # so slowly it may come down
FARTHEST = 2.0  # times the usual way out, for a target that could come there


def way_out_m(
    track: TargetTrack,
    place_n_m: Vec3,
    along_n: Vec3,
    config: MissionConfig,
    now_ns: int,
    least_m: float,
) -> float:
    """Return how far to go from a place along a level unit vector.

    So far that the target, as fast as it may be, cannot come there before the drone is down;
    ``least_m`` in any case, and at most ``FARTHEST`` times the usual way.
    """
    target, _ = track.believed(now_ns)
    height_m = max(0.0, -place_n_m[2])
    landing_s = config.depart_m / config.follow.max_speed_mps + height_m / LANDING_MPS
    clear_m = config.separation.minimum_m + config.target.half_size_m
    clear_m += track.fastest_mps(now_ns) * landing_s
    wanted_m = way_until_away(subtract(place_n_m, target), along_n, clear_m)
    return min(max(least_m, wanted_m), FARTHEST * max(least_m, config.depart_m))
