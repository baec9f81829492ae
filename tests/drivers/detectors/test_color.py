"""The colour detector on rendered frames against the true outlines, and on drawn ones for its
rules.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from hil.render.renderer import Renderer
from hil.render.scene import CAR_BOXES
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.gate.agreement import iou
from path.geometry.rotation import R_from_rpy, R_from_yaw
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, Extent, Region

CAMERA = CameraModel(640, 480, 615.0, 613.0, 318.5, 241.0, (0.08, -0.18, 0.0005, -0.0007, 0.0))
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
DOWN = math.sqrt(0.5)
T_B_C = Pose(
    np.array([[0.0, -DOWN, DOWN], [1.0, 0.0, 0.0], [0.0, DOWN, DOWN]]), np.array([0.1, 0.0, 0.02])
)
T_B_V = Pose(
    np.array([[0.0, DOWN, -DOWN], [1.0, 0.0, 0.0], [0.0, -DOWN, -DOWN]]),
    np.array([-0.18, 0.0, -0.06]),
)
ORANGE = (24, 118, 245)


@cache
def renderer() -> Renderer:
    return Renderer(CAMERA, T_B_C, T_B_V, single_marker())


def scene(rng: np.random.Generator, gap_m: float, count: int) -> Snapshot:
    """The sender looks at a target with ``count`` look-alikes at ``gap_m`` around it; the receiver
    is far away.
    """
    height = rng.uniform(1.2, 2.0)
    attitude = R_from_rpy(rng.normal(0.0, 0.04), rng.normal(0.0, 0.04), 0.0)
    first = rng.uniform(0.0, 2.0 * math.pi)
    around = [first + 2.0 * math.pi * k / max(count, 1) for k in range(count)]
    places = [(0.0, 0.0), *((gap_m * math.cos(a), gap_m * math.sin(a)) for a in around)]
    objects = tuple(
        ObjectTruth(i, (e, n, 0.0), rng.uniform(0.0, 2.0 * math.pi), 0.0)
        for i, (e, n) in enumerate(places)
    )
    sender = Pose(NED_TO_ENU @ attitude, np.array([0.0, -height - 0.1, height]))
    away = Pose(NED_TO_ENU, np.array([0.0, -9.0, 2.0]))
    drones = {Role.SENDER: sender, Role.RECEIVER: away}
    return Snapshot(
        0.0,
        {role: DroneTruth(T, (0.0, 0.0, 0.0), 0.0, True) for role, T in drones.items()},
        objects,
    )


def silhouette(snapshot: Snapshot, thing: ObjectTruth) -> Box:
    """Bounding box of the object's corners in the sender's image."""
    unit = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = np.concatenate(
        [unit * np.array(size) + np.array(center) for center, size, _ in CAR_BOXES]
    )
    T_w_o = Pose(R_from_yaw(thing.yaw_rad), np.array(thing.position_w_m))
    T_c_w = (snapshot.drones[Role.SENDER].T_w_b @ T_B_C).inverse()
    pixels = CAMERA.project((T_c_w @ T_w_o).apply(corners))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return Box(low[0], low[1], high[0] - low[0], high[1] - low[1])


def whole(box: Box) -> bool:
    return (
        box.x > 1.0
        and box.y > 1.0
        and box.x + box.w < CAMERA.width - 2
        and box.y + box.h < CAMERA.height - 2
    )


def detector(**settings: Any) -> ColorDetector:
    return ColorDetector(ColorDetectorConfig(**settings))


def drawn(
    *rectangles: tuple[int, int, int, int], color: tuple[int, int, int] = ORANGE
) -> NDArray[np.uint8]:
    """Rectangles ``x y w h`` on grey."""
    image = np.full((480, 640, 3), 100, np.uint8)
    for x, y, w, h in rectangles:
        image[y : y + h, x : x + w] = color
    return image


def overlaps(gap_m: float, count: int, scenes: int) -> list[float]:
    """IoU of each whole car's outline with the best detection; detections must not outnumber the
    cars.
    """
    rng = np.random.default_rng(11)
    best: list[float] = []
    for k in range(scenes):
        snapshot = scene(rng, gap_m, count)
        image, _ = renderer().render(snapshot, Role.SENDER, k)
        found = [d.box for d in detector().detect(image, None) if d.score > 0.5]
        assert len(found) <= 1 + count
        for thing in snapshot.objects:
            outline = silhouette(snapshot, thing)
            if whole(outline):
                best.append(max((iou(outline, box) for box in found), default=0.0))
    return best


def test_boxes_are_those_of_the_true_outlines() -> None:
    best = overlaps(1.0, 3, 24)
    assert np.median(best) >= 0.95
    assert np.mean(np.array(best) >= 0.9) >= 0.9


def test_look_alikes_a_car_and_a_half_apart_are_not_merged() -> None:
    best = overlaps(0.6, 3, 24)
    assert np.median(best) >= 0.95
    assert np.mean(np.array(best) >= 0.8) >= 0.95


def test_the_box_is_not_biased() -> None:
    rng = np.random.default_rng(3)
    errors: list[tuple[float, float]] = []
    for k in range(12):
        snapshot = scene(rng, 1.0, 0)
        outline = silhouette(snapshot, snapshot.objects[0])
        image, _ = renderer().render(snapshot, Role.SENDER, k)
        (u, v), (a, b) = detector().detect(image, None)[0].box.center, outline.center
        errors.append((u - a, v - b))
    assert np.abs(np.median(errors, axis=0)).max() < 0.4


def test_nothing_is_found_on_empty_ground() -> None:
    rng = np.random.default_rng(5)
    for k in range(8):
        snapshot = scene(rng, 1.0, 0)
        empty = Snapshot(0.0, snapshot.drones, ())
        assert not detector().detect(renderer().render(empty, Role.SENDER, k)[0], None)


def test_a_region_gives_the_same_box_and_only_what_is_centred_in_it() -> None:
    snapshot = scene(np.random.default_rng(8), 0.9, 3)
    image, _ = renderer().render(snapshot, Role.SENDER, 0)
    everything = detector().detect(image, None)
    target = max(everything, key=lambda d: iou(d.box, silhouette(snapshot, snapshot.objects[0])))
    u, v = target.box.center
    found = detector().detect(image, Region(u - 20.0, v - 20.0, u + 20.0, v + 20.0))
    assert [iou(d.box, target.box) for d in found] == pytest.approx([1.0], abs=0.03)
    beside = detector().detect(image, Region(u + 20.0, 0.0, 640.0, 480.0))
    expected = sorted(d.box.center[0] for d in everything if d.box.center[0] >= u + 20.0)
    assert len(expected) == 2
    assert sorted(d.box.center[0] for d in beside) == pytest.approx(expected, abs=1.0)
    assert not detector().detect(image, Region(-90.0, -90.0, -10.0, -10.0))


def test_edges_between_pixels_are_found() -> None:
    image = drawn()
    image[200:320, 200:360] = cv2.resize(
        drawn((102, 101, 161, 122)), (160, 120), interpolation=cv2.INTER_AREA
    )
    box = detector().detect(image, None)[0].box
    # A drawn rectangle ends half a pixel outside its first and last pixel's centre.
    assert (box.x, box.y) == pytest.approx((200 + 102 / 4 - 0.5, 200 + 101 / 4 - 0.5), abs=0.4)
    assert (box.w, box.h) == pytest.approx((161 / 4, 122 / 4), abs=0.6)


@pytest.mark.parametrize("corner", [(0, 200), (600, 200), (300, 0), (300, 450)])
def test_what_the_border_cuts_gets_a_low_score(corner: tuple[int, int]) -> None:
    x, y = corner
    cut = detector().detect(drawn((x, y, 40, 30)), None)
    inside = detector().detect(drawn((300, 200, 40, 30)), None)
    assert cut[0].score < 0.3
    assert inside[0].score > 0.8


def test_dark_parts_that_touch_belong_to_the_vehicle() -> None:
    image = drawn((300, 200, 80, 50))
    image[250:264, 310:330] = image[250:264, 350:370] = 30  # wheels
    image[100:110, 100:110] = 30  # a stone
    box = detector().detect(image, None)[0].box
    assert box.y + box.h == pytest.approx(263.5, abs=0.6)


def test_something_dark_that_goes_on_is_not_part_of_the_vehicle() -> None:
    image = drawn((300, 200, 80, 50))
    image[250:480, 320:330] = 30
    box = detector().detect(image, None)[0].box
    assert box.y + box.h == pytest.approx(249.5, abs=5.0)


def test_parts_of_one_vehicle_are_joined() -> None:
    found = detector().detect(drawn((300, 200, 80, 24), (300, 228, 80, 30)), None)
    assert len(found) == 1
    assert found[0].box.h == pytest.approx(58.0, abs=1.0)


def test_two_that_touch_at_a_corner_are_told_apart() -> None:
    found = detector().detect(drawn((300, 200, 80, 60), (364, 256, 80, 60)), None)
    assert sorted(d.box.w for d in found) == pytest.approx([80.0, 80.0], abs=10.0)


def test_one_of_two_that_touch_is_found_in_a_region_around_it_as_in_the_whole_image() -> None:
    image = drawn((300, 200, 80, 60), (364, 256, 80, 60))
    for whole in detector().detect(image, None):
        u, v = whole.box.center
        found = detector().detect(image, Region(u - 15.0, v - 15.0, u + 15.0, v + 15.0))
        assert [iou(d.box, whole.box) for d in found] == pytest.approx([1.0], abs=0.05)


# one dent alone, above; the feet stand in line
STEP = drawn((200, 120, 60, 90), (260, 150, 60, 60))
EVERYWHERE = Region(0.0, 0.0, 640.0, 480.0)
SMALLER = replace(EVERYWHERE, extent=Extent(longest_px=100.0))
CORNERED = (300, 200, 80, 60), (364, 256, 80, 60)


def boxes(image: NDArray[np.uint8], region: Region) -> list[Box]:
    """Boxes found, from left to right."""
    return sorted((each.box for each in detector().detect(image, region)), key=lambda box: box.x)


def test_two_that_touch_and_are_longer_than_one_can_be_are_told_apart_at_one_dent() -> None:
    (one,) = boxes(STEP, EVERYWHERE)
    assert one.w == pytest.approx(120.0, abs=1.0)
    left, right = boxes(STEP, SMALLER)
    assert iou(left, Box(199.5, 119.5, 60.0, 90.0)) > 0.85
    assert iou(right, Box(259.5, 149.5, 60.0, 60.0)) > 0.7  # the cut is not quite upright


def test_two_that_touch_and_are_larger_than_one_can_be_are_told_apart_too() -> None:
    assert len(boxes(STEP, replace(EVERYWHERE, extent=Extent(70.0, 96.0, 200.0)))) == 2
    assert len(boxes(STEP, replace(EVERYWHERE, extent=Extent(100.0, 120.0, 200.0)))) == 1


def test_what_is_too_long_and_has_no_dent_stays_whole() -> None:
    nearer = drawn((200, 120, 160, 120))
    assert boxes(nearer, SMALLER) == boxes(nearer, EVERYWHERE)


def test_one_that_is_nearer_is_not_cut_at_a_dent() -> None:
    # as a neck between shoulders
    dented = drawn((200, 120, 160, 130), (215, 110, 50, 10), (295, 110, 50, 10))
    (one,) = boxes(dented, replace(EVERYWHERE, extent=Extent(70.0, 90.0, 100.0)))
    assert one.w == pytest.approx(160.0, abs=1.0)


def test_parts_are_joined_no_further_than_one_object_reaches() -> None:
    image = drawn((300, 200, 80, 60), (300, 264, 80, 60))
    (one,) = boxes(image, EVERYWHERE)
    assert one.h == pytest.approx(124.0, abs=1.0)
    assert [box.h for box in boxes(image, SMALLER)] == pytest.approx([60.0, 60.0], abs=8.0)


def test_something_dark_that_makes_it_longer_than_one_can_be_is_not_part_of_it() -> None:
    image = drawn((300, 200, 80, 60))
    image[220:240, 380:400] = 30
    (with_dark,), (alone,) = (
        boxes(image, EVERYWHERE),
        boxes(image, replace(EVERYWHERE, extent=Extent(longest_px=92.0))),
    )
    assert (with_dark.w, alone.w) == pytest.approx((100.0, 80.0), abs=4.0)


def test_what_is_smaller_than_one_object_is_not_two_that_touch() -> None:
    assert len(boxes(drawn(*CORNERED), EVERYWHERE)) == 2
    assert (
        len(boxes(drawn(*CORNERED), replace(EVERYWHERE, extent=Extent(150.0, 180.0, 200.0)))) == 1
    )


def test_two_in_line_are_not_one_good_vehicle() -> None:
    found = detector().detect(drawn((300, 200, 200, 50)), None)
    assert all(d.score < 0.4 for d in found)


@pytest.mark.parametrize("size", [6, 400])
def test_too_small_or_too_large_is_no_vehicle(size: int) -> None:
    assert not detector().detect(drawn((100, 40, size, size)), None)


def test_another_colour_is_another_vehicle() -> None:
    green = drawn((300, 200, 80, 50), color=(30, 220, 40))
    assert not detector().detect(green, None)
    assert len(detector(hue_deg=120.0).detect(green, None)) == 1
    assert len(detector(hue_halfwidth_deg=180.0).detect(green, None)) == 1


@pytest.mark.parametrize("color", [(20, 30, 230), (60, 20, 230)])
def test_hue_wraps_around_red(color: tuple[int, int, int]) -> None:
    for hue_deg in (0.0, 360.0):
        assert (
            len(detector(hue_deg=hue_deg).detect(drawn((300, 200, 80, 50), color=color), None)) == 1
        )
