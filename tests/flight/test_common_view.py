"""D1's marker in D2's camera by what both see, and keyframes of frames as a camera gives them."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from drivers.interfaces import Frame
from drivers.link.wire import PART_WIRE_BYTES
from flight.common_view import (
    KeyframeReader,
    keyframe_source,
    marker_pose,
    parts_hz,
    prior_by,
)
from flight.config import MissionConfig
from path.camera.model import CameraModel
from path.common_view.estimate import CommonView, common_view
from path.common_view.read import SENT
from path.common_view.straight import straight
from path.config import MethodConfig
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.relative_pose.filter import Relative
from tests.path.common_view.drawn import LENS, around, drawn, looks, room

T_C1_V = Pose(rotation.exp(np.array([0.3, 2.0, -0.4])), np.array([0.05, -0.1, -0.3]))


def test_keyframes_take_less_of_the_link_than_was_asked() -> None:
    assert PART_WIRE_BYTES <= 128
    assert PART_WIRE_BYTES * parts_hz() <= 12_000


@pytest.mark.parametrize("seed", range(4))
def test_the_marker_is_where_the_common_view_puts_it_within_the_stated_covariance(
    seed: int,
) -> None:
    one = around(0.0)
    two = around(25.0)
    seen = looks(room(1), one, two, seed)
    found = common_view(seen.first, seen.second, seen.prior)
    assert isinstance(found, CommonView)
    pose = marker_pose(found, seen.first, seen.second, T_C1_V)
    T_w_c1 = Pose(*one)
    T_w_c2 = Pose(*two)
    true = T_w_c2.inverse() @ T_w_c1 @ T_C1_V
    off = np.concatenate([true.t - pose.T_c_v.t, rotation.log(true.R @ pose.T_c_v.R.T)])
    assert np.linalg.norm(off[:3]) < 0.1
    assert np.linalg.norm(off[3:]) < math.radians(3.0)
    assert off @ np.linalg.solve(pose.covariance, off) < 22.5


def test_what_the_filter_knows_is_a_prior_where_it_has_the_marker_and_three_times_as_wide() -> None:
    heading = rotation.exp(np.array([0.0, 0.0, 0.06]))
    T_n_c1 = Pose(*around(0.0))
    T_n_c2 = Pose(*around(25.0))
    T_n_v = T_n_c1 @ T_C1_V
    covariance = np.diag([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]) * 0.0016
    seen = Relative((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.04, T_n_c2.inverse() @ T_n_v, covariance)
    # D2 takes another direction for north.
    prior = prior_by(seen, T_n_v.t - T_n_c1.t, heading @ T_n_c2.R, T_n_v.R, 1.0)
    np.testing.assert_allclose(prior.t_m, T_n_c2.t - T_n_c1.t, atol=1e-9)
    np.testing.assert_allclose(prior.t_sigma_m, 0.15)
    assert prior.yaw_rad == pytest.approx(-0.06)
    assert prior.yaw_sigma_rad == pytest.approx(3.0 * math.hypot(0.004, math.radians(0.6)))


def test_a_lens_that_bends_is_straightened_before_a_keyframe_is_made() -> None:
    bent = CameraModel(
        LENS.width, LENS.height, LENS.fx, LENS.fy, LENS.cx, LENS.cy, (0.12, -0.2, 0.0, 0.0, 0.0)
    )
    R_w_c, place = around(0.0)
    grey, depth = drawn(room(1), R_w_c, place, np.random.default_rng(0))
    v, u = np.mgrid[0 : LENS.height, 0 : LENS.width]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    rays = bent.rays(pixels).reshape(*u.shape, 2)
    at = (rays * [LENS.fx, LENS.fy] + [LENS.cx, LENS.cy]).astype(np.float32)
    across = at[..., 0]
    down = at[..., 1]
    seen = np.asarray(cv2.remap(grey, across, down, cv2.INTER_LINEAR), np.uint8)
    far = np.asarray(cv2.remap(depth, across, down, cv2.INTER_NEAREST), np.float32)
    method = MethodConfig()
    mission = MissionConfig()
    color = np.repeat(seen[..., None], 3, axis=2)
    frame = Frame(1, 1, color, np.asarray(1000.0 * far, np.uint16))
    own = KeyframeReader(keyframe_source(bent, method, mission), bent).read(frame, R_w_c, SENT)
    flat = Frame(1, 1, np.repeat(grey[..., None], 3, axis=2), np.asarray(1000.0 * depth, np.uint16))
    ideal = KeyframeReader(keyframe_source(LENS, method, mission), LENS).read(flat, R_w_c, SENT)
    assert straight(bent) == LENS
    both = (own.grid.depth > 0.0) & (ideal.grid.depth > 0.0)
    assert np.count_nonzero(both) > 0.7 * both.size
    off = np.abs(own.grid.depth[both] - ideal.grid.depth[both])
    assert np.median(off) < 0.005
    apart = np.linalg.norm(own.points_c[:, None] - ideal.points_c[None], axis=2).min(axis=1)
    assert np.median(apart) < 0.02
