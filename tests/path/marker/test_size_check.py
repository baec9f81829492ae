"""A marker's size in the rig against depth measured on it: what contradicts it is told, and nothing
else.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout, single_marker
from path.marker.size_check import LOOKS, SizeCheck, SizeContradiction
from path.observations import Box, Depth, MarkerDetection, RangeSource

CAMERA = CameraModel(640, 480, 580.0, 580.0, 320.0, 240.0)
METHOD = MethodConfig()
FACING = np.diag([1.0, -1.0, -1.0])
POSE_SIGMA, DEPTH_SIGMA = 0.004, 0.006  # of the distance, each


def said(side_m: float = 0.040) -> MarkerLayout:
    return single_marker(side_m=side_m)


def looked(
    true_m: float,
    said_m: float = 0.040,
    *,
    z_m: float = 1.2,
    looks: int = LOOKS,
    depth_scale: float = 1.0,
    seed: int = 1,
    depth: Callable[[Box, float], Depth | None] | None = None,
) -> SizeCheck:
    """The check after so many looks at a marker of another size than the rig says, at a distance
    ``z_m``.
    """
    rng = np.random.default_rng(seed)
    check = SizeCheck(said(said_m), METHOD)
    # the same in every frame: the worst case
    wild_m = z_m * (1.0 + POSE_SIGMA * rng.standard_normal())
    for _ in range(looks):
        half_px = 0.5 * true_m * CAMERA.fx / z_m
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half_px + (
            320.0,
            240.0,
        )
        detection = MarkerDetection(0, corners, 0.01 * np.eye(8))
        by_pose_m = wild_m * said_m / true_m
        covariance = np.diag([1e-6, 1e-6, (POSE_SIGMA * by_pose_m) ** 2, 1e-4, 1e-4, 1e-4])

        def over(box: Box) -> Depth | None:
            if depth is not None:
                return depth(box, z_m)
            noisy_m = z_m * depth_scale * (1.0 + DEPTH_SIGMA * rng.standard_normal())
            return Depth(noisy_m, DEPTH_SIGMA * z_m)

        check.look(Pose(FACING, np.array([0.0, 0.0, by_pose_m])), covariance, (detection,), over)
    return check


def contradicted(check: SizeCheck) -> SizeContradiction:
    found = check.contradiction()
    assert found is not None
    return found


@pytest.mark.parametrize("true_m", [0.025, 0.036, 0.044, 0.064, 0.160])
def test_another_size_is_told_with_the_one_that_depth_says(true_m: float) -> None:
    found = contradicted(looked(true_m))
    assert found.said_m == 0.040
    assert abs(found.depth_m - true_m) < 3.0 * found.depth_sigma_m
    assert found.depth_sigma_m < 0.03 * true_m
    assert f"40.0 mm by the rig and {1000.0 * found.depth_m:.1f}" in str(found)
    assert "caliper" in str(found)


def test_a_side_that_is_said_too_large_is_told_with_the_right_one() -> None:
    found = contradicted(looked(0.040, said_m=0.064))
    assert found.depth_m == pytest.approx(0.040, rel=0.03)


@pytest.mark.parametrize("z_m", [0.5, 1.2, 1.9])
def test_the_right_size_is_never_contradicted(z_m: float) -> None:
    for seed in range(200):
        scale = 1.0 + 0.01 * np.random.default_rng([seed, 5]).standard_normal()
        assert looked(0.040, z_m=z_m, seed=seed, depth_scale=scale).contradiction() is None, seed


def test_a_few_wild_frames_decide_nothing() -> None:
    frames = iter(range(LOOKS))

    def sometimes(_: Box, z_m: float) -> Depth:
        return Depth(2.5 * z_m if next(frames) % 3 == 0 else z_m, 0.006 * z_m)

    assert looked(0.040, depth=sometimes).contradiction() is None


def test_too_few_looks_decide_nothing() -> None:
    assert looked(0.064, looks=LOOKS - 1).contradiction() is None
    assert looked(0.064, looks=LOOKS - 1).by_depth_m() is None
    assert looked(0.064).contradiction() is not None


def test_what_is_no_measurement_says_nothing() -> None:
    def by_size(_: Box, z_m: float) -> Depth:
        return Depth(2.0 * z_m, 0.01, RangeSource.SIZE)

    def none(_: Box, z_m: float) -> Depth | None:
        del z_m

    for depth in (by_size, none):
        assert looked(0.064, depth=depth).contradiction() is None


def test_a_marker_that_is_tiny_in_the_image_has_the_depth_of_what_is_behind() -> None:
    assert (
        looked(0.040, z_m=2.5, depth=lambda _, z_m: Depth(2.0 * z_m, 0.01)).contradiction() is None
    )


def test_depth_is_asked_for_well_inside_of_the_marker() -> None:
    asked: list[Box] = []

    def over(box: Box, z_m: float) -> Depth:
        asked.append(box)
        return Depth(z_m, 0.01)

    looked(0.040, looks=1, depth=over)
    (box,) = asked
    side_px = 0.040 * CAMERA.fx / 1.2
    assert box.center == pytest.approx((320.0, 240.0))
    assert METHOD.depth_center_fraction * box.w == pytest.approx(0.7 * side_px)


def test_the_certainty_needed_grows_with_what_a_side_is_known_to() -> None:
    sure, unsure = looked(0.044), SizeCheck(single_marker(side_m=0.040, side_sigma_m=0.004), METHOD)
    assert sure.contradiction() is not None
    for _ in range(LOOKS):
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 10.0 + (
            320.0,
            240.0,
        )
        unsure.look(
            Pose(FACING, np.array([0.0, 0.0, 1.0])),
            1e-6 * np.eye(6),
            (MarkerDetection(0, corners, 0.01 * np.eye(8)),),
            lambda _: Depth(1.1, 0.006),
        )
    assert unsure.contradiction() is None
    assert math.isclose(unsure.by_depth_m() or 0.0, 0.044)
