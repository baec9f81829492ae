"""Where another drone's camera is, by what both see."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.common_view.estimate import CommonView, Settings, Unknown, Why, common_view
from tests.path.common_view.drawn import (
    around,
    bare,
    blobs,
    floor,
    looking,
    looks,
    room,
    tiles,
)

UNKNOWN = (Why.AMBIGUOUS, Why.UNCONSTRAINED, Why.NOTHING_COMMON, Why.FEW_POINTS)


@pytest.mark.parametrize("angle_deg", [15.0, 35.0, 55.0, 75.0])
def test_two_views_of_a_room_say_where_the_other_camera_is(angle_deg: float) -> None:
    seen = looks(room(1), around(0.0), around(angle_deg), seed=1)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, CommonView), found
    off = seen.off(found.yaw_rad, found.t_m)
    assert np.linalg.norm(off[:3]) < 0.06
    assert abs(off[3]) < math.radians(2.0)
    assert off @ np.linalg.solve(found.covariance, off) < 18.5  # 0.1 % of four


@pytest.mark.parametrize(("gravity_deg", "heading_deg"), [(0.0, 0.0), (1.0, 5.0), (0.5, 12.0)])
def test_what_the_drones_know_wrongly_does_not_move_it(
    gravity_deg: float, heading_deg: float
) -> None:
    one = around(0.0)
    two = around(40.0)
    seen = looks(room(2), one, two, 3, gravity_deg=gravity_deg, heading_deg=heading_deg)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, CommonView), found
    off = seen.off(found.yaw_rad, found.t_m)
    assert np.linalg.norm(off[:3]) < 0.06
    assert abs(off[3]) < math.radians(2.0)


@pytest.mark.parametrize("scale", [0.2, 20.0])
def test_a_scaled_world_is_known_as_well(scale: float) -> None:
    seen = looks(room(1), around(0.0), around(35.0), seed=1, scale=scale)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, CommonView), found
    assert np.linalg.norm(seen.off(found.yaw_rad, found.t_m)[:3]) < 0.06 * scale


def test_its_covariance_is_honest() -> None:
    squares: list[float] = []
    for seed in range(8):
        seen = looks(room(seed), around(0.0), around(40.0), seed)
        found = common_view(seen.first, seen.second, seen.prior)
        if isinstance(found, CommonView):
            off = seen.off(found.yaw_rad, found.t_m)
            squares.append(float(off @ np.linalg.solve(found.covariance, off)) / 4.0)
    assert len(squares) >= 7
    assert float(np.mean(squares)) < 1.5


@pytest.mark.parametrize("seed", range(3))
def test_a_bare_floor_is_not_known(seed: int) -> None:
    seen = looks([floor(bare())], around(0.0), around(40.0), seed)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, Unknown)
    assert found.why in UNKNOWN


@pytest.mark.parametrize("seed", range(3))
def test_tiles_that_repeat_are_not_known(seed: int) -> None:
    # Tiles of 0.25 m: of several in the prior no one is the right one.
    seen = looks([floor(tiles(8))], around(0.0), around(40.0), seed)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, Unknown)
    assert found.why in UNKNOWN


@pytest.mark.parametrize("seed", range(3))
def test_a_floor_that_repeats_nowhere_is_known_by_its_corners(seed: int) -> None:
    seen = looks([floor(blobs(9))], around(0.0), around(30.0), seed)
    found = common_view(seen.first, seen.second, seen.prior)
    if isinstance(found, CommonView):
        off = seen.off(found.yaw_rad, found.t_m)
        assert off @ np.linalg.solve(found.covariance, off) < 18.5
    else:
        assert found.why in (Why.AMBIGUOUS, Why.UNCONSTRAINED)


@pytest.mark.parametrize("seed", range(3))
def test_two_different_rooms_have_nothing_in_common(seed: int) -> None:
    one = looks(room(3), around(0.0), around(30.0), seed)
    other = looks(room(40), around(0.0), around(30.0), seed + 100)
    assert isinstance(common_view(one.first, other.second, one.prior), Unknown)


def test_views_away_from_each_other_have_nothing_in_common() -> None:
    at_walls = looking((-1.0, -1.0, -1.3), (1.0, 1.0, -0.8))
    away = looking((-1.2, -1.2, -1.3), (-4.0, -4.0, -0.8))
    seen = looks(room(1), at_walls, away, 0)
    assert isinstance(common_view(seen.first, seen.second, seen.prior), Unknown)


def test_without_depth_it_is_unknown_and_says_so() -> None:
    seen = looks([], around(0.0), around(30.0), 0)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, Unknown)
    assert found.why is Why.FEW_POINTS


def test_a_pose_that_too_few_corners_hold_is_not_given() -> None:
    seen = looks(room(1), around(0.0), around(30.0), 0)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, CommonView)
    enough = Settings(least_corners=found.corners)
    assert isinstance(common_view(seen.first, seen.second, seen.prior, enough), CommonView)
    more = Settings(least_corners=found.corners + 1)
    refused = common_view(seen.first, seen.second, seen.prior, more)
    assert isinstance(refused, Unknown)
    assert refused.why is Why.UNCONSTRAINED
