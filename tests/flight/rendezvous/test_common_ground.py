"""How much ground two cameras share, and that a viewpoint is planned for it where common views are
on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flight.rendezvous.common_ground import CommonGround
from flight.rendezvous.viewpoint import LEAST_COMMON, Viewpoint, plan_viewpoint
from path.arrays import Array
from path.geometry.transforms import Pose
from tests.flight.rendezvous.test_viewpoint import APART, CAMERA, RULES, Seen, check_rules, pitched
from tests.flight.rendezvous.test_viewpoint import scene as scene_of

HEIGHT_M = 1.5
FARTHEST_M = 4.5


def turned(yaw_deg: float) -> Array:
    c = math.cos(math.radians(yaw_deg))
    s = math.sin(math.radians(yaw_deg))
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ pitched(45.0).R


def ground(
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw_deg: float = 0.0
) -> CommonGround:
    return CommonGround(CAMERA, Pose(turned(yaw_deg), np.array(at_m)), HEIGHT_M, FARTHEST_M)


def share(of: CommonGround, at_m: tuple[float, float, float], yaw_deg: float = 0.0) -> float:
    return float(of.seen_by(CAMERA, np.array([at_m]), turned(yaw_deg)[None, None])[0, 0])


def test_a_camera_shares_all_of_its_view_with_itself_and_nothing_with_one_that_looks_away() -> None:
    assert share(ground(), (0.0, 0.0, 0.0)) == 1.0
    assert share(ground(), (0.0, 0.0, 0.0), 180.0) == 0.0
    assert share(ground(), (30.0, 0.0, 0.0)) == 0.0


def test_what_is_shared_is_less_the_farther_apart_and_the_same_from_either_side() -> None:
    shares = [share(ground(), (0.0, right_m, -0.3)) for right_m in (0.0, 0.4, 0.8, 1.2, 1.6)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.8
    assert shares[-1] < 0.4
    one = (0.0, 0.0, 0.0)
    two = (-0.5, 0.7, -0.4)
    there = CommonGround(CAMERA, Pose(turned(-30.0), np.array(two)), HEIGHT_M, FARTHEST_M)
    assert share(ground(), two, -30.0) == pytest.approx(share(there, one))


def test_ground_that_is_too_far_for_depth_is_not_shared() -> None:
    near = replace(ground(), farthest_m=0.5)
    assert share(near, (0.0, 0.0, 0.0)) == 0.0


@pytest.mark.parametrize("flown_m", [(0.8, 0.8), (0.8, -0.8), (1.2, 0.0)])
def test_a_viewpoint_is_planned_for_what_both_cameras_show_after_the_sender_has_flown_on(
    flown_m: tuple[float, float],
) -> None:
    view = scene_of(side_m=0.08)
    of = ground((0.28 - flown_m[0], -flown_m[1], 0.08))
    by_marker = plan_viewpoint(view, CAMERA, pitched(45.0), RULES, APART)
    by_both = plan_viewpoint(view, CAMERA, pitched(45.0), RULES, APART, ground=of)
    assert isinstance(by_marker, Viewpoint)
    assert isinstance(by_both, Viewpoint)
    check_rules(Seen(view, by_both))
    lost = share(of, by_marker.camera_h_m, math.degrees(by_marker.yaw_h_rad))
    assert by_both.common == pytest.approx(
        share(of, by_both.camera_h_m, math.degrees(by_both.yaw_h_rad))
    )
    assert by_both.common >= max(LEAST_COMMON, lost)
    # it looks to the side from which the sender came
    assert by_both.yaw_h_rad * flown_m[1] <= 0.0


def test_where_no_place_shows_enough_in_common_the_viewpoint_is_where_there_is_the_most() -> None:
    far = ground((-4.0, 0.0, 0.0))
    found = plan_viewpoint(scene_of(side_m=0.08), CAMERA, pitched(45.0), RULES, APART, ground=far)
    assert isinstance(found, Viewpoint)
    assert 0.0 < found.common < LEAST_COMMON
