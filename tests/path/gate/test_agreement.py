"""Box mapping, overlap and threshold: exact where geometry is, and what the paper's corner does
under roll.
"""

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews, depth_in, iou, map_box, threshold
from path.geometry.rigid import rigid
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.observations import Box
from tests.path.gate.compared import compared, own_values

CONFIG = MethodConfig()
CAMERA1 = CameraModel(640, 480, 615.0, 616.0, 320.0, 240.0)
CAMERA2 = CameraModel(1280, 720, 920.0, 925.0, 640.0, 360.0)
LENS = (-0.1, 0.05, 0.001, -0.001, 0.0)
T_V_C1 = Pose(exp(np.array([0.3, -2.0, 0.4])), np.array([0.1, -0.05, -0.2]))
MAPPINGS: tuple[Literal["center", "corner"], ...] = ("center", "corner")

boxes = st.builds(
    Box, st.floats(-50, 600), st.floats(-50, 400), st.floats(1, 200), st.floats(1, 200)
)


def views(distorted: bool = False) -> TwoViews:
    cameras = (CAMERA1, CAMERA2)
    if distorted:
        cameras = (replace(CAMERA1, distortion=LENS), replace(CAMERA2, distortion=LENS))
    return TwoViews(*cameras, rigid(T_V_C1))


def box_of_plate(
    camera: CameraModel, center: tuple[float, float, float], width_m: float, height_m: float
) -> Box:
    """The image of a plate parallel to an undistorted camera's image plane."""
    x, y, z = center
    left, top = camera.project_point((x - width_m / 2, y - height_m / 2, z))
    right, bottom = camera.project_point((x + width_m / 2, y + height_m / 2, z))
    return Box(left, top, right - left, bottom - top)


@given(
    center=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4), st.floats(0.8, 3.0)),
    shift=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.4, 1.5)),
    size=st.tuples(st.floats(0.05, 0.5), st.floats(0.05, 0.5)),
    mapping=st.sampled_from(MAPPINGS),
)
def test_mapping_is_exact_between_parallel_image_planes(
    center: tuple[float, float, float],
    shift: tuple[float, float, float],
    size: tuple[float, float],
    mapping: Literal["center", "corner"],
) -> None:
    in_c2 = (center[0] + shift[0], center[1] + shift[1], center[2] + shift[2])
    T_v_c2 = rigid(T_V_C1 @ Pose(np.eye(3), -np.array(shift)))
    own, peer = box_of_plate(CAMERA1, center, *size), box_of_plate(CAMERA2, in_c2, *size)
    mapped = map_box(views(), T_v_c2, peer, (center[2], in_c2[2]), mapping)
    assert mapped is not None
    assert (mapped.x, mapped.y, mapped.w, mapped.h) == pytest.approx(
        (own.x, own.y, own.w, own.h), abs=1e-6
    )
    assert iou(own, mapped) == pytest.approx(1.0, abs=1e-6)


@given(
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.floats(-3.0, 3.0),
)
def test_a_box_centred_on_the_prior_maps_onto_the_targets_pixel(
    w: tuple[float, float, float], roll: float
) -> None:
    both = views(distorted=True)
    T_c2_c1 = Pose(exp(np.array([0.0, 0.0, roll])) @ exp(np.array(w)), np.array([-0.2, 0.1, 0.5]))
    T_v_c2 = rigid(T_V_C1 @ T_c2_c1.inverse())
    point_c1 = np.array([0.1, 0.05, 2.0])
    x2, y2, z2 = T_c2_c1.apply(point_c1).tolist()
    point_v = T_V_C1.apply(point_c1).tolist()
    assert depth_in(T_v_c2, (point_v[0], point_v[1], point_v[2])) == pytest.approx(z2)
    u, v = both.camera2.project_point((x2, y2, z2))
    mapped = map_box(both, T_v_c2, Box(u - 30.0, v - 20.0, 60.0, 40.0), (2.0, z2), "center")
    assert mapped is not None
    assert mapped.center == pytest.approx(both.camera1.project_point((0.1, 0.05, 2.0)), abs=1e-8)


def roll_overlap(roll_deg: float, mapping: Literal["center", "corner"]) -> float:
    """IoU for a round target of equal boxes in both views, when D2 is D1 rolled about its optical
    axis.
    """
    both = TwoViews(CAMERA1, replace(CAMERA1, fy=615.0), rigid(T_V_C1))
    both = replace(both, camera1=replace(CAMERA1, fy=615.0))
    T_v_c2 = rigid(T_V_C1 @ Pose(exp(np.array([0.0, 0.0, math.radians(roll_deg)])), np.zeros(3)))
    box = Box(320.0 - 40.0, 240.0 - 40.0, 80.0, 80.0)
    mapped = map_box(both, T_v_c2, box, (2.0, 2.0), mapping)
    assert mapped is not None
    return iou(box, mapped)


