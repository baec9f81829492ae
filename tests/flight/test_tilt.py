"""A drone that is tilted stands aside, so that its camera looks where it would if it were level."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flight.guidance import add, from_heading
from flight.tilt import Tilt, tilted
from path.geometry.rotation import R_from_quat

AXIS_B = (math.sqrt(0.5), 0.0, math.sqrt(0.5))  # 45 degrees down


def leaning(roll_deg: float, pitch_deg: float, heading_rad: float) -> Tilt:
    """After hovering like this for long."""
    tilt = Tilt()
    roll, pitch = 0.5 * math.radians(roll_deg), 0.5 * math.radians(pitch_deg)
    h = 0.5 * heading_rad
    yaw = R_from_quat((math.cos(h), 0.0, 0.0, math.sin(h)))
    R_n_b = (
        yaw
        @ R_from_quat((math.cos(pitch), 0.0, math.sin(pitch), 0.0))
        @ R_from_quat((math.cos(roll), math.sin(roll), 0.0, 0.0))
    )
    for _ in range(400):
        tilt.note(R_n_b)
    return tilt


@pytest.mark.parametrize("heading_rad", [0.0, 1.1, -2.5])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(12.0, 0.0), (0.0, -8.0), (-5.0, 6.0)])
def test_from_where_it_stands_aside_the_axis_meets_the_same_place(
    roll_deg: float, pitch_deg: float, heading_rad: float
) -> None:
    tilt = leaning(roll_deg, pitch_deg, heading_rad)
    aside = tilt.aim(AXIS_B, heading_rad, below_m=1.5)
    axis = tilted(np.array(tilt.down_n)) @ np.array(from_heading(AXIS_B, heading_rad))
    hit = add(aside, tuple((axis * 1.5 / axis[2]).tolist()))
    assert hit == pytest.approx(
        (1.5 * math.cos(heading_rad), 1.5 * math.sin(heading_rad), 1.5), abs=1e-3
    )


def test_level_it_stands_where_it_is_told() -> None:
    assert Tilt().aim(AXIS_B, 0.3, 1.5) == pytest.approx((0.0, 0.0, 0.0))


def test_a_camera_that_looks_at_the_horizon_moves_nobody() -> None:
    assert leaning(0.0, 50.0, 0.0).aim(AXIS_B, 0.0, 1.5) == (0.0, 0.0, 0.0)


def test_it_never_stands_aside_by_more_than_a_metre() -> None:
    assert math.hypot(*leaning(0.0, 30.0, 0.0).aim(AXIS_B, 0.0, 4.0)) == pytest.approx(1.0)


def test_a_gust_is_smoothed_away() -> None:
    tilt = Tilt()
    gust = tilted(np.array([0.0, 0.2, 1.0]))
    tilt.note(gust)
    assert math.hypot(*tilt.down_n[:2]) < 0.01
