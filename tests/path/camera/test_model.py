"""The camera against OpenCV, against itself inverted, and against calibrations that cannot be
right.
"""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from path.camera.model import CameraModel

PLAIN = CameraModel(640, 480, 615.0, 616.0, 319.5, 239.5)

coefficients = st.tuples(
    st.floats(-0.2, 0.2),
    st.floats(-0.05, 0.1),
    st.floats(-0.005, 0.005),
    st.floats(-0.005, 0.005),
    st.floats(-0.02, 0.02),
)
cameras = coefficients.map(lambda distortion: replace(PLAIN, distortion=distortion))
points = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.38, 0.38), st.floats(0.3, 6.0)).map(
    lambda p: (p[0] * p[2], p[1] * p[2], p[2])
)


@given(cameras, points)
def test_projection_is_opencvs(camera: CameraModel, point: tuple[float, float, float]) -> None:
    expected, derivatives = cv2.projectPoints(
        np.array([point]), np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )
    assert camera.project_point(point) == pytest.approx(expected.ravel().tolist(), abs=1e-9)
    np.testing.assert_allclose(camera.project(np.array([point])), expected[:, 0], atol=1e-9)
    # OpenCV's derivative by translation is the derivative by the point
    np.testing.assert_allclose(
        camera.jacobian(np.array([point]))[0], derivatives[:, 3:6], rtol=1e-9, atol=1e-9
    )


@given(cameras, points)
def test_ray_undoes_projection(camera: CameraModel, point: tuple[float, float, float]) -> None:
    u, v = camera.project_point(point)
    expected = (point[0] / point[2], point[1] / point[2])
    assert camera.ray(u, v) == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(camera.rays(np.array([[u, v]]))[0], expected, atol=1e-12)


@given(cameras, st.floats(0.0, 639.0), st.floats(0.0, 479.0))
def test_projection_undoes_ray(camera: CameraModel, u: float, v: float) -> None:
    x, y = camera.ray(u, v)
    assert camera.project_point((x, y, 1.0)) == pytest.approx((u, v), abs=1e-9)


def test_behind_the_camera_there_is_no_pixel() -> None:
    assert math.isnan(PLAIN.project_point((0.1, 0.1, 0.0))[0])
    assert np.isnan(PLAIN.project(np.array([[0.1, 0.1, -1.0]]))).all()
    assert not PLAIN.sees((0.0, 0.0, -1.0))


def test_points_folded_back_by_the_distortion_are_not_seen() -> None:
    barrel = replace(PLAIN, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0))
    far_off_axis = (1.7, 0.0, 1.0)
    assert barrel.contains(*barrel.project_point(far_off_axis))
    assert not barrel.sees(far_off_axis)
    assert barrel.sees((0.4, 0.0, 1.0))
    assert barrel.max_radius == pytest.approx(math.sqrt(1.0 / 0.9))


def test_a_pixel_no_ray_leads_to_is_nan_in_both_forms() -> None:
    barrel = replace(PLAIN, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0))
    assert math.isnan(barrel.ray(3000.0, 239.5)[0])
    rays = barrel.rays(np.array([[3000.0, 239.5], [400.0, 200.0]]))
    assert np.isnan(rays[0]).all()
    assert np.isfinite(rays[1]).all()


def test_image_borders_are_half_a_pixel_outside_the_outer_centres() -> None:
    assert PLAIN.contains(-0.5, 479.4)
    assert not PLAIN.contains(639.5, 0.0)
    assert not PLAIN.contains(10.0, 10.0, margin_px=11.0)
    assert not PLAIN.contains(math.nan, 10.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("width", 0),
        ("height", 480.0),
        ("fx", -615.0),
        ("fy", math.nan),
        ("cx", 700.0),
        ("cy", math.inf),
        ("distortion", (0.1, 0.2)),
        ("distortion", (0.1, math.nan, 0.0, 0.0, 0.0)),
        ("distortion", (-2.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_impossible_intrinsics_are_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{field}:"):
        replace(PLAIN, **{field: value})
