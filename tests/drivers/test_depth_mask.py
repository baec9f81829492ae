"""What is known to be elsewhere is not shown; what is not known stays."""

from __future__ import annotations

import numpy as np

from drivers.depth_mask import GREY, HOLE_PX, without_elsewhere

IMAGE = np.full((60, 120, 3), 200, np.uint8)


def shown(
    depth_mm: np.ndarray[tuple[int, int], np.dtype[np.uint16]],
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return (without_elsewhere(IMAGE, depth_mm, 2.0, 3.0) == 200).all(axis=2)


def test_only_what_is_between_stays() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    depth[:, :40], depth[:, 80:] = 1900, 3100
    seen = shown(depth)
    assert seen[:, 41:79].all()
    assert not seen[:, :39].any()
    assert not seen[:, 81:].any()
    assert (without_elsewhere(IMAGE, depth, 2.0, 3.0)[:, :39] == GREY).all()


def test_a_target_without_depth_is_not_lost_but_edges_of_others_are() -> None:
    depth = np.full((60, 120), 1900, np.uint16)
    depth[10:50, 10 : 10 + 2 * HOLE_PX] = 0
    depth[:, 90:94] = 0
    seen = shown(depth)
    assert seen[12:48, 12 : 8 + 2 * HOLE_PX].all()
    assert not seen[:, 85:].any()


def test_single_wrong_pixels_do_not_count() -> None:
    depth = np.full((60, 120), 2500, np.uint16)
    depth[::7, ::7] = 0
    depth[3::7, 3::7] = 5000
    assert shown(depth).all()


def test_the_image_itself_is_left_alone() -> None:
    without_elsewhere(IMAGE, np.full((60, 120), 9000, np.uint16), 2.0, 3.0)
    assert (IMAGE == 200).all()


def test_no_upper_end_reaches_as_far_as_depth_does() -> None:
    depth = np.full((60, 120), 65535, np.uint16)
    assert (without_elsewhere(IMAGE, depth, 2.0, 90.0) == 200).all()
