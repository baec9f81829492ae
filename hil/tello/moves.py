"""The SDK's relative moves of a Tello: ``up 50``, ``cw 90``, ``go 100 0 0 50``."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hil.autopilot.guidance import toward
from hil.autopilot.values import Estimate
from path.messages import Vec3
from path.rotation import wrapped, yaw_of

AXES: dict[str, Vec3] = {  # forward, right, down
    "up": (0.0, 0.0, -1.0), "down": (0.0, 0.0, 1.0), "left": (0.0, -1.0, 0.0), "right": (0.0, 1.0, 0.0),
    "forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0),
}  # fmt: skip
TURNS = {"cw": 1.0, "ccw": -1.0}
THERE_M, THERE_RAD = 0.08, math.radians(3.0)


@dataclass(frozen=True, slots=True)
class TelloMove:
    """A move to a place (NED, m) and a heading."""

    goal_n_m: Vec3
    yaw_rad: float

    def velocity(self, position_n_m: Vec3, speed_mps: float) -> Vec3:
        return toward(position_n_m, self.goal_n_m, 1.5, speed_mps, speed_mps)

    def turn_left(self, yaw_rad: float) -> float:
        return wrapped(self.yaw_rad - yaw_rad)

    def over(self, estimate: Estimate) -> bool:
        near = math.dist(estimate.position_n_m, self.goal_n_m) < THERE_M
        return near and abs(self.turn_left(yaw_of(estimate.q_n_b))) < THERE_RAD


def move_of(word: str, arguments: list[str], position_n_m: Vec3, yaw_rad: float) -> TelloMove | str | None:
    """Returns the move that a command asks for, from where the drone is; the drone's refusal.

    None when it is no move.
    """
    if word not in AXES and word not in TURNS:
        return None
    low, high = (1, 360) if word in TURNS else (20, 500)
    try:
        (value,) = (int(argument) for argument in arguments)
    except ValueError:
        return "error"
    if not low <= value <= high:
        return "out of range"
    if word in TURNS:
        return TelloMove(position_n_m, yaw_rad + TURNS[word] * math.radians(value))
    forward, right, down = (value / 100.0 * part for part in AXES[word])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    north, east, height = position_n_m
    return TelloMove((north + c * forward - s * right, east + s * forward + c * right, height + down), yaw_rad)