def test_the_papers_corner_drifts_under_roll_and_the_centre_does_not() -> None:
    corner = [roll_overlap(roll, "corner") for roll in (0.0, 10.0, 30.0, 60.0, 90.0, 180.0)]
    # the corner of a square of side 1 turned by r is off by (cos r - sin r - 1, sin r + cos r - 1)
    # / 2
    expected: list[float] = []
    for roll in (0.0, 10.0, 30.0, 60.0, 90.0, 180.0):
        c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
        common = max(0.0, 1.0 - abs(c - s - 1.0) / 2) * max(0.0, 1.0 - abs(s + c - 1.0) / 2)
        expected.append(common / (2.0 - common))
    assert corner == pytest.approx(expected, abs=1e-9)
    assert corner[4] < 1e-9
    assert corner[5] < 1e-9
    for roll in (0.0, 10.0, 30.0, 60.0, 90.0, 180.0):
        assert roll_overlap(roll, "center") == pytest.approx(1.0)


def test_no_box_when_the_target_is_behind_d1_or_off_the_lens() -> None:
    behind = rigid(T_V_C1 @ Pose(exp(np.array([0.0, math.pi, 0.0])), np.zeros(3)))
    box = Box(600.0, 320.0, 80.0, 80.0)
    assert map_box(views(), behind, box, (2.0, 2.0), "center") is None
    barrel = replace(views(), camera2=replace(CAMERA2, distortion=(-0.2, 0.0, 0.0, 0.0, 0.0)))
    assert (
        map_box(barrel, rigid(T_V_C1), Box(6000.0, 300.0, 80.0, 80.0), (2.0, 2.0), "center") is None
    )


@given(boxes, boxes)
def test_iou_is_symmetric_and_bounded(a: Box, b: Box) -> None:
    assert 0.0 <= iou(a, b) <= 1.0
    assert iou(a, b) == pytest.approx(iou(b, a))
    assert iou(a, a) == pytest.approx(1.0)


@given(boxes, boxes, st.floats(-300, 300), st.floats(-300, 300))
def test_iou_does_not_depend_on_where_the_boxes_are(a: Box, b: Box, du: float, dv: float) -> None:
    moved = [Box(box.x + du, box.y + dv, box.w, box.h) for box in (a, b)]
    assert iou(*moved) == pytest.approx(iou(a, b), abs=1e-6)


def test_iou_of_known_boxes() -> None:
    assert iou(Box(0, 0, 10, 10), Box(5, 0, 10, 10)) == pytest.approx(1.0 / 3.0)
    assert iou(Box(0, 0, 10, 10), Box(10, 0, 10, 10)) == 0.0
    assert iou(Box(0, 0, 10, 10), Box(2, 2, 5, 5)) == pytest.approx(0.25)
    assert iou(Box(0, 0, 0, 10), Box(0, 0, 10, 10)) == 0.0
    assert iou(Box(math.nan, 0, 10, 10), Box(0, 0, 10, 10)) == 0.0


@given(st.floats(0.1, 20.0), st.floats(0.1, 20.0))
def test_threshold_falls_with_distance_between_its_bounds(a: float, b: float) -> None:
    near, far = sorted((a, b))
    assert CONFIG.tau_min < threshold(far, CONFIG) <= threshold(near, CONFIG) <= CONFIG.tau_max


def test_threshold_of_known_distances() -> None:
    assert threshold(CONFIG.z0_m, CONFIG) == pytest.approx(CONFIG.tau_max)
    assert threshold(0.5 * CONFIG.z0_m, CONFIG) == pytest.approx(CONFIG.tau_max)
    assert threshold(2.0 * CONFIG.z0_m, CONFIG) == pytest.approx(
        0.75 * CONFIG.tau_min + 0.25 * CONFIG.tau_max
    )


def test_boxes_are_compared_in_d1s_image() -> None:
    both = TwoViews(CAMERA1, CAMERA1, rigid(T_V_C1))
    point = T_V_C1.apply(np.array([0.0, 0.0, 2.0])).tolist()
    own = Box(280.0, 200.0, 80.0, 80.0)
    values = own_values(own, 2.0, (point[0], point[1], point[2]))
    for aside_px in (0.0, 10.0, 40.0, 90.0):
        found = compared(both, T_V_C1, values, replace(own, x=own.x + aside_px), CONFIG)
        assert found.mapped is not None
        assert found.mapped.x == pytest.approx(own.x + aside_px)
        assert found.iou == pytest.approx(max(0.0, 80.0 - aside_px) / (80.0 + aside_px))
        assert found.range_m == pytest.approx(2.0)


def test_a_target_behind_d2_is_outside() -> None:
    turned = T_V_C1 @ Pose(exp(np.array([0.0, math.pi, 0.0])), np.zeros(3))
    point = T_V_C1.apply(np.array([0.0, 0.0, 2.0])).tolist()
    box = Box(280.0, 200.0, 80.0, 80.0)
    values = own_values(box, 2.0, (point[0], point[1], point[2]))
    assert compared(views(), turned, values, box, CONFIG).mapped is None
