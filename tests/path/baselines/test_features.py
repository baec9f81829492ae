"""The areas in which features are looked for; they come back in pixels of the whole image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from path.baselines.features import Distance, FeatureSearch, Image, Keypoints, cover, inside, look
from path.baselines.orb import Orb, OrbConfig
from path.observations import Box, Region


class Corners:
    """Finds the brightest blobs; keeps what it was shown."""

    distance: Distance = "hamming"

    def __init__(self, side_px: int | None = None) -> None:
        self.side_px = side_px
        self.shown: list[tuple[int, int]] = []

    def extract(self, image: Image) -> Keypoints:
        self.shown.append(image.shape[:2])
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        count, _, _, centres = cv2.connectedComponentsWithStats((grey > 128).astype(np.uint8))
        points = centres[1:count].astype(np.float32)
        return Keypoints(
            points, np.zeros((len(points), 32), np.uint8), np.ones(len(points), np.float32)
        )


def dots(*places: tuple[int, int], size: tuple[int, int] = (360, 480)) -> Image:
    image = np.zeros((*size, 3), np.uint8)
    for u, v in places:
        cv2.rectangle(image, (u - 2, v - 2), (u + 2, v + 2), (255, 255, 255), -1)
    return image


@pytest.mark.parametrize("side_px", [None, 320])
@pytest.mark.parametrize("zoom", [1.0, 2.0, 3.0])
def test_features_come_back_in_pixels_of_the_whole_image(side_px: int | None, zoom: float) -> None:
    image = dots((100, 120), (140, 90), (400, 300))
    first, second = look(
        Corners(side_px),
        image,
        [Box(80, 70, 80, 80), Box(380, 280, 50, 50)],
        FeatureSearch(zoom, 0.0),
    )
    assert np.sort(first.points_px, axis=0) == pytest.approx(
        np.array([[100, 90], [140, 120]]), abs=0.3
    )
    assert second.points_px == pytest.approx(np.array([[400, 300]]), abs=0.3)


def test_context_is_what_is_around_the_box_too() -> None:
    image = dots((100, 100), (160, 100))
    box = [Box(80, 80, 40, 60)]
    assert len(look(Corners(), image, box, FeatureSearch(1.0, 0.0))[0]) == 1
    assert len(look(Corners(), image, box, FeatureSearch(1.0, 0.8))[0]) == 2


def test_boxes_that_share_a_window_share_the_work() -> None:
    corners = Corners(320)
    look(
        corners,
        dots(),
        [Box(80, 70, 60, 60), Box(150, 90, 60, 60), Box(400, 250, 60, 60)],
        FeatureSearch(2.0, 0.0),
    )
    assert corners.shown == [(320, 320), (320, 320)]  # and nothing else is asked for


def test_without_a_box_in_the_image_nothing_is_extracted() -> None:
    corners = Corners()
    (outside,) = look(corners, dots(), [Box(-200, 10, 50, 50)], FeatureSearch())
    assert len(outside) == 0
    assert not corners.shown


def test_a_box_too_large_for_a_window_is_enlarged_less() -> None:
    corners = Corners(320)
    (found,) = look(corners, dots((200, 200)), [Box(50, 50, 300, 290)], FeatureSearch(2.0, 0.0))
    assert max(corners.shown[0]) == 320
    assert found.points_px == pytest.approx(np.array([[200, 200]]), abs=0.5)


def test_a_box_outside_the_image_has_no_features() -> None:
    assert len(look(Corners(), dots((10, 10)), [Box(-90, 10, 40, 40)], FeatureSearch())[0]) == 0


def test_inside_is_half_open() -> None:
    points = np.array([[0, 0], [10, 5], [9.9, 5]], np.float32)
    kept = inside(
        Keypoints(points, np.zeros((3, 32), np.uint8), np.ones(3, np.float32)), Region(0, 0, 10, 10)
    )
    assert kept.points_px.tolist() == points[[0, 2]].tolist()


corner = st.tuples(st.floats(0, 1200), st.floats(0, 650))
areas = st.lists(
    st.tuples(corner, st.floats(5, 500), st.floats(5, 500)).map(
        lambda a: Region(a[0][0], a[0][1], min(a[0][0] + a[1], 1280.0), min(a[0][1] + a[2], 720.0))
    ),
    max_size=7,
)


@given(areas, st.sampled_from([213.0, 320.0, 640.0]))
def test_every_area_is_wholly_in_a_window_inside_the_image(
    wanted: list[Region], side: float
) -> None:
    windows = cover(wanted, side, 1280, 720)
    assert len(windows) <= len(wanted)
    for w in windows:
        assert 0 <= w.x0 < w.x1 <= 1280
        assert 0 <= w.y0 < w.y1 <= 720
    for a in wanted:
        assert any(
            w.x0 <= a.x0 + 1e-6 and w.y0 <= a.y0 + 1e-6 and w.x1 >= a.x1 - 1e-6 and w.y1 >= a.y1 - 1e-6
            for w in windows
        )  # fmt: skip


def test_orb_finds_the_limit_it_is_given_and_nothing_on_a_blank() -> None:
    texture = np.random.default_rng(1).integers(0, 256, (160, 200, 3), np.uint8)
    found = Orb(OrbConfig(features=70)).extract(texture)
    assert 0 < len(found) <= 70
    assert found.descriptors.shape == (len(found), 32)
    assert len(Orb().extract(np.full((90, 90, 3), 120, np.uint8))) == 0
