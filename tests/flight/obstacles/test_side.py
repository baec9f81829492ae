"""From which side a target is followed among obstacles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.rig.obstacle import Obstacle
from flight.fence import Fence
from flight.guidance import add, from_heading
from flight.obstacles.side import free_heading

BEHIND = np.array([(-1.5, 0.0, -1.4), (-2.2, 0.0, -2.1)])
TARGET = (5.0, 0.0, -0.1)
AT_ONCE = math.pi


def yard(*obstacles: Obstacle) -> Fence:
    return Fence(25.0, 8.0, body_m=0.8, obstacles=obstacles)


def post(north_m: float, east_m: float) -> Obstacle:
    return Obstacle((north_m, east_m), (0.3, 0.3), 3.0, round=True)


def test_a_side_with_room_is_kept() -> None:
    fence = yard(post(3.5, 2.0))
    assert free_heading(fence, TARGET, BEHIND, 0.0, AT_ONCE) == 0.0


@pytest.mark.parametrize("place", [(3.5, 0.3), (2.7, -0.4), (4.4, 0.1)])
def test_it_turns_to_the_nearest_side_with_room_for_both_and_a_free_view(
    place: tuple[float, float],
) -> None:
    fence = yard(post(*place))
    heading_rad = free_heading(fence, TARGET, BEHIND, 0.0, AT_ONCE)
    assert 0.0 < abs(heading_rad) <= math.radians(90.0)
    first, second = (
        add(TARGET, from_heading((ahead, right, down), heading_rad))
        for ahead, right, down in BEHIND.tolist()
    )
    assert not fence.short_m(np.array([first, second])).any()
    assert not fence.hides(TARGET, np.array([first])).any()


def test_it_turns_no_faster_than_it_may() -> None:
    fence = yard(post(3.5, 0.3))
    assert abs(free_heading(fence, TARGET, BEHIND, 0.0, 0.01)) == pytest.approx(0.01)
