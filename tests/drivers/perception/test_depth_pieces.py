"""Pieces of one thing become one, things at different depths do not, and rims are nothing."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.perception.depth_pieces import DepthSlice
from path.observations import Box, Detection

NOISE_M = 0.005
UPPER, LOWER = (
    Detection(Box(20.0, 20.0, 60.0, 40.0), 0.2),
    Detection(Box(30.0, 50.0, 50.0, 30.0), 0.3),
)


def slice_of(upper_m: float, lower_m: float) -> DepthSlice:
    depth_mm = np.full((120, 160), round(1000 * upper_m), np.uint16)
    depth_mm[55:] = round(1000 * lower_m)
    return DepthSlice(depth_mm, (2.0, 3.0), NOISE_M)


def test_overlapping_pieces_that_are_equally_far_away_are_one_thing() -> None:
    (whole,) = slice_of(2.5, 2.5).united([UPPER, LOWER])
    assert whole == Detection(Box(20.0, 20.0, 60.0, 60.0), 0.3)


def test_a_step_between_them_keeps_pieces_apart() -> None:
    assert slice_of(2.2, 2.8).united([UPPER, LOWER]) == [UPPER, LOWER]


def test_pieces_that_only_touch_stay_apart() -> None:
    beside = Detection(Box(80.0, 20.0, 60.0, 40.0), 0.2)
    assert slice_of(2.5, 2.5).united([UPPER, beside]) == [UPPER, beside]


def test_pieces_without_depth_are_united_by_their_boxes_alone() -> None:
    assert len(slice_of(0.0, 0.0).united([UPPER, LOWER])) == 1


def test_a_third_piece_may_overlap_only_what_the_others_make() -> None:
    # beside the lower piece, below the upper one
    corner = Detection(Box(20.0, 62.0, 9.0, 16.0), 0.1)
    (whole,) = slice_of(2.5, 2.5).united([UPPER, corner, LOWER])
    assert whole.box == Box(20.0, 20.0, 60.0, 60.0)


@pytest.mark.parametrize(
    ("piece", "thing"),
    [
        (UPPER, True),
        (Detection(Box(20.0, 20.0, 60.0, 15.0), 0.9), False),  # thin
        (Detection(UPPER.box, 0.05), False),  # hardly fills its own hull
        (Detection(Box(20.0, 70.0, 60.0, 40.0), 0.9), False),  # elsewhere
    ],
)
def test_only_a_solid_piece_at_a_depth_that_is_asked_for_is_a_thing(
    piece: Detection, thing: bool
) -> None:
    assert slice_of(2.5, 4.0).is_thing(piece) == thing


def test_depth_of_a_box_is_of_what_is_inside_the_slice_and_may_be_in_its_corner() -> None:
    depths = slice_of(2.5, 4.0)
    assert depths.inside(Box(20.0, 35.0, 60.0, 60.0)) == 2.5
    assert depths.inside(Box(20.0, 50.0, 60.0, 60.0)) is None
    assert depths.inside(Box(-50.0, 20.0, 60.0, 20.0)) == 2.5
    assert depths.inside(Box(-50.0, 20.0, 40.0, 20.0)) is None
