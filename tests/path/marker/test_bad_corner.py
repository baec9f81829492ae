"""A corner that is off, by dirt or by glare on it, is left out of the pose; nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from path.marker.pose import MarkerPose
from path.observations import MarkerDetection
from tests.path.marker.scene import VGA, View, random_view
from tests.path.marker.test_pose import seen, solve, surprise

SIGMA_PX = 0.05
VIEWS = 60


def moved(found: MarkerDetection, corners: tuple[int, ...], share: float) -> MarkerDetection:
    """Move corners outward by a share of their way from the middle."""
    pixels = found.corners_px.copy()
    for corner in corners:
        pixels[corner] += share * (pixels[corner] - found.corners_px.mean(axis=0))
    return MarkerDetection(found.marker_id, pixels, found.covariance_px2)


def off_m(pose: MarkerPose, view: View) -> float:
    return float(np.linalg.norm(pose.T_c_v.t - view.T_c_v.t))


@pytest.mark.parametrize("corner", range(4))
def test_a_pose_with_one_corner_off_is_of_the_same_kind_as_with_none(corner: int) -> None:
    rng = np.random.default_rng(corner)
    right: list[float] = []
    wrong: list[float] = []
    surprises: list[float] = []
    for _ in range(VIEWS):
        view = random_view(rng, VGA, 0.5, 1.2, 50.0)
        (found,) = seen(VGA, view, SIGMA_PX, rng)
        whole = solve(VGA, view, (found,), rng)
        pose = solve(VGA, view, (moved(found, (corner,), 0.08),), rng)
        assert isinstance(whole, MarkerPose)
        if isinstance(pose, MarkerPose):
            right.append(off_m(whole, view))
            wrong.append(off_m(pose, view))
            surprises.append(surprise(pose, view))
    assert len(wrong) > 0.9 * VIEWS
    assert np.median(wrong) < 4.0 * np.median(right)
    assert np.median(surprises) < 1.5


def test_with_two_corners_off_none_is_left_out_and_the_pose_says_that_it_is_worth_little() -> None:
    rng = np.random.default_rng(9)
    surprises: list[float] = []
    for _ in range(VIEWS):
        view = random_view(rng, VGA, 0.5, 1.2, 50.0)
        (found,) = seen(VGA, view, SIGMA_PX, rng)
        pose = solve(VGA, view, (moved(found, (0, 1), 0.08),), rng)
        if isinstance(pose, MarkerPose):
            surprises.append(surprise(pose, view))
    assert np.median(surprises, axis=0) < 3.0
