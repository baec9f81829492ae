"""How large the place is that the receiver looks at for the marker, and what its settings are made
of.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.rig.parts import Mount
from flight.config import MissionConfig
from flight.rendezvous.marker_view import MarkerView
from path.config import MethodConfig
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Matrix, Pose
from path.observations import Region
from tests.flight.rendezvous.test_marker_view import (
    CAMERA,
    FRAME_NS,
    LAYOUT,
    MOUNT,
    MS,
    NEAR,
    R_N_C,
    TURNED,
    Watch,
)

HALF_DIAGONAL_M = math.sqrt(2.0) * 0.02  # of the printed 40 mm


def where(
    T_c_v: Pose, sigma_m: float = 0.01, unseen_s: float = 0.0
) -> tuple[Region | None, Pose | None]:
    """Where a view looks whose filter says that the marker is there."""
    watch = Watch()

    def predict(*_: object) -> object:
        return SimpleNamespace(T_c_v=T_c_v, sigma_m=sigma_m)

    def unseen(_stamp_ns: int) -> float:
        return unseen_s

    stand_in: Any = SimpleNamespace(predict=predict, unseen_s=unseen)
    watch.view._filter = stand_in
    return watch.view._where(watch.stamp_ns, R_N_C, None)


@pytest.mark.parametrize("sigma_m", [0.0, 0.02])
def test_the_region_is_that_of_the_corners_with_room_for_the_plate_and_for_three_standard_deviations(
    sigma_m: float,
) -> None:
    """12 mm and a tenth of the plate's reach beside the corners, 12 px beside all of it."""
    region, _ = where(NEAR, sigma_m)
    corners_c = NEAR.apply(LAYOUT.markers[0].corners_v)
    pixels = CAMERA.project(corners_c)
    room_px = (
        CAMERA.fx * (0.012 + 0.1 * HALF_DIAGONAL_M + 3.0 * sigma_m) / float(corners_c[:, 2].min())
        + 12.0
    )
    (left, top), (right, bottom) = pixels.min(axis=0) - room_px, pixels.max(axis=0) + room_px
    assert region is not None
    assert (region.x0, region.y0, region.x1, region.y1) == pytest.approx((left, top, right, bottom))


@pytest.mark.parametrize(("distance_m", "known"), [(0.101, True), (0.099, False)])
def test_a_marker_nearer_than_ten_centimetres_is_looked_for_everywhere(
    distance_m: float, known: bool
) -> None:
    region, expected = where(Pose(TURNED, np.array([0.0, 0.0, distance_m])))
    assert (region is not None, expected is not None) == (known, known)


@pytest.mark.parametrize(("unseen_s", "expects"), [(0.15, True), (0.151, False)])
def test_a_marker_is_expected_at_its_place_for_0_15_seconds(unseen_s: float, expects: bool) -> None:
    region, expected = where(NEAR, unseen_s=unseen_s)
    assert region is not None
    assert expected is (NEAR if expects else None)


def test_a_slow_camera_s_fixes_are_counted_for_eight_of_its_frames() -> None:
    watch = Watch()
    for _ in range(12):
        watch.look(NEAR, after_ns=100 * MS)
    assert watch.view.fixes(watch.stamp_ns) == 8
    assert watch.view.fixes(watch.stamp_ns + 100 * MS) == 7
    assert watch.view.fixes(watch.stamp_ns + 800 * MS) == 0


def test_the_first_look_is_no_frame_after_another() -> None:
    watch = Watch()
    watch.look(NEAR)
    assert watch.view._frame_ns == 0
    watch.look(NEAR)
    assert watch.view._frame_ns == FRAME_NS
    assert watch.view.fixes(watch.stamp_ns + 499 * MS) == 1


def test_the_whole_image_is_searched_again_after_the_period_and_not_a_nanosecond_before() -> None:
    watch = Watch()
    watch.view.search_every = 3
    period_ns = 3 * round(1e9 / MissionConfig().search_hz)
    watch.look(None)
    assert watch.last.asked == [None]
    watch.look(None, after_ns=period_ns - 1)
    assert watch.last.asked == [] and not watch.view.searched(watch.stamp_ns)
    watch.look(None, after_ns=1)
    assert watch.last.asked == [None] and watch.view.searched(watch.stamp_ns)


def test_a_view_is_made_with_the_mission_s_angles_the_method_s_limits_and_both_levers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    levers: dict[str, Matrix] = {}

    def made(_settings: object, *, lever_c_m: Matrix, lever_v_m: Matrix) -> object:
        levers.update(c=lever_c_m, v=lever_v_m)
        return SimpleNamespace()

    monkeypatch.setattr("flight.rendezvous.marker_view.RelativeFilter", made)
    T_b_c = Pose(R_from_rpy(0.3, -0.2, 0.9), np.array([0.1, 0.02, -0.03]))
    T_b_v = Pose(R_from_rpy(-0.5, 0.4, 2.0), np.array([-0.2, 0.05, 0.04]))
    mission = replace(MissionConfig(), attitude_sigma_deg=0.7)
    method = replace(MethodConfig(), max_incidence_deg=55.0, max_pose_sigma_m=0.07)
    settings = MarkerView(LAYOUT, CAMERA, Mount(T_b_c, T_b_v), method, mission)._settings
    assert (
        settings.attitude_c_sigma_rad
        == settings.attitude_v_sigma_rad
        == pytest.approx(math.radians(0.7))
    )
    assert settings.max_incidence_rad == pytest.approx(math.radians(55.0))
    assert settings.max_sigma_m == 0.07
    assert levers["c"] == pytest.approx(-T_b_c.inverse().t)
    assert levers["v"] == pytest.approx(-T_b_v.inverse().t)


def test_a_view_searches_as_often_as_told_until_it_is_told_otherwise() -> None:
    view = MarkerView(LAYOUT, CAMERA, MOUNT, MethodConfig(), MissionConfig())
    assert view.search_every == 1
    assert view.fixes(0) == 0
