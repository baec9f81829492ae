"""Something lies over a part of a marker: its corners are where the print has them, or as doubtful
as they are off.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from path.marker.detect import Refine, detect_markers
from path.marker.layout import single_marker
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from tests.path.marker.scene import (
    VGA,
    Optics,
    background,
    covered,
    random_view,
    region_around,
    render,
    true_corners,
)

GROUND = background(VGA, np.random.default_rng(0))
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
GREYS = (10.0, 110.0, 170.0, 240.0)


def a_square(corner: int, size: float) -> NDArray[np.float64]:
    """A sheet whose edges are along the marker's, with a corner within it."""
    at, inwards = CORNERS[corner], 1.0 - 2.0 * CORNERS[corner]
    low, high = at - 0.25 * inwards, at + size * inwards
    return np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def a_strip(corner: int, size: float) -> NDArray[np.float64]:
    """Tape across a corner."""
    at, inwards = CORNERS[corner], 1.0 - 2.0 * CORNERS[corner]
    reach = 1.4 * size + 0.25
    low = at - 0.25 * inwards
    along, down = np.diag(reach * inwards)
    return np.array([low, low + along, low + down])


def a_finger(corner: int, size: float) -> NDArray[np.float64]:
    turn = np.linspace(0.0, 2.0 * math.pi, 40)
    return CORNERS[corner] + size * np.column_stack([np.cos(turn), np.sin(turn)])


SHAPES = (a_square, a_strip, a_finger)


def surprises(
    dictionary: str, refine: Refine, corners: tuple[int, ...], size: float, views: int
) -> tuple[list[float], list[float], int]:
    """Squared errors over the covariance: of corners, per number, and of positions; and how many
    were looked at.
    """
    layout = single_marker(marker_id=3, dictionary=dictionary)
    rng, of_corners, of_poses, looked = np.random.default_rng(3), list[float](), list[float](), 0
    for _ in range(views):
        view = random_view(rng, VGA, 0.45, 1.0, 45.0)
        clear = render(VGA, view.T_c_v, layout, rng, Optics(samples=4), GROUND)
        truth = true_corners(VGA, view.T_c_v, layout, 3)
        (gx, gy, gz), (cx, cy, cz) = view.gravity_v.tolist(), view.gravity_c.tolist()
        for shape in SHAPES:
            for grey in GREYS:
                image = clear
                for corner in corners:
                    image = covered(image, truth, shape(corner, size), grey)
                looked += 1
                for found in detect_markers(
                    image, region_around(truth, 80.0), layout, VGA, refine=refine
                ):
                    error = (found.corners_px - truth).ravel()
                    of_corners.append(
                        float(error @ np.linalg.solve(found.covariance_px2, error)) / 8.0
                    )
                    pose = estimate_pose(
                        (found,), layout, VGA, (gx, gy, gz), (cx, cy, cz), PoseSettings()
                    )
                    if isinstance(pose, MarkerPose):
                        off = pose.T_c_v.t - view.T_c_v.t
                        of_poses.append(
                            float(off @ np.linalg.solve(pose.covariance[:3, :3], off)) / 3.0
                        )
    return of_corners, of_poses, looked


@pytest.mark.parametrize("corners", [(0,), (1,), (2,), (3,), (0, 1), (1, 3)], ids=str)
def test_a_covered_corner_is_where_the_print_has_it(corners: tuple[int, ...]):
    of_corners, of_poses, looked = surprises("DICT_4X4_50", "photometric", corners, 0.1, 3)
    assert len(of_corners) > 0.25 * looked
    assert np.mean(of_corners) < 1.5
    assert max(of_corners) < 6.0
    assert max(of_poses) < 4.0


@pytest.mark.parametrize("size", [0.15, 0.25, 0.4])
def test_a_corner_that_much_covers_is_honest_or_none(size: float):
    for dictionary in ("DICT_4X4_50", "DICT_APRILTAG_36h11"):
        of_corners, of_poses, _ = surprises(dictionary, "photometric", (2,), size, 3)
        assert max(of_corners, default=0.0) < 6.0
        assert max(of_poses, default=0.0) < 4.0


@pytest.mark.parametrize("corners", [(0,), (2,), (0, 1)], ids=str)
def test_corners_of_opencv_grow_as_doubtful_as_they_are_off(corners: tuple[int, ...]):
    of_corners, of_poses, looked = surprises("DICT_4X4_50", "subpix", corners, 0.1, 3)
    assert len(of_corners) > 0.25 * looked
    assert np.mean(of_corners) < 1.5
    assert max(of_corners) < 6.0
    assert max(of_poses) < 4.0
