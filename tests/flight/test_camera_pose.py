from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import FlightMode, Vehicle, VehicleState
from drivers.rig.parts import Mount
from flight.camera_pose import CameraPose, gravity_in
from path.geometry.rotation import R_from_rpy, quat_from_rpy
from path.geometry.transforms import Pose
from path.messages import Quat

C = math.sqrt(0.5)
AHEAD_AND_DOWN = Pose(
    np.array([[0.0, -C, C], [1.0, 0.0, 0.0], [0.0, C, C]]), np.array([0.1, 0.0, 0.02])
)
MARKER = Pose(
    np.array([[0.0, C, -C], [1.0, 0.0, 0.0], [0.0, -C, -C]]), np.array([-0.18, 0.0, -0.06])
)
STATE = VehicleState(
    1_000_000_000,
    0,
    (3.0, 1.0, -1.5),
    (0.5, -0.2, 0.1),
    (1.0, 0.0, 0.0, 0.0),
    True,
    True,
    True,
    FlightMode.HOLD,
    1.0,
)


@dataclass
class Attitudes:
    """A vehicle that rolls at 1 rad/s from level at stamp 0."""

    state: VehicleState = STATE

    def attitude_at(self, stamp_ns: int) -> Quat:
        return quat_from_rpy(stamp_ns * 1e-9, 0.0, 0.0)


def eye_of(vehicle: Any) -> CameraPose:
    return CameraPose(cast(Vehicle, vehicle), Mount(AHEAD_AND_DOWN, MARKER))


def test_the_attitude_is_that_of_the_frame_not_the_newest() -> None:
    assert eye_of(Attitudes()).R_n_b(300_000_000) == pytest.approx(
        R_from_rpy(0.3, 0.0, 0.0), abs=1e-12
    )


@pytest.mark.parametrize("dt_s", [0.0, 0.2, -0.3])
def test_the_camera_is_where_the_vehicle_was_when_the_frame_was_taken(dt_s: float) -> None:
    R = R_from_rpy(0.1, -0.2, 2.0)
    pose = eye_of(Attitudes()).T_n_c(STATE.stamp_ns + round(dt_s * 1e9), R)
    body = np.array(STATE.position_n_m) + dt_s * np.array(STATE.velocity_n_mps)
    assert pose.t == pytest.approx(body + R @ AHEAD_AND_DOWN.t)
    assert pytest.approx(R @ AHEAD_AND_DOWN.R) == pose.R


def test_the_mount_is_left_as_it_is() -> None:
    before = AHEAD_AND_DOWN.t.copy()
    eye_of(Attitudes(replace(STATE, position_n_m=(9.0, 9.0, 9.0)))).T_n_c(0, np.eye(3))
    assert before == pytest.approx(AHEAD_AND_DOWN.t)


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.0, 0.0, 2.5), (0.2, -0.1, 1.0)])
def test_down_seen_from_camera_and_marker_points_down(rpy: tuple[float, float, float]) -> None:
    camera_pose, R = eye_of(SimpleNamespace()), R_from_rpy(*rpy)
    down_n = np.array([0.0, 0.0, 1.0])
    assert R @ AHEAD_AND_DOWN.R @ np.array(gravity_in(R @ AHEAD_AND_DOWN.R)) == pytest.approx(
        down_n, abs=1e-12
    )
    assert R @ MARKER.R @ np.array(camera_pose.gravity_v(R)) == pytest.approx(down_n, abs=1e-12)


def test_a_level_camera_that_looks_45_degrees_down_has_gravity_between_its_axes() -> None:
    camera_pose = eye_of(SimpleNamespace())
    assert gravity_in(AHEAD_AND_DOWN.R) == pytest.approx((0.0, C, C))
    assert camera_pose.gravity_v(np.eye(3)) == pytest.approx((0.0, -C, -C))
