from __future__ import annotations

import math

import numpy as np
import pytest

from path.sensitivity import (
    ReferenceErrors,
    depth_error2,
    directions,
    first_order,
    nominal_camera,
    nominal_pose,
    on_axis,
    project,
    rotation_error2,
    translation_error2,
)

CAMERA, POSE, ERRORS = nominal_camera(), nominal_pose(), ReferenceErrors()
TOWARD = directions(100_000, np.random.default_rng([3]))


def rms(squares: np.ndarray) -> float:
    return math.sqrt(float(np.mean(squares)))


def test_the_nominal_camera_is_the_papers() -> None:
    assert (CAMERA.fx, CAMERA.fy) == (
        pytest.approx(1386.42, abs=0.005),
        pytest.approx(1388.61, abs=0.005),
    )


def test_the_nominal_projection_is_the_papers_and_the_marker_lies_outside() -> None:
    assert project(CAMERA, POSE, on_axis(1.0)) == pytest.approx((540.08, 685.69), abs=0.01)
    u, v = project(CAMERA, POSE, np.zeros(3))
    assert u == pytest.approx(-426.4, abs=0.1)
    assert not CAMERA.contains(u, v)


def test_the_terms_at_one_metre_are_the_papers() -> None:
    depth = rms(depth_error2(CAMERA, POSE, on_axis(1.0), 0.005))
    moved = translation_error2(CAMERA, POSE, on_axis(1.0), ERRORS.translation_m, TOWARD)
    turned = rotation_error2(CAMERA, POSE, on_axis(1.0), ERRORS.rotation_rad, TOWARD)
    pose = rms(moved + turned)
    assert depth == pytest.approx(2.56, abs=0.01)
    assert pose == pytest.approx(17.22, abs=0.05)
    assert math.hypot(depth, pose) == pytest.approx(17.41, abs=0.05)


def test_directions_are_unit_vectors_without_a_preference() -> None:
    assert np.linalg.norm(TOWARD, axis=1) == pytest.approx(1.0)
    assert np.abs(TOWARD.T @ TOWARD / len(TOWARD) - np.eye(3) / 3.0).max() < 0.01
    assert np.abs(TOWARD.mean(axis=0)).max() < 0.01


def test_an_error_of_the_rotation_turns_about_the_origin_of_v() -> None:
    """The marker's own pixel does not move, and the distance of the target to the marker stays."""
    point = np.array([0.2, -0.1, 1.1])
    small = 1e-6
    turned = rotation_error2(CAMERA, POSE, point, small, np.eye(3))
    a, b, c = (POSE.R @ point).tolist()
    J = CAMERA.jacobian(POSE.apply(point)[None])[0]
    expected = [J @ np.cross(axis, (a, b, c)) * small for axis in np.eye(3)]
    assert np.sqrt(turned) == pytest.approx([float(np.linalg.norm(e)) for e in expected], rel=1e-4)
    along = np.array([[a, b, c]]) / math.sqrt(a * a + b * b + c * c)
    assert rotation_error2(CAMERA, POSE, point, 0.5, along)[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("depth_m", [0.6, 1.0, 1.5])
def test_first_order_agrees_with_trying_every_direction(depth_m: float) -> None:
    point = on_axis(depth_m)
    linear = first_order(CAMERA, POSE, point, ERRORS)
    assert rms(depth_error2(CAMERA, POSE, point, ERRORS.depth_m)) == pytest.approx(
        linear.depth, rel=1e-3
    )
    moved = translation_error2(CAMERA, POSE, point, ERRORS.translation_m, TOWARD)
    turned = rotation_error2(CAMERA, POSE, point, ERRORS.rotation_rad, TOWARD)
    assert rms(moved) == pytest.approx(linear.translation, rel=5e-3)
    assert rms(turned) == pytest.approx(linear.rotation, rel=5e-3)
    assert linear.pose == pytest.approx(math.hypot(linear.translation, linear.rotation))
    assert linear.combined == pytest.approx(math.hypot(linear.depth, linear.pose))


def test_a_depth_error_moves_the_target_along_its_ray() -> None:
    point = np.array([0.3, -0.2, 1.0])
    far = project(CAMERA, POSE, point * 1.01)
    squares = depth_error2(CAMERA, POSE, point, 0.01)
    assert squares[0] == pytest.approx(float(np.sum((far - project(CAMERA, POSE, point)) ** 2)))
