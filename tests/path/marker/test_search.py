"""Where an image may show a marker."""

from __future__ import annotations

import numpy as np
import pytest

from path.marker.layout import MarkerLayout, single_marker
from path.marker.photometric.texture import cells
from path.marker.search.find import search

LAYOUT = single_marker(marker_id=5)
CELL_PX = 9
BEGIN_PX = 31


def drawn(turns: int = 0, dictionary: str = "DICT_4X4_50", marker_id: int = 5) -> np.ndarray:
    """A print with a border of a cell, on grey, turned so many times clockwise."""
    pattern = np.pad(cells(dictionary, marker_id), 1, constant_values=1.0)
    image = np.full((140, 150), 120, np.uint8)
    large = np.kron(np.rot90(pattern, -turns), np.full((CELL_PX, CELL_PX), 200)) + 20
    image[BEGIN_PX : BEGIN_PX + len(large), BEGIN_PX : BEGIN_PX + len(large)] = large
    return image


@pytest.mark.parametrize("turns", range(4))
def test_corners_come_in_the_prints_order_however_it_is_turned(turns: int):
    ((marker_id, quad),) = search(drawn(turns), LAYOUT)
    low = BEGIN_PX + CELL_PX - 0.5
    high = low + 6 * CELL_PX
    upright = np.array([[low, low], [high, low], [high, high], [low, high]])
    assert marker_id == 5
    assert quad == pytest.approx(np.roll(upright, -turns, axis=0), abs=0.5)


def test_each_of_a_layouts_markers_is_found_under_its_own_id():
    both = MarkerLayout((single_marker(marker_id=2).markers[0], LAYOUT.markers[0]))
    for marker_id in (2, 5):
        ((found, _),) = search(drawn(marker_id=marker_id), both)
        assert found == marker_id


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (200, 3), (5, 4), (64, 67)], ids=str)
def test_an_image_of_any_size_and_the_most_dark_runs_there_can_be_is_searched(
    shape: tuple[int, int],
):
    alternating = np.zeros(shape, np.uint8)
    alternating[:, 1::2] = 255
    alternating[1::2] = 255 - alternating[1::2]
    for image in (alternating, np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)):
        assert search(image, LAYOUT) == []


def test_a_marker_that_the_images_edge_cuts_is_none_and_one_within_it_is():
    image = drawn()
    begin = BEGIN_PX + CELL_PX
    assert search(np.ascontiguousarray(image[begin + 2 :]), LAYOUT) == []
    assert len(search(np.ascontiguousarray(image[begin - 6 :]), LAYOUT)) == 1
