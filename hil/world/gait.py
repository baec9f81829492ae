"""The gait of people: how long a stride is at a walking speed, and where the feet are in it.

The step grows with the root of the speed, as it does for people whose ratio of step length to
cadence is constant: about 0.0065 m per step a minute (Sekiya and Nagasaki 1998). Faster than a
stride can grow, the cadence rises alone.
"""

from __future__ import annotations

import math

STEP_AT_1_MPS_M = 0.625  # root of (60 s * 0.0065 m min)
LONGEST_STEP_M = 0.8
STANCE = 0.6  # share of a stride in which a foot is on the ground
LIFT = 0.35  # of a foot, over the way that it reaches ahead
HIGHEST_LIFT_M = 0.10
OWN_PHASE = 0.381966  # of a stride, from one person to the next: nobody walks in step


def step_m(speed_mps: float) -> float:
    """Return the length of a step, from one foot to the other, at a walking speed of either
    sign.
    """
    return min(LONGEST_STEP_M, STEP_AT_1_MPS_M * math.sqrt(abs(speed_mps)))


def strides_of(way_m: float, speed_mps: float) -> float:
    """Return how many strides of two steps a way takes; none without speed."""
    return way_m / (2.0 * step_m(speed_mps)) if speed_mps != 0.0 else 0.0


def reach_m(speed_mps: float) -> float:
    """Return how far a foot reaches ahead of the hip, and behind it."""
    return STANCE * step_m(speed_mps)


def foot_at(strides: float, speed_mps: float) -> tuple[float, float]:
    """Return how far a foot is ahead of the hip and above the ground; it lands, farthest ahead, at
    whole strides.

    On the ground it stays where it is while the body goes on.
    """
    phase = strides % 1.0
    reach = reach_m(speed_mps)
    if phase < STANCE:
        return reach * (1.0 - 2.0 * phase / STANCE), 0.0
    swing = math.pi * (phase - STANCE) / (1.0 - STANCE)
    return -reach * math.cos(swing), min(HIGHEST_LIFT_M, LIFT * reach) * math.sin(swing)
