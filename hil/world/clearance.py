"""The distance of a drone in the air from a target that it could hit: a person, or what flies."""

from __future__ import annotations

import math

from hil.world.snapshot import TargetKind
from hil.world.world import World
from path.messages import Role

# Half width, half height and height of the middle above the frame's origin, m; a car is below every drone.
_BODIES: dict[TargetKind, tuple[float, float, float]] = {"person": (0.35, 0.875, 0.875), "drone": (0.16, 0.05, 0.0)}
DRONE_M = 0.16  # around the middle of a body
LEAST_M = 0.4  # between the bodies


def clearance(world: World) -> float:
    """Returns the least distance between the target's body and that of a drone in the air, m; infinite without any.

    Look-alikes are not looked at: nobody tells the drones to keep away from them.
    """
    body = _BODIES.get(world.config.target.kind)
    if body is None:
        return math.inf
    half_m, high_m, middle_m = body
    nearest_m = math.inf
    for drone in (world.drone(role) for role in Role):
        if not drone.on_ground:
            north, east, down = drone.true_position_n_m
            x, y, z = world.snapshot().objects[0].position_w_m
            across = max(0.0, math.hypot(x - east, y - north) - half_m)
            above = max(0.0, abs(-down - z - middle_m) - high_m)
            nearest_m = min(nearest_m, math.hypot(across, above) - DRONE_M)
    return nearest_m
