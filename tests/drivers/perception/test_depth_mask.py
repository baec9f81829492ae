"""The mask hides what is known to be elsewhere; what is not known stays."""

from __future__ import annotations

import numpy as np

from drivers.perception.depth_mask import GREY, HOLE_PX, without_elsewhere
from path.observations import Region

IMAGE = np.full((60, 120, 3), 200, np.uint8)
NOISE_M = 0.005


def shown(
    depth_mm: np.ndarray[tuple[int, int], np.dtype[np.uint16]],
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return (without_elsewhere(IMAGE, depth_mm, (2.0, 3.0), NOISE_M) == 200).all(axis=2)


def test_only_what_is_between_stays() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    depth[:, :40], depth[:, 80:] = 1900, 3100
    seen = shown(depth)
    assert seen[:, 42:78].all()
    assert not seen[:, :38].any()
    assert not seen[:, 82:].any()
    assert (without_elsewhere(IMAGE, depth, (2.0, 3.0), NOISE_M)[:, :38] == GREY).all()


def test_a_target_without_depth_is_not_lost_but_edges_of_others_are() -> None:
    depth = np.full((60, 120), 1900, np.uint16)
    depth[10:50, 10 : 10 + 4 * HOLE_PX] = 0
    depth[:, 90:94] = 0
    seen = shown(depth)
    assert seen[14:46, 14 : 6 + 4 * HOLE_PX].all()
    assert not seen[:, 85:].any()


def test_single_wrong_pixels_do_not_count() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    depth[::7, ::7] = 0
    depth[3::7, 3::7] = 5000
    assert shown(depth).all()


def test_the_image_itself_is_left_alone() -> None:
    without_elsewhere(IMAGE, np.full((60, 120), 9000, np.uint16), (2.0, 3.0), NOISE_M)
    assert (IMAGE == 200).all()


def test_no_upper_end_reaches_as_far_as_depth_does() -> None:
    depth = np.full((60, 120), 65535, np.uint16)
    assert (without_elsewhere(IMAGE, depth, (2.0, 90.0), NOISE_M) == 200).all()


def test_two_things_that_are_both_between_are_cut_apart_at_the_step() -> None:
    depth = np.full((60, 120), 2300, np.uint16)
    depth[:, 60:] = 2700
    seen = shown(depth)
    assert not seen[:, 58:62].any()
    assert seen[:, :50].all()
    assert seen[:, 70:].all()
    slanted = np.tile(np.linspace(2100, 2900, 120).astype(np.uint16), (60, 1))
    assert shown(slanted).all()


def test_far_around_the_region_all_is_grey() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    seen = (
        without_elsewhere(IMAGE, depth, (2.0, 3.0), NOISE_M, Region(5.0, 5.0, 25.0, 25.0)) == 200
    ).all(axis=2)
    assert seen[:55, :55].all()
    assert not seen[:, 58:].any()
    assert not (
        without_elsewhere(IMAGE, depth, (2.0, 3.0), NOISE_M, Region(300.0, 5.0, 325.0, 25.0)) == 200
    ).any()


def test_what_has_no_depth_is_cut_from_what_is_between_on_its_own_side() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    depth[:, 60:] = 0
    seen = shown(depth)
    assert seen[:, :56].all()
    assert not seen[:, 58:64].any()
    assert seen[:, 72:].all()


def test_a_step_is_followed_to_where_it_is_faint_but_does_not_begin_there() -> None:
    depth = np.full((60, 120), 2300, np.uint16)
    depth[:30, 60:], depth[30:, 60:] = 2700, 2500
    assert not shown(depth)[:, 59:61].any()
    depth[:, 60:] = 2500
    assert shown(depth).all()
