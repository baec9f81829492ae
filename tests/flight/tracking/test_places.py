"""Pixels, depths and heights as places, boxes of one object, and the largest that the target can
have: by hand.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from flight.tracking.largest_box import LargestBox
from flight.tracking.objects import by_distance, cut_sides, is_cut, is_larger
from flight.tracking.places import at_height, place, point_in_camera, to_local
from path.camera.model import CameraModel
from path.config import EvidenceConfig, MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection

CAMERA = CameraModel(640, 480, 500.0, 400.0, 320.0, 240.0)
C = math.sqrt(0.5)
# three metres up, looking east and 45 degrees down
EAST_DOWN = Pose(
    np.array([[-1.0, 0.0, 0.0], [0.0, -C, C], [0.0, C, C]]), np.array([1.0, 2.0, -3.0])
)


def box(u: float, v: float, w: float = 40.0, h: float = 30.0) -> Box:
    return Box(u - 0.5 * w, v - 0.5 * h, w, h)


def test_a_box_and_a_depth_are_a_point_and_a_place() -> None:
    assert point_in_camera(box(370.0, 160.0), 2.0, CAMERA) == pytest.approx((0.2, -0.4, 2.0))
    expected = (1.0 - 0.2, 2.0 + C * 0.4 + C * 2.0, -3.0 - C * 0.4 + C * 2.0)
    assert to_local((0.2, -0.4, 2.0), EAST_DOWN) == pytest.approx(expected)


def test_a_pixel_comes_down_to_a_height_where_its_ray_does() -> None:
    assert at_height((320.0, 240.0), CAMERA, EAST_DOWN, -0.5) == pytest.approx((1.0, 4.5, -0.5))
    # 0.2 down per metre ahead is the least: C * (y + 1) = 0.2
    least_v = 240.0 + 400.0 * (0.2 / C - 1.0)
    assert at_height((320.0, least_v + 0.01), CAMERA, EAST_DOWN, -0.5) is not None
    assert at_height((320.0, least_v - 0.01), CAMERA, EAST_DOWN, -0.5) is None


@pytest.mark.parametrize(("sigma_m", "by_depth"), [(0.058 * 2.0, True), (0.0581 * 2.0, False)])
def test_a_coarse_depth_is_bettered_by_the_ground(sigma_m: float, by_depth: bool) -> None:
    found = place(box(320.0, 240.0), Depth(2.0, sigma_m), CAMERA, EAST_DOWN, -0.5)
    expected = (1.0, 2.0 + 2.0 * C, -3.0 + 2.0 * C) if by_depth else (1.0, 4.5, -0.5)
    assert found == pytest.approx(expected)
    level = Pose(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.zeros(3))
    assert place(box(320.0, 240.0), Depth(2.0, 9.0), CAMERA, level, 0.0) == (2.0, 0.0, 0.0)


# --- boxes


@pytest.mark.parametrize(
    ("low", "side", "cut"),
    [
        (1.0, 50.0, (False, False)),
        (0.99, 50.0, (True, False)),
        (50.0, 588.0, (False, False)),
        (50.0, 588.01, (False, True)),
        (0.0, 640.0, (True, True)),
    ],
)
def test_a_side_that_comes_within_a_pixel_and_a_half_of_the_border_is_cut(
    low: float, side: float, cut: tuple[bool, bool]
) -> None:
    assert cut_sides(low, side, 640) == cut
    assert is_cut(Box(low, 100.0, side, 50.0), CAMERA) is any(cut)


def test_a_border_cuts_from_above_and_below_too() -> None:
    assert is_cut(Box(100.0, 0.5, 50.0, 50.0), CAMERA)
    assert is_cut(Box(100.0, 430.0, 50.0, 49.0), CAMERA)
    assert not is_cut(Box(100.0, 428.0, 50.0, 50.0), CAMERA)


@pytest.mark.parametrize(
    ("w", "h", "larger"), [(52.0, 30.0, False), (52.1, 30.0, True), (40.0, 39.1, True)]
)
def test_a_box_that_is_a_third_larger_either_way_has_more_in_it(
    w: float, h: float, larger: bool
) -> None:
    assert is_larger(box(100.0, 100.0, w, h), (40.0, 30.0)) is larger


def found(*boxes: tuple[Box, float]) -> list[Detection]:
    return [Detection(each, score) for each, score in boxes]


def ranked(detections: list[Detection], size_m: tuple[float, float] | None = None) -> list[Box]:
    objects = by_distance(detections, (300.0, 200.0), CAMERA, size_m, None, 2.0)
    return [each.box for each in objects]


def test_objects_come_nearest_first_and_without_what_a_detector_hardly_believes() -> None:
    near, far, poor = box(320.0, 200.0), box(300.0, 260.0), box(300.0, 200.0)
    assert ranked(found((far, 0.3), (near, 0.9), (poor, 0.29))) == [near, far]
    (one,) = by_distance(found((near, 0.9)), (300.0, 200.0), CAMERA, None, None, 2.0)
    assert (one.pixel, one.off_px, one.cut, one.more) == ((320.0, 200.0), 20.0, False, False)
    edge = Box(0.0, 190.0, 30.0, 20.0)
    assert ranked(found((edge, 0.1))) == [edge] and ranked(found((edge, 0.09))) == []


def test_the_middle_of_what_the_border_cuts_is_where_its_size_puts_it() -> None:
    # 0.4 m at 2 m are 100 px wide, 0.2 m are 40 px high
    size_m = (0.4, 0.2)

    def middle(each: Box) -> tuple[float, float]:
        (one,) = by_distance(found((each, 0.9)), (300.0, 200.0), CAMERA, size_m, None, 2.0)
        assert one.cut
        return one.pixel

    assert middle(Box(0.0, 100.0, 60.0, 40.0)) == pytest.approx((10.0, 120.0))
    assert middle(Box(600.0, 100.0, 40.0, 40.0)) == pytest.approx((650.0, 120.0))
    assert middle(Box(100.0, 0.0, 100.0, 10.0)) == pytest.approx((150.0, -10.0))
    assert middle(Box(100.0, 470.0, 100.0, 10.0)) == pytest.approx((150.0, 490.0))
    # never farther inside than the middle of what is left of it
    assert middle(Box(0.0, 100.0, 140.0, 40.0)) == pytest.approx((70.0, 120.0))
    unknown = by_distance(
        found((Box(0.0, 9.0, 60.0, 9.0), 0.9)), (3.0, 2.0), CAMERA, None, None, 2.0
    )
    assert unknown[0].pixel == (30.0, 13.5)


def test_what_is_left_of_a_cut_box_may_be_more_than_the_object() -> None:
    size_m = (0.4, 0.2)
    for width, more in ((130.0, False), (130.1, True)):
        cut = Box(0.0, 100.0, width, 40.0)
        (one,) = by_distance(found((cut, 0.9)), (300.0, 200.0), CAMERA, size_m, None, 2.0)
        assert one.more is more


def test_two_boxes_that_are_the_object_s_size_together_are_the_object() -> None:
    left, right = Box(250.0, 180.0, 60.0, 40.0), Box(300.0, 180.0, 50.0, 40.0)
    far = box(500.0, 400.0)
    (whole, other) = ranked(found((left, 0.9), (far, 0.9), (right, 0.9)), (0.4, 0.2))
    assert whole == Box(250.0, 180.0, 100.0, 40.0) and other == far


def test_a_part_of_the_object_beside_its_box_is_no_other_object() -> None:
    whole, part = Box(250.0, 180.0, 100.0, 40.0), Box(260.0, 185.0, 40.0, 20.0)
    assert ranked(found((whole, 0.9), (part, 0.9)), (0.4, 0.2)) == [whole]
    apart = Box(360.0, 185.0, 40.0, 20.0)
    assert ranked(found((whole, 0.9), (apart, 0.9)), (0.4, 0.2)) == [whole, apart]
    beyond = Box(330.0, 185.0, 75.0, 20.0)  # both together are larger than the object
    assert ranked(found((whole, 0.9), (beyond, 0.9)), (0.4, 0.2)) == [whole, beyond]


# --- the largest box

OWN = EvidenceConfig(span_m=0.6, height_m=1.8)
METHOD = MethodConfig(evidence=OWN)
LEVEL = Pose(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.zeros(3))


def largest() -> LargestBox:
    made = LargestBox.of(CAMERA, METHOD)
    assert made is not None
    return made


def test_where_the_method_states_no_size_nothing_is_too_large() -> None:
    assert LargestBox.of(CAMERA, MethodConfig()) is None


def test_seen_from_the_side_a_cylinder_is_as_wide_as_its_span_and_as_high_as_it_is() -> None:
    spread = math.exp(OWN.size_sigmas * OWN.size_sigma)
    wide_m, high_m = largest().most_m(box(320.0, 240.0), 4.0, LEVEL)
    assert (wide_m, high_m) == pytest.approx((spread * 0.6, spread * 1.8), rel=1e-6)


@pytest.mark.parametrize("side", ["width", "height"])
@pytest.mark.parametrize("sigma_m", [0.0, 0.4])
def test_a_box_is_held_up_to_so_many_deviations_of_its_size(side: str, sigma_m: float) -> None:
    z_m = 4.0
    wide_px, high_px = 0.6 * 500.0 / z_m, 1.8 * 400.0 / z_m
    factor = 1.0
    for _ in range(50):  # the larger a box the surer are its sides
        wider = factor if side == "width" else 1.0
        pixels = 2.0 * METHOD.pixel_sigma_px / min(wider * wide_px, high_px)
        sigma = math.hypot(pixels, sigma_m / z_m, OWN.size_sigma)
        factor = math.exp(OWN.size_sigmas * sigma)
    for times, holds in ((0.99 * factor, True), (1.01 * factor, False)):
        sides = (wide_px * times, high_px) if side == "width" else (wide_px, high_px * times)
        assert largest().holds(box(320.0, 240.0, *sides), z_m, sigma_m, LEVEL) is holds


def test_two_depths_are_of_two_bodies_when_no_one_body_reaches_from_one_to_the_other() -> None:
    least_m = 0.5 * math.hypot(0.6, 1.8)
    apart_m = least_m + OWN.size_sigmas * math.hypot(0.03, 0.04)
    for z_m, apart in ((5.0 + apart_m - 0.001, False), (5.0 + apart_m + 0.001, True)):
        assert largest().apart(Depth(5.0, 0.03), Depth(z_m, 0.04)) is apart
        assert largest().apart(Depth(z_m, 0.04), Depth(5.0, 0.03)) is apart
