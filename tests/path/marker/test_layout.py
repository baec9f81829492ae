"""The layout's frames and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import DICTIONARIES, Marker, MarkerLayout, single_marker
from path.marker.photometric.texture import cells, dictionary_of

HERE = Pose(np.eye(3), np.zeros(3))


def test_corners_run_clockwise_from_the_top_left_seen_by_the_viewer():
    corners = single_marker(side_m=0.04).markers[0].corners_v
    assert corners.tolist() == [
        [-0.02, 0.02, 0.0],
        [0.02, 0.02, 0.0],
        [0.02, -0.02, 0.0],
        [-0.02, -0.02, 0.0],
    ]


def test_a_marker_sits_where_its_pose_says():
    quarter = Pose(rotation.exp(np.array([0.0, 0.0, math.pi / 2])), np.array([1.0, 2.0, 3.0]))
    corners = Marker(3, 0.2, 0.001, quarter).corners_v
    assert corners == pytest.approx(
        np.array([[0.9, 1.9, 3], [0.9, 2.1, 3], [1.1, 2.1, 3], [1.1, 1.9, 3]])
    )


@pytest.mark.parametrize("name", DICTIONARIES)
def test_dictionaries_are_those_of_opencv(name: str):
    dictionary = dictionary_of(name)
    assert (dictionary.markerSize, dictionary.bytesList.shape[0]) == DICTIONARIES[name]


def test_cells_have_a_black_frame_and_both_colours_inside():
    pattern = cells("DICT_4X4_50", 0)
    assert pattern.shape == (6, 6)
    assert pattern[[0, -1]].sum() == 0.0 and pattern[:, [0, -1]].sum() == 0.0
    assert pattern[1].tolist() == [0.0, 1.0, 0.0, 1.0, 1.0, 0.0]  # as OpenCV draws marker 0


@pytest.mark.parametrize(
    ("side_m", "sigma_m", "said"),
    [(0.0, 0.0, "side_m"), (math.nan, 0.0, "side_m"), (0.04, -1e-3, "side_sigma_m")],
)
def test_a_marker_that_cannot_be_is_refused(side_m: float, sigma_m: float, said: str):
    with pytest.raises(ValueError, match=said):
        Marker(0, side_m, sigma_m, HERE)


def test_a_layout_that_cannot_be_is_refused():
    one = Marker(1, 0.04, 0.0, HERE)
    with pytest.raises(ValueError, match="DICT_9X9"):
        MarkerLayout((one,), "DICT_9X9")
    with pytest.raises(ValueError, match="more than once"):
        MarkerLayout((one, one))
    with pytest.raises(ValueError, match=r"no marker 50, only 0\.\.49"):
        MarkerLayout((Marker(50, 0.04, 0.0, HERE),))
    with pytest.raises(ValueError, match="at least one"):
        MarkerLayout(())
