"""D1 comes nearer to its target when the views have not agreed for long, where the mission says so."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from flight.config import FollowConfig, MissionConfig, TargetDesignation
from flight.tilt import Tilt
from missions.leg.sender import Sender

SECOND = 1_000_000_000
AT = (4.0, 0.0, -0.8)


def drone(nearer: float, since_s: float | None, *, seeks: bool = False) -> Any:
    follow = FollowConfig(behind_m=1.45, height_m=2.2, nearer=nearer, nearer_after_s=2.0)
    verify_ns = None if since_s is None else 7 * SECOND
    own: Any = SimpleNamespace(
        _config=MissionConfig(follow=follow, target=TargetDesignation(height_m=0.8)),
        _regaining=lambda: seeks,
        _heading_rad=0.0,
        _tilt=Tilt(),
        _axis_b=(0.7, 0.0, 0.7),
        _verify_ns=verify_ns,
        _session=SimpleNamespace(now_ns=lambda: 7 * SECOND + round((since_s or 0.0) * SECOND)),
    )
    own._nearer = lambda: Sender._nearer(own)
    return own


@pytest.mark.parametrize(
    ("nearer", "since_s", "share"),
    [(0.6, None, 1.0), (0.6, 1.9, 1.0), (0.6, 3.2, 0.7), (0.6, 30.0, 0.6), (1.0, 30.0, 1.0)],
)
def test_it_keeps_all_of_its_distance_until_then_and_never_less_than_is_stated(
    nearer: float, since_s: float | None, share: float
) -> None:
    north, _, down = Sender._view_of(drone(nearer, since_s), AT)
    assert math.hypot(AT[0] - north, AT[2] - down) == pytest.approx(share * math.hypot(1.45, 1.4))


def test_to_see_a_target_again_it_goes_farther_off_all_the_same() -> None:
    north, _, _ = Sender._view_of(drone(0.6, 30.0, seeks=True), AT)
    assert AT[0] - north == pytest.approx(1.4 * 1.45)
