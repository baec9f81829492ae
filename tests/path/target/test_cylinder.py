"""The cylinder that a target fits into: how far it reaches in an image, and where the middle of its
box is.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from path.geometry.rigid import rigid, transform, transform_back
from path.geometry.transforms import Pose
from path.messages import Vec3
from path.target.cylinder import box_middle_v, middle_v, reach_m

Array = NDArray[np.float64]
DOWN: Vec3 = (0.0, 0.0, 1.0)
CAR_M, PERSON_M = (0.36, 0.16), (0.77, 1.75)
MIDDLE: Vec3 = (0.0, 0.0, 0.0)


def looking(elevation_deg: float, distance_m: float, azimuth_deg: float = 0.0) -> Pose:
    """``T_v_c`` of a camera that looks at the origin from above: ``v`` has z down, the image's x is
    level.
    """
    down, level = math.sin(math.radians(elevation_deg)), math.cos(math.radians(elevation_deg))
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    ahead, right = np.array([level * c, level * s, down]), np.array([-s, c, 0.0])
    R = np.column_stack((right, np.cross(ahead, right), ahead))
    return Pose(R, -distance_m * ahead)


def rims(span_m: float, height_m: float) -> Array:
    turns = np.linspace(0.0, 2.0 * math.pi, 721)
    rim = 0.5 * span_m * np.stack((np.cos(turns), np.sin(turns), np.zeros(721)), axis=1)
    return np.concatenate(
        [rim + np.array((0.0, 0.0, 0.5 * side * height_m)) for side in (-1.0, 1.0)]
    )


def middle_of_box(T_v_c: Pose, body: Array) -> Array:
    x, y, z = T_v_c.inverse().apply(body).T
    return np.array([0.5 * (np.min(a / z) + np.max(a / z)) for a in (x, y)])


@pytest.mark.parametrize(
    ("elevation_deg", "high_m"),
    [(0.0, CAR_M[1]), (90.0, CAR_M[0]), (30.0, CAR_M[1] * math.cos(math.pi / 6) + CAR_M[0] * 0.5)],
)
def test_what_a_cylinder_fills_of_an_image_as_by_hand(elevation_deg: float, high_m: float) -> None:
    T_v_c = rigid(looking(elevation_deg, 3.0))
    assert reach_m(T_v_c, MIDDLE, DOWN, *CAR_M) == pytest.approx((CAR_M[0], high_m))


def test_a_camera_that_is_turned_about_its_axis_has_the_sides_the_other_way_round() -> None:
    T_v_c = looking(20.0, 3.0)
    turned = Pose(T_v_c.R @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), T_v_c.t)
    wide, high = reach_m(rigid(T_v_c), MIDDLE, DOWN, *CAR_M)
    assert reach_m(rigid(turned), MIDDLE, DOWN, *CAR_M) == pytest.approx((high, wide))


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.5, -0.3), (-0.6, 0.3)])
def test_what_a_cylinder_fills_is_what_its_points_do_anywhere_in_the_image(
    off: tuple[float, float],
) -> None:
    # so small that its perspective does not matter
    T_v_c, z_m, small = looking(35.0, 3.0), 3.0, 1e-4
    point_v = transform(rigid(T_v_c), (off[0] * z_m, off[1] * z_m, z_m))
    x, y, z = T_v_c.inverse().apply(rims(*CAR_M) * small + point_v).T
    seen = np.ptp(x / z) * z_m / small, np.ptp(y / z) * z_m / small
    assert reach_m(rigid(T_v_c), point_v, DOWN, *CAR_M) == pytest.approx(seen, rel=1e-3)


@pytest.mark.parametrize("body_m", [CAR_M, PERSON_M])
@pytest.mark.parametrize("off", [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.25)])
@pytest.mark.parametrize(("elevation_deg", "distance_m"), [(10.0, 3.0), (45.0, 3.4), (80.0, 3.0)])
def test_the_middle_of_a_box_is_where_the_rims_have_it(
    body_m: tuple[float, float], off: tuple[float, float], elevation_deg: float, distance_m: float
) -> None:
    T_v_c = looking(elevation_deg, distance_m)
    middle = transform(rigid(T_v_c), (off[0] * distance_m, off[1] * distance_m, distance_m))
    x, y = middle_of_box(T_v_c, rims(*body_m) + middle) * distance_m
    expected = transform_back(rigid(T_v_c), box_middle_v(rigid(T_v_c), middle, DOWN, *body_m))
    # the rim's point that reaches farthest is taken to be the one that does so to first order
    assert expected == pytest.approx((x, y, distance_m), abs=0.02 * max(body_m))


def test_the_middle_of_a_persons_box_from_above_is_above_theirs() -> None:
    T_v_c = rigid(looking(45.0, 3.4))
    assert box_middle_v(T_v_c, MIDDLE, DOWN, *PERSON_M)[2] < -0.06


@pytest.mark.parametrize("azimuth_deg", [-80.0, 60.0])
@pytest.mark.parametrize("elevation_deg", [20.0, 45.0, 70.0])
def test_two_cameras_mean_the_same_middle_of_a_body_half_as_thick_as_it_is_wide(
    azimuth_deg: float, elevation_deg: float
) -> None:
    """D1's ray meets the body's side (or its top), and both of its boxes are of the same
    cylinder.
    """
    span_m, height_m = PERSON_M
    T_1, T_2 = looking(45.0, 3.4), looking(elevation_deg, 2.8, azimuth_deg)
    x, y = middle_of_box(T_1, rims(span_m, height_m))
    ray = T_1.R @ np.array([x, y, 1.0])
    # where it comes nearest to the axis, less a quarter of the diameter
    depth = -float(T_1.t[:2] @ ray[:2]) / float(ray[:2] @ ray[:2])
    surface = T_1.t + (depth - 0.25 * span_m / float(np.hypot(*ray[:2]))) * ray
    found = middle_v(rigid(T_1), tuple(surface.tolist()), DOWN, span_m, height_m)  # type: ignore[arg-type]
    seen = middle_of_box(T_2, rims(span_m, height_m))

    def off_m(middle: Vec3) -> float:
        x, y, z = transform_back(rigid(T_2), middle)
        return z * math.hypot(x / z - seen[0], y / z - seen[1])

    on_surface: Vec3 = tuple(surface.tolist())  # type: ignore[assignment]
    assert off_m(on_surface) > 0.15
    assert off_m(box_middle_v(rigid(T_2), found, DOWN, span_m, height_m)) < 0.03


def test_a_camera_inside_the_body_moves_nothing() -> None:
    T_v_c = rigid(looking(45.0, 0.5))
    assert box_middle_v(T_v_c, MIDDLE, DOWN, *PERSON_M) == MIDDLE
