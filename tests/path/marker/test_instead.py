"""No marker of the layout: what else is in the image is told, and nothing where there is
nothing.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.marker.instead import seen_instead
from path.marker.layout import single_marker
from path.marker.photometric.texture import cells
from tests.path.marker.scene import VGA, background

GROUND = background(VGA, np.random.default_rng(0))
WANTED = "DICT_4X4_50"


def printed(
    dictionary: str, marker_id: int, *, inverted: bool = False, mirrored: bool = False
) -> NDArray[np.uint8]:
    """A print with its border on ground, at a slant, some 45 px wide."""
    pattern = np.pad(cells(dictionary, marker_id), 1, constant_values=1.0)
    pattern = pattern[:, ::-1] if mirrored else pattern
    picture = np.kron(30.0 + 170.0 * (1.0 - pattern if inverted else pattern), np.ones((12, 12)))
    end = len(picture) - 0.5
    of = np.array([[-0.5, -0.5], [end, -0.5], [end, end], [-0.5, end]], np.float32)
    to = np.array([[300.0, 200.0], [352.0, 207.0], [347.0, 256.0], [296.0, 251.0]], np.float32)
    H = cv2.getPerspectiveTransform(of, 4.0 * to + 1.5)
    ground = cv2.resize(GROUND, None, fx=4.0, fy=4.0)
    cv2.warpPerspective(picture, H, (2560, 1920), ground, borderMode=cv2.BORDER_TRANSPARENT)
    seen = cv2.resize(
        cv2.GaussianBlur(ground, (0, 0), 2.8), (640, 480), interpolation=cv2.INTER_AREA
    )
    noisy = seen + np.random.default_rng(1).normal(0.0, 2.0, seen.shape)
    return np.clip(noisy, 0.0, 255.0).astype(np.uint8)


@pytest.mark.parametrize("dictionary", [WANTED, "DICT_5X5_100", "DICT_APRILTAG_36h11"])
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"inverted": True}, "inverted, white on black"),
        ({"mirrored": True}, "mirrored: it is printed from behind"),
        ({"inverted": True, "mirrored": True}, "inverted and mirrored"),
    ],
)
def test_a_print_that_went_wrong_is_known(dictionary: str, wrong: dict[str, bool], words: str):
    layout = single_marker(marker_id=3, dictionary=dictionary)
    said = seen_instead(printed(dictionary, 3, **wrong), layout)
    assert said is not None
    assert said.startswith(f"marker 3 of {dictionary} is there, {words}")


@pytest.mark.parametrize(
    ("dictionary", "marker_id"),
    [
        (WANTED, 7), ("DICT_4X4_250", 200), ("DICT_5X5_50", 0), ("DICT_6X6_250", 180), ("DICT_7X7_50", 2),
        ("DICT_ARUCO_ORIGINAL", 5), ("DICT_APRILTAG_16h5", 4), ("DICT_APRILTAG_25h9", 4),
        ("DICT_APRILTAG_36h10", 4), ("DICT_APRILTAG_36h11", 0),
    ],
)  # fmt: skip
def test_another_marker_is_named(dictionary: str, marker_id: int):
    said = seen_instead(printed(dictionary, marker_id), single_marker())
    assert said == f"marker {marker_id} of {dictionary} is there: asked for is marker 0 of {WANTED}"


def test_of_ground_and_of_the_right_marker_nothing_is_told():
    assert seen_instead(np.clip(GROUND, 0.0, 255.0).astype(np.uint8), single_marker()) is None
    assert seen_instead(printed(WANTED, 0), single_marker()) is None
