"""Velocity commands from positions: pure functions, NED, metres and seconds."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.interfaces import VehicleState, VelocitySetpoint
from path.values import frozen, value

GRAVITY_MPS2 = 9.81
Vec3 = tuple[float, float, float]


def add(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(a: Vec3, k: float) -> Vec3:
    return a[0] * k, a[1] * k, a[2] * k


def norm(a: Vec3) -> float:
    return math.hypot(*a)


def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def limit(a: Vec3, longest: float) -> Vec3:
    """``a`` shortened to ``longest`` when it is longer."""
    length = norm(a)
    return a if length <= longest else scale(a, longest / length)


def from_heading(offset_h_m: Vec3, heading_rad: float) -> Vec3:
    """(forward, right, down) in a levelled heading frame to NED."""
    c = math.cos(heading_rad)
    s = math.sin(heading_rad)
    forward, right, down = offset_h_m
    return c * forward - s * right, s * forward + c * right, down


def bearing(to_n_m: Vec3) -> float:
    """Yaw that points the nose along a vector."""
    return math.atan2(to_n_m[1], to_n_m[0])


LEAST_SPARE = 0.2
"""Of a vehicle's acceleration, in any case: else it would never come to what brakes as hard as it
can itself.
"""

BELOW_FENCE_M = 0.5
"""So much below the fence's height a drone that follows a target stays: it comes to rest late, and
wind lifts it.
"""


def within_fence(
    place_n_m: Vec3,
    radius_m: float,
    height_m: float,
) -> Vec3:
    """The nearest place that is no farther from the origin, and no higher."""
    north, east, down = place_n_m
    share = min(1.0, max(0.0, radius_m) / max(math.hypot(north, east), 1e-9))
    return share * north, share * east, max(down, -max(0.0, height_m))


def way_until_away(
    offset_n_m: Vec3,
    along_n: Vec3,
    distance_m: float,
) -> float:
    """Return the way along a level unit vector until the level distance from something is so
    large; 0: it is already.

    Args:
        offset_n_m: of the beginning, from that thing.
    """
    north, east, _ = offset_n_m
    passed = north * along_n[0] + east * along_n[1]
    missing = distance_m * distance_m - north * north - east * east
    return math.sqrt(missing + passed * passed) - passed if missing > 0.0 else 0.0


def close_in(
    error_n_m: Vec3,
    feed_forward_n_mps: Vec3,
    gain_per_s: float,
    max_speed_mps: float,
) -> Vec3:
    """Proportional pursuit of a (moving) point: the correction is limited, the feed-forward is
    not.
    """
    return add(feed_forward_n_mps, limit(scale(error_n_m, gain_per_s), max_speed_mps))


@value
class Answer:
    """The limits within which a vehicle is flown towards a moving point.

    ``response_s``: until it has answered to 63 % of a new velocity. ``accel_mps2``: of setpoints,
    at most.
    """

    gain_per_s: float
    max_speed_mps: float
    response_s: float
    accel_mps2: float


def approach(
    error_n_m: Vec3,
    velocity_n_mps: Vec3,
    feed_forward_n_mps: Vec3,
    answer: Answer,
) -> Vec3:
    """The velocity towards a (moving) point at which a vehicle that answers late comes to rest, and
    not behind it.

    It is made from what will be left of the way once the vehicle has answered, and is no faster
    than it can stop with half of the acceleration: wind, and a point that turns, want the rest.

    Args:
        velocity_n_mps: of the vehicle.
    """
    closing = subtract(velocity_n_mps, feed_forward_n_mps)
    left = subtract(error_n_m, scale(closing, answer.response_s))
    fastest = min(answer.max_speed_mps, math.sqrt(answer.accel_mps2 * norm(left)))
    return add(feed_forward_n_mps, limit(scale(left, answer.gain_per_s), fastest))


def spare_accel(
    accel_mps2: float,
    speed_mps: float,
    target_accel_mps2: float,
    response_s: float,
) -> float:
    """Return what is left of a vehicle's acceleration to come nearer with, if what it comes to
    brakes meanwhile.

    What moves can stop: it does so with ``target_accel_mps2`` at most, and takes no more than its
    speed off within the time in which the vehicle answers. Without that share D1 comes in too fast,
    and slides over what has stopped.
    """
    braked_mps2 = min(target_accel_mps2, speed_mps / response_s)
    return max(LEAST_SPARE * accel_mps2, accel_mps2 - braked_mps2)


Way = Callable[[Vec3, Vec3], Vec3]
"""What is left to a place (first) from where a drone is: straight, or ``Fence.towards``."""


@frozen
class Anchor:
    """A place and heading to stay at."""

    position_n_m: Vec3
    yaw_rad: float

    def hold(
        self,
        state: VehicleState,
        gain_per_s: float = 0.8,
        max_speed_mps: float = 0.8,
        towards: Way = subtract,
    ) -> VelocitySetpoint:
        error = towards(self.position_n_m, state.position_n_m)
        return VelocitySetpoint(
            close_in(error, (0.0, 0.0, 0.0), gain_per_s, max_speed_mps), self.yaw_rad
        )


def slew(
    previous: VelocitySetpoint,
    wanted: VelocitySetpoint,
    dt_s: float,
    max_accel: float,
) -> VelocitySetpoint:
    """Limit the change of velocity between two setpoints to ``max_accel`` (m/s^2)."""
    change = limit(subtract(wanted.velocity_n_mps, previous.velocity_n_mps), max_accel * dt_s)
    return VelocitySetpoint(add(previous.velocity_n_mps, change), wanted.yaw_rad)
