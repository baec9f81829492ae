"""Words of a Tello's language: the sticks that fly it, and what its refusals mean."""

from __future__ import annotations

import math

from drivers.interfaces import VehicleError
from drivers.tello.config import TelloVehicleConfig
from path.messages import Vec3

CENTRE = "rc 0 0 0 0"
REASONS = {  # texts that drones were seen to answer with
    "error motor stop": "a propeller is blocked, or it lies on its side",
    "error no valid imu": "calibrate its IMU in the Tello app, or put it on level ground",
    "error auto land": "its battery is low, or it is landing by itself",
    "error not joystick": "it is busy with another command",
}


def sticks(
    config: TelloVehicleConfig,
    heading_rad: float,
    velocity_n_mps: Vec3,
    turn_dps: float,
) -> str:
    """``rc``: right, forward, up, clockwise, each -100..100, for a velocity in NED of a drone with
    this heading.
    """
    north, east, down = velocity_n_mps
    c = math.cos(heading_rad)
    s = math.sin(heading_rad)
    scale = 100.0 / config.full_stick_mps
    wanted = (
        scale * (c * east - s * north), scale * (c * north + s * east), -scale * down,
        100.0 * turn_dps / config.full_stick_dps,
    )  # fmt: skip
    a, b, up, d = (max(-100, min(100, round(stick))) for stick in wanted)
    return f"rc {a} {b} {up} {d}"


def refused(
    what: str,
    answer: str,
    battery: float,
) -> VehicleError:
    """Its own words, and what to do about them. ``battery``: 0..1."""
    reason = REASONS.get(answer.lower(), "remedy what it names, then start again")
    return VehicleError(
        f"the drone refused to {what}: it said {answer!r} (battery {100 * battery:.0f} %)", reason
    )
