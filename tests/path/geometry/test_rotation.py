"""Rotations: every way round and back, and the same answer by quaternion, by matrix and by twelve
floats.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from path.geometry import rotation
from path.geometry.rigid import inverse_as_quat, rigid, rigid_from_quat, transform, transform_back
from path.geometry.transforms import Pose

angles = st.floats(-math.pi, math.pi)
vectors = st.tuples(angles, angles, angles).map(np.array).filter(lambda w: np.linalg.norm(w) < 3.1)


@given(vectors)
def test_exp_and_log_undo_each_other(w: np.ndarray) -> None:
    R = rotation.exp(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation.log(R), w, atol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, math.pi - 1e-9, math.pi])
def test_log_near_its_hard_angles(axis: int, angle: float) -> None:
    w = np.zeros(3)
    w[axis] = angle
    assert np.linalg.norm(rotation.log(rotation.exp(w))) == pytest.approx(angle, abs=1e-9)
    assert rotation.angle_between(np.eye(3), rotation.exp(w)) == pytest.approx(angle, abs=1e-9)


@given(vectors, vectors, st.tuples(angles, angles, angles))
def test_quaternions_do_what_matrices_do(
    a: np.ndarray, b: np.ndarray, point: tuple[float, float, float]
) -> None:
    A, B = rotation.exp(a), rotation.exp(b)
    qa, qb = rotation.quat_from_R(A), rotation.quat_from_R(B)
    np.testing.assert_allclose(rotation.R_from_quat(qa), A, atol=1e-12)
    np.testing.assert_allclose(rotation.R_from_quat(rotation.multiply(qa, qb)), A @ B, atol=1e-12)
    np.testing.assert_allclose(rotation.rotate(qa, point), A @ point, atol=1e-12)
    np.testing.assert_allclose(
        rotation.rotate(rotation.conjugate(qa), point), A.T @ point, atol=1e-12
    )


@given(angles, st.floats(-1.5, 1.5), angles)
def test_roll_pitch_yaw_are_aerospace_angles(roll: float, pitch: float, yaw: float) -> None:
    q = rotation.quat_from_rpy(roll, pitch, yaw)
    x, y, z = (
        rotation.exp(angle * axis)
        for angle, axis in zip((roll, pitch, yaw), np.eye(3), strict=True)
    )
    np.testing.assert_allclose(rotation.R_from_rpy(roll, pitch, yaw), z @ y @ x, atol=1e-12)
    np.testing.assert_allclose(rotation.R_from_yaw(yaw), z, atol=1e-12)
    for found, given_angle in zip(rotation.rpy_from_quat(q), (roll, pitch, yaw), strict=True):
        assert rotation.wrapped(found - given_angle) == pytest.approx(0.0, abs=1e-9)
    assert rotation.yaw_of(q) == rotation.rpy_from_quat(q)[2]


def test_a_level_body_heading_east_has_a_yaw_of_a_quarter_turn() -> None:
    east = rotation.quat_from_rpy(0.0, 0.0, math.pi / 2)
    assert rotation.R_from_quat(east)[:, 0] == pytest.approx((0.0, 1.0, 0.0))
    assert rotation.yaw_of(east) == pytest.approx(math.pi / 2)


@given(vectors, vectors, st.floats(0.0, 1.0))
def test_slerp_stays_on_the_arc(a: np.ndarray, b: np.ndarray, fraction: float) -> None:
    A, B = rotation.exp(a), rotation.exp(b)
    whole = rotation.angle_between(A, B)
    assume(whole < 3.0)
    q = rotation.slerp(rotation.quat_from_R(A), rotation.quat_from_R(B), fraction)
    assert rotation.angle_between(A, rotation.R_from_quat(q)) == pytest.approx(
        fraction * whole, abs=1e-5
    )
    assert rotation.angle_between(rotation.R_from_quat(q), B) == pytest.approx(
        (1.0 - fraction) * whole, abs=1e-5
    )


@pytest.mark.parametrize(
    "q", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0.0, 0.0, 0.0)]
)
def test_a_quaternion_without_direction_is_refused(q: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="no direction"):
        rotation.R_from_quat(q)


@given(vectors, vectors, vectors)
def test_twelve_floats_are_the_pose(w: np.ndarray, t: np.ndarray, point: np.ndarray) -> None:
    pose = Pose(rotation.exp(w), t)
    p = (float(point[0]), float(point[1]), float(point[2]))
    np.testing.assert_allclose(transform(rigid(pose), p), pose.apply(point), atol=1e-12)
    np.testing.assert_allclose(
        transform_back(rigid(pose), p), pose.inverse().apply(point), atol=1e-12
    )
    np.testing.assert_allclose(
        rigid_from_quat(*inverse_as_quat(rigid(pose))), rigid(pose.inverse()), atol=1e-12
    )
