"""The contract of every Detector: by colour, and by a network through onnxruntime.

The small graph in place of a network finds bright cells; the real one is run where its weights are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.detectors.yolox import YoloxDetector, YoloxDetectorConfig
from drivers.interfaces import Detector
from path.gate.agreement import iou
from path.observations import Box, Region
from tests.drivers.detectors.onnx_graphs import bright_cells_network
from tests.drivers.detectors.test_color import drawn
from tests.drivers.detectors.test_yolox import WEIGHTS, clock_face

Image = NDArray[np.uint8]


@dataclass
class Stage:
    """A detector, an image of one thing that it looks for with the thing's box, and one without.

    ``beside``: how far right and down there is room for another such thing; None when there is not.
    """

    detector: Detector
    image: Image
    box: Box
    empty: Image
    min_iou: float = 0.9
    beside: tuple[int, int] | None = None

    @property
    def region(self) -> Region:
        """Around the thing's centre."""
        x, y = self.box.center
        return Region(
            x - 0.6 * self.box.w, y - 0.6 * self.box.h, x + 0.6 * self.box.w, y + 0.6 * self.box.h
        )


def colored(detector: Detector) -> Stage:
    return Stage(
        detector, drawn((200, 150, 120, 80)), Box(199.5, 149.5, 120, 80), drawn(), beside=(250, 150)
    )


def color(folder: Path) -> Stage:
    del folder
    return colored(ColorDetector(ColorDetectorConfig()))


def network(folder: Path) -> Stage:
    detector = YoloxDetector(
        YoloxDetectorConfig(bright_cells_network(folder / "bright.onnx", 64, 3), max_zoom=1.0)
    )
    image = np.zeros((96, 128, 3), np.uint8)
    image[16:32, 48:64, 2] = 255
    return Stage(
        detector, image, Box(47.5, 15.5, 16, 16), np.zeros((96, 128, 3), np.uint8), 0.2, (48, 48)
    )


def yolox(folder: Path) -> Stage:
    del folder
    if not WEIGHTS:
        pytest.skip("no yolox_nano.onnx in $PATH_MODELS, or in models/ beside it")
    detector = YoloxDetector(YoloxDetectorConfig(WEIGHTS[0], classes=("clock",)))
    return Stage(
        detector, clock_face(), Box(286.0, 126.0, 228, 228), np.full((480, 640, 3), 180, np.uint8)
    )


DETECTORS = pytest.mark.parametrize("stage_of", [color, network, yolox])
StageOf = Callable[[Path], Stage]


@DETECTORS
def test_what_is_there_is_found_in_the_image_s_own_pixels_and_nothing_where_nothing_is(
    stage_of: StageOf, tmp_path: Path
) -> None:
    stage = stage_of(tmp_path)
    assert not stage.detector.detect(stage.empty, None)
    (found,) = stage.detector.detect(stage.image, None)
    assert iou(found.box, stage.box) > stage.min_iou
    assert 0.0 < found.score <= 1.0


@DETECTORS
def test_only_what_is_centred_in_the_region_is_given(stage_of: StageOf, tmp_path: Path) -> None:
    stage = stage_of(tmp_path)
    (found,) = stage.detector.detect(stage.image, stage.region)
    assert stage.region.contains(*found.box.center)
    assert iou(found.box, stage.box) > min(stage.min_iou, 0.8)
    right = stage.box.x + stage.box.w
    height, width = stage.image.shape[:2]
    assert not stage.detector.detect(stage.image, Region(right + 5.0, 0.0, width, height))


@DETECTORS
def test_a_region_smaller_than_the_thing_does_not_cut_it(stage_of: StageOf, tmp_path: Path) -> None:
    stage = stage_of(tmp_path)
    x, y = stage.box.center
    # its centre at each corner, too
    for dx, dy in ((0.0, 0.0), (0.1, 0.1), (-0.1, 0.1), (0.1, -0.1), (-0.1, -0.1)):
        x0, y0 = x + (dx - 0.15) * stage.box.w, y + (dy - 0.15) * stage.box.h
        region = Region(x0, y0, x0 + 0.3 * stage.box.w, y0 + 0.3 * stage.box.h)
        (found,) = stage.detector.detect(stage.image, region)
        assert iou(found.box, stage.box) > min(stage.min_iou, 0.8), (dx, dy)


@DETECTORS
def test_of_two_things_each_is_found_alone_in_its_own_region(
    stage_of: StageOf, tmp_path: Path
) -> None:
    stage = stage_of(tmp_path)
    if stage.beside is None:
        pytest.skip("there is no room for two in its image")
    right, down = stage.beside
    other = np.roll(stage.image, (down, right), (0, 1))
    both = np.where(other == stage.empty, stage.image, other)
    box, around = stage.box, stage.region
    for x, y in ((0, 0), stage.beside):
        region = Region(around.x0 + x, around.y0 + y, around.x1 + x, around.y1 + y)
        (found,) = stage.detector.detect(both, region)
        assert iou(found.box, Box(box.x + x, box.y + y, box.w, box.h)) > min(stage.min_iou, 0.8)


@DETECTORS
def test_no_region_is_an_error(stage_of: StageOf, tmp_path: Path) -> None:
    stage = stage_of(tmp_path)
    height, width = stage.image.shape[:2]
    for region in (
        Region(width + 10.0, 0.0, width + 90.0, 50.0),  # beside the image
        Region(-500.0, -500.0, -400.0, -400.0),
        Region(1.0, 1.0, 1.2, 1.2),  # of less than a pixel
        Region(width - 1.5, height - 1.5, width + 40.0, height + 40.0),
    ):
        assert not stage.detector.detect(stage.image, region)
    (found,) = stage.detector.detect(stage.image, Region(-1e4, -1e4, 1e4, 1e4))
    assert iou(found.box, stage.box) > stage.min_iou


@DETECTORS
def test_the_image_is_left_alone_and_the_same_one_gives_the_same(
    stage_of: StageOf, tmp_path: Path
) -> None:
    stage = stage_of(tmp_path)
    before = stage.image.copy()
    stage.image.setflags(write=False)
    first, second = (stage.detector.detect(stage.image, None) for _ in range(2))
    np.testing.assert_array_equal(stage.image, before)
    assert len(first) == len(second) == 1
    assert iou(first[0].box, second[0].box) > 0.95


@DETECTORS
def test_images_of_other_sizes_and_strides_are_taken(stage_of: StageOf, tmp_path: Path) -> None:
    stage = stage_of(tmp_path)
    # a view that is not contiguous
    (found,) = stage.detector.detect(np.asarray(stage.image[:, ::-1]), None)
    assert found.box.center[0] == pytest.approx(
        stage.image.shape[1] - 1 - stage.box.center[0], abs=6.0
    )
    for size in ((64, 48), (48, 64), (1280, 720)):
        other = np.asarray(cv2.resize(stage.empty, size), np.uint8)
        assert not stage.detector.detect(other, None)
