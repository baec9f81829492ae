"""Depth over a box that is never a guess, and the target's point in the marker frame."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import TwoViews
from path.geometry.rigid import rigid
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.observations import Box, Depth
from path.target.place import back_project, locate, registered_depth

CONFIG = MethodConfig()
CAMERA = CameraModel(640, 480, 615.0, 616.0, 320.0, 240.0, (-0.1, 0.05, 0.001, -0.001, 0.0))
BOX = Box(100.0, 100.0, 60.0, 40.0)


def scene(z_mm: float = 2000.0, noise_mm: float = 8.0, seed: int = 0) -> NDArray[np.uint16]:
    """The target fills its box; the ground is 0.6 m behind."""
    rng = np.random.default_rng(seed)
    depth = np.full((480, 640), z_mm + 600.0)
    depth[100:140, 100:160] = z_mm
    return np.round(depth + rng.normal(0.0, noise_mm, depth.shape)).astype(np.uint16)


def test_depth_of_a_clean_target() -> None:
    depth = registered_depth(scene(), BOX, CONFIG)
    assert depth is not None
    assert depth.z_m == pytest.approx(2.0, abs=0.003)
    assert 0.0 < depth.sigma_m < 0.05


@given(st.floats(0.0, 0.4), st.sampled_from([0, 2600, 9000, 100]), st.integers(0, 20))
def test_holes_flying_pixels_and_background_do_not_move_it(
    share: float, value: int, seed: int
) -> None:
    depth_mm = scene(seed=seed)
    spoilt = np.random.default_rng(seed + 1).random((40, 60)) < share
    depth_mm[100:140, 100:160][spoilt] = value
    depth = registered_depth(depth_mm, BOX, CONFIG)
    assert depth is not None
    assert depth.z_m == pytest.approx(2.0, abs=0.004)


@pytest.mark.parametrize("value", [0, 100, 7000])
def test_too_few_valid_pixels_give_none(value: int) -> None:
    depth_mm = scene()
    spoilt = np.random.default_rng(2).random((40, 60)) < 0.6
    depth_mm[100:140, 100:160][spoilt] = value
    assert registered_depth(depth_mm, BOX, CONFIG) is None


def test_what_is_not_one_surface_gives_none() -> None:
    depth_mm = scene()
    depth_mm[100:140, 100:160] = np.random.default_rng(3).integers(500, 5500, (40, 60))
    assert registered_depth(depth_mm, BOX, CONFIG) is None


@pytest.mark.parametrize(
    "box",
    [
        Box(-300.0, 10.0, 60.0, 40.0),
        Box(700.0, 500.0, 60.0, 40.0),
        Box(math.nan, 100.0, 60.0, 40.0),
        Box(100.0, 100.0, 0.0, 40.0),
        Box(100.0, 100.0, math.inf, 40.0),
        Box(100.0, 100.0, 3.0, 3.0),  # fewer pixels than can be trusted
    ],
)
def test_a_box_that_is_none_gives_none(box: Box) -> None:
    assert registered_depth(scene(), box, CONFIG) is None


def test_a_large_box_is_thinned_not_biased() -> None:
    depth_mm = np.full((480, 640), 1500, np.uint16)
    depth = registered_depth(depth_mm, Box(0.0, 0.0, 640.0, 480.0), CONFIG)
    assert depth is not None
    assert depth.z_m == 1.5


def test_farther_depth_is_less_certain() -> None:
    near, far = (
        registered_depth(scene(1000.0), BOX, CONFIG),
        registered_depth(scene(4000.0), BOX, CONFIG),
    )
    assert near is not None
    assert far is not None
    assert far.sigma_m >= 10.0 * near.sigma_m


@given(st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(0.3, 6.0))
def test_back_projection_undoes_projection(x: float, y: float, z: float) -> None:
    point = (x * z, y * z, z)
    assert back_project(CAMERA, *CAMERA.project_point(point), z) == pytest.approx(point, abs=1e-9)


def test_the_targets_point_in_the_marker_frame() -> None:
    T_v_c1 = Pose(exp(np.array([0.3, -2.0, 0.4])), np.array([0.1, -0.05, -0.2]))
    point_c = (0.2, -0.1, 2.0)
    u, v = CAMERA.project_point(point_c)
    found = locate(
        TwoViews(CAMERA, CAMERA, rigid(T_v_c1)),
        Box(u - 30.0, v - 20.0, 60.0, 40.0),
        Depth(2.0, 0.02),
        CONFIG,
    )
    assert found.point_v_m == pytest.approx(T_v_c1.apply(np.array(point_c)).tolist(), abs=1e-9)
    assert found.z_m == 2.0


def test_sigma_covers_the_worst_direction_of_simulated_errors() -> None:
    rng = np.random.default_rng(5)
    T_v_c1 = Pose(exp(np.array([0.3, -2.0, 0.4])), np.array([0.1, -0.05, -0.2]))
    point_c, depth_sigma, n = (0.2, -0.1, 2.0), 0.02, 4000
    u, v = CAMERA.project_point(point_c)
    stated = locate(
        TwoViews(CAMERA, CAMERA, rigid(T_v_c1)),
        Box(u - 30.0, v - 20.0, 60.0, 40.0),
        Depth(2.0, depth_sigma),
        CONFIG,
    ).sigma_m
    found = np.empty((n, 3))
    for i in range(n):
        du, dv = rng.normal(0.0, CONFIG.pixel_sigma_px, 2)
        R = exp(rng.normal(0.0, math.radians(CONFIG.mount_sigma_deg), 3)) @ T_v_c1.R
        t = T_v_c1.t + rng.normal(0.0, CONFIG.mount_sigma_m, 3)
        found[i] = R @ back_project(CAMERA, u + du, v + dv, 2.0 + rng.normal(0.0, depth_sigma)) + t
    worst = math.sqrt(np.linalg.eigvalsh(np.cov(found.T))[-1])
    assert stated == pytest.approx(worst, rel=0.05)
