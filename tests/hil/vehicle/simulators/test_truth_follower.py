"""A drone's truth from coarse messages: smooth, near, and honest about the ground."""

import math

import numpy as np
import pytest

from hil.vehicle.simulators.truth_follower import Fix, TrueMotion, TruthFollower
from hil.world.dynamics import ATTITUDE, CONTACT, POSITION

LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
STEP_M = 0.0111  # 1e-7 degrees of latitude
LEG_M = 0.1


def coarse(value: float) -> float:
    return math.floor(value / STEP_M) * STEP_M + STEP_M / 2


def flown(seconds: float, velocity_mps: float) -> tuple[TruthFollower, list[float]]:
    """Errors north, in m, of a drone that flies straight and tells its position in steps."""
    follower, errors = TruthFollower(LEG_M), list[float]()
    for tick in range(int(seconds * 100)):
        now_s = tick / 100
        north = velocity_mps * now_s
        follower.on_motion(TrueMotion(now_s, (velocity_mps, 0.0, 0.0), LEVEL, STILL))
        follower.on_fix(Fix(now_s, (coarse(north), 0.0, -2.0)))
        later_s = now_s + 0.004
        errors.append(float(follower.row(later_s)[0]) - velocity_mps * later_s)
    return follower, errors


def test_position_is_finer_than_the_messages_it_comes_from() -> None:
    _, errors = flown(6.0, 0.3)
    settled = np.array(errors[300:])
    assert np.abs(settled).max() < 0.003
    assert np.abs(np.diff(settled)).max() < 0.0005  # nothing jumps: a step is 11 mm


def test_a_drone_that_was_moved_is_where_it_was_moved_to() -> None:
    follower, _ = flown(1.0, 0.0)
    follower.on_fix(Fix(1.0, (50.0, math.nan, math.nan)))
    assert follower.row(1.0)[POSITION][0] == pytest.approx(50.0)


def test_parts_of_a_position_may_come_in_messages_of_their_own() -> None:
    follower = TruthFollower(LEG_M)
    follower.on_motion(TrueMotion(0.0, STILL, LEVEL, STILL))
    follower.on_fix(Fix(0.0, (3.0, 4.0, math.nan)))
    assert not follower.ready
    follower.on_fix(Fix(0.0, (math.nan, math.nan, 0.0)))
    assert follower.ready
    assert follower.row(0.0)[POSITION] == pytest.approx([3.0, 4.0, -LEG_M])


def test_fixes_before_any_motion_are_not_believed() -> None:
    follower = TruthFollower(LEG_M)
    follower.on_fix(Fix(0.0, (3.0, 4.0, 0.0)))
    assert not follower.ready
    assert follower.newest_s == -math.inf


def test_attitude_is_carried_on_by_the_rates() -> None:
    follower = TruthFollower(LEG_M)
    follower.on_motion(TrueMotion(0.0, STILL, LEVEL, (0.0, 0.0, 0.5)))
    follower.on_fix(Fix(0.0, (0.0, 0.0, 0.0)))
    assert follower.row(0.02)[ATTITUDE] == pytest.approx(
        [math.cos(0.005), 0, 0, math.sin(0.005)], abs=1e-6
    )


def test_it_stands_on_the_ground_where_it_stood_first() -> None:
    follower = TruthFollower(LEG_M)
    follower.on_motion(TrueMotion(0.0, STILL, LEVEL, STILL))
    follower.on_fix(Fix(0.0, (0.0, 0.0, 0.3)))  # its home is 0.3 m below the mission's zero
    assert follower.row(0.0)[CONTACT] == 1.0
    follower.on_motion(TrueMotion(0.1, (0.0, 0.0, -2.0), LEVEL, STILL))
    follower.on_motion(TrueMotion(0.2, (0.0, 0.0, -2.0), LEVEL, STILL))
    assert follower.row(0.2)[CONTACT] == 0.0


def test_a_drone_whose_positions_are_wrong_is_elsewhere_and_in_height_only_once_it_flies() -> None:
    follower = TruthFollower(LEG_M, (2.0, -1.0, -0.8))
    follower.on_motion(TrueMotion(0.0, STILL, LEVEL, STILL))
    follower.on_fix(Fix(0.0, (5.0, 5.0, 0.0)))
    assert follower.row(0.0)[POSITION] == pytest.approx([3.0, 6.0, -LEG_M])
    heights: list[float] = []
    for tick in range(1, 31):
        follower.on_motion(TrueMotion(0.1 * tick, (0.0, 0.0, -1.0), LEVEL, STILL))
        heights.append(-float(follower.row(0.1 * tick)[2]) - LEG_M)
    assert heights[-1] == pytest.approx(2.95 - 0.8, abs=0.01)
    assert np.all(np.diff(heights) > 0.0)
