"""From which side to follow a target among obstacles. Pure."""

from __future__ import annotations

import math

import numpy as np

from flight.fence import Fence
from flight.guidance import Vec3
from path.arrays import Array

_TURNS_RAD = np.radians(np.arange(-180.0, 180.0, 15.0))
_IN_THE_WAY = 10.0  # radians of turn that a metre short of clear, or a hidden target, is worth


def free_heading(
    fence: Fence, target_n_m: Vec3, behind_h_m: Array, heading_rad: float, step_rad: float
) -> float:
    """Return the heading to follow a target with, turned towards the nearest one from which it is
    seen, and with which both drones have room.

    Args:
        behind_h_m: (k, 3) places relative to the target in the heading frame (forward, right,
            down): of the drone that follows, and of others that are to have room as well.
        step_rad: the most that it turns at once.
    """
    turns = np.concatenate(([0.0], _TURNS_RAD))
    c = np.cos(heading_rad + turns)[:, None]
    s = np.sin(heading_rad + turns)[:, None]
    ahead, right, down = behind_h_m.T
    level = np.broadcast_to(down, (len(turns), len(down)))
    places = np.stack((c * ahead - s * right, s * ahead + c * right, level), axis=-1)
    places = places + np.array(target_n_m)
    short_m = fence.short_m(places.reshape(-1, 3)).reshape(level.shape).sum(axis=1)
    unseen = fence.hides(target_n_m, places[:, 0])
    cost = np.abs(turns) + _IN_THE_WAY * (short_m + unseen)
    turn = float(turns[int(np.argmin(cost))])
    return heading_rad + math.copysign(min(abs(turn), step_rad), turn)
