"""A drone that follows or seeks what it sees stays below its fence, however high up that seems to
be.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from flight.config import FollowConfig, GuardConfig, MissionConfig
from flight.guidance import BELOW_FENCE_M, within_fence
from flight.tilt import Tilt
from missions.fly.leg.sender import Sender

CONFIG = MissionConfig(
    follow=FollowConfig(behind_m=2.2, height_m=3.5), guard=GuardConfig(fence_height_m=6.0)
)


@pytest.mark.parametrize(("up_m", "seeks"), [(0.0, False), (2.5, False), (2.5, True), (9.0, True)])
def test_the_place_behind_a_target_is_below_the_fence(up_m: float, seeks: bool) -> None:
    drone: Any = SimpleNamespace(
        _config=CONFIG, _regaining=lambda: seeks, _heading_rad=0.0, _tilt=Tilt(), _axis_b=(0.7, 0.0, 0.7),
        _session=SimpleNamespace(fence=CONFIG.fence),
    )  # fmt: skip
    _, _, down = Sender._view_of(drone, (4.0, 0.0, -CONFIG.target.height_m - up_m))
    wanted_m = (
        up_m + CONFIG.target.height_m + (1.4 if seeks else 1.0) * (3.5 - CONFIG.target.height_m)
    )
    assert -down == pytest.approx(min(wanted_m, 6.0 - BELOW_FENCE_M))


def test_within_the_fence_a_place_is_as_it_was_and_beyond_it_the_nearest() -> None:
    assert within_fence((3.0, 4.0, -2.0), 5.5, 3.0) == (3.0, 4.0, -2.0)
    assert within_fence((6.0, 8.0, -4.0), 5.0, 3.0) == pytest.approx((3.0, 4.0, -3.0))
    assert within_fence((6.0, 8.0, -4.0), math.inf, 3.0) == (6.0, 8.0, -3.0)
    assert within_fence((0.0, 0.0, -4.0), -1.0, -1.0) == pytest.approx((0.0, 0.0, 0.0))
