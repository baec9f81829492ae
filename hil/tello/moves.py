"""The SDK's relative moves of a Tello: ``up 50``, ``cw 90``, ``go 100 0 0 50``, ``curve 100 100 0
200 0 0 30``.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hil.autopilot.guidance import toward
from hil.autopilot.values import Estimate
from path.geometry.rotation import wrapped, yaw_of
from path.messages import Vec3
from path.values import frozen

AXES: dict[str, Vec3] = {  # forward, right, down
    "up": (0.0, 0.0, -1.0), "down": (0.0, 0.0, 1.0), "left": (0.0, -1.0, 0.0), "right": (0.0, 1.0, 0.0),
    "forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0),
}  # fmt: skip
TURNS = {"cw": 1.0, "ccw": -1.0}
NUMBERS = {"go": 4, "curve": 7}
MOVES = (*AXES, *TURNS, *NUMBERS, "jump", "flip")
FLIPS = ("l", "r", "f", "b")
FLIP_S = 1.0
THERE_M = 0.08
THERE_RAD = math.radians(3.0)
PASSED_M = 0.15
# of a curve
MIN_RADIUS_M = 0.5
MAX_RADIUS_M = 10.0
ARC_RAD = math.radians(15.0)  # between two places on it


@frozen
class TelloMove:
    """A move to a place (NED, m) and a heading. ``via``: places on the way; ``wait_s``: it takes at
    least so long.
    """

    goal_n_m: Vec3
    yaw_rad: float
    speed_mps: float | None = None  # None: as it is set
    via: tuple[Vec3, ...] = ()
    wait_s: float = 0.0

    def velocity(self, position_n_m: Vec3, speed_mps: float) -> Vec3:
        speed = self.speed_mps or speed_mps
        return toward(position_n_m, self.via[0] if self.via else self.goal_n_m, 1.5, speed, speed)

    def turn_left(self, yaw_rad: float) -> float:
        return wrapped(self.yaw_rad - yaw_rad)

    def after(self, position_n_m: Vec3, dt: float) -> TelloMove:
        """Return what is left of it."""
        passed = bool(self.via) and math.dist(position_n_m, self.via[0]) < PASSED_M
        return replace(
            self,
            via=self.via[1:] if passed else self.via,
            wait_s=max(0.0, self.wait_s - dt),
        )

    def over(self, estimate: Estimate) -> bool:
        near = (
            not self.via
            and self.wait_s <= 0.0
            and math.dist(estimate.position_n_m, self.goal_n_m) < THERE_M
        )
        return near and abs(self.turn_left(yaw_of(estimate.q_n_b))) < THERE_RAD


def move_of(
    word: str,
    arguments: list[str],
    position_n_m: Vec3,
    yaw_rad: float,
) -> TelloMove | str | None:
    """Return the move that a command asks for, from where the drone is; the drone's refusal.

    None when it is no move.
    """
    if word == "flip":
        return (
            TelloMove(position_n_m, yaw_rad, wait_s=FLIP_S)
            if arguments in [[each] for each in FLIPS]
            else "error"
        )
    if word == "jump":  # from pad to pad
        return "error No valid marker" if len(arguments) == 7 else "error"
    if word in NUMBERS:
        return _to_places(word, arguments, position_n_m, yaw_rad)
    return (
        _straight(word, arguments, position_n_m, yaw_rad) if word in AXES or word in TURNS else None
    )


def _straight(
    word: str,
    arguments: list[str],
    position_n_m: Vec3,
    yaw_rad: float,
) -> TelloMove | str:
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
    return TelloMove(_place(position_n_m, yaw_rad, (forward, -right, -down)), yaw_rad)


def _to_places(
    word: str,
    arguments: list[str],
    position_n_m: Vec3,
    yaw_rad: float,
) -> TelloMove | str:
    """``go`` and ``curve``: places are forward, left and up of the drone, cm."""
    if any(argument.startswith("m") for argument in arguments[NUMBERS[word] :]):
        return "error No valid marker"  # no mission pad is ever in sight
    try:
        *coordinates, speed = (int(argument) for argument in arguments)
    except ValueError:
        coordinates = []
        speed = 0
    if len(coordinates) + 1 != NUMBERS[word]:
        return "error"
    points = [_vec(coordinates[k : k + 3]) for k in range(0, len(coordinates), 3)]
    slow = 10 <= speed <= (100 if word == "go" else 60)
    if (
        not slow
        or any(abs(each) > 500 for each in coordinates)
        or all(abs(each) < 20 for each in coordinates[-3:])
    ):
        return "out of range"
    on_the_way: list[Vec3] = []
    if word == "curve":
        arc = _arc(*points)
        if arc is None:
            return "error Radius is too large!"
        on_the_way = arc
    places = [_place(position_n_m, yaw_rad, point) for point in (*on_the_way, points[-1])]
    return TelloMove(places[-1], yaw_rad, speed / 100.0, tuple(places[:-1]))


def _arc(via: Vec3, end: Vec3) -> list[Vec3] | None:
    """Places on the circle from the drone through one place to another; None when there is none of
    a radius allowed.
    """
    a = np.array(via)
    b = np.array(end)
    normal = np.cross(a, b)
    area2 = float(normal @ normal)
    if area2 < 1e-9:
        return None
    centre = np.cross((a @ a) * b - (b @ b) * a, normal) / (2.0 * area2)
    radius = float(np.linalg.norm(centre))
    if not MIN_RADIUS_M <= radius <= MAX_RADIUS_M:
        return None
    x = -centre / radius
    y = np.cross(normal / math.sqrt(area2), x)

    def angle(point: np.ndarray) -> float:
        return math.atan2(float((point - centre) @ y), float((point - centre) @ x)) % (
            2.0 * math.pi
        )

    whole = angle(b)
    count = max(2, math.ceil(whole / ARC_RAD))
    turns = [whole * k / count for k in range(1, count)]
    return [_metres(centre + radius * (math.cos(turn) * x + math.sin(turn) * y)) for turn in turns]


def _vec(cm: list[int]) -> Vec3:
    x, y, z = (each / 100.0 for each in cm)
    return x, y, z


def _metres(point: np.ndarray) -> Vec3:
    x, y, z = point.tolist()
    return x, y, z


def _place(
    position_n_m: Vec3,
    yaw_rad: float,
    forward_left_up_m: Vec3,
) -> Vec3:
    forward, left, up = forward_left_up_m
    c = math.cos(yaw_rad)
    s = math.sin(yaw_rad)
    north, east, height = position_n_m
    return north + c * forward + s * left, east + s * forward - c * left, height - up
