"""YOLOX: what is refused, how cells become boxes, and the network itself when its weights are
there.

Without weights, a small graph stands for the network: it puts the input's own values into the
output's cells, so that letterbox, crop and decoding are tested through onnxruntime from image to
box.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.detectors.coco import COCO
from drivers.detectors.looks import Input, windows
from drivers.detectors.yolox import BELIEVED, MODEL_VARIABLE, YoloxDetector, YoloxDetectorConfig
from drivers.detectors.yolox_boxes import decode, grid, suppress
from drivers.interfaces import PartError
from flight.tracking.objects import MIN_SCORE
from path.observations import Region
from tests.drivers.detectors.onnx_graphs import bright_cells_network, identity_network

MODELS = (
    [Path(os.environ["PATH_MODELS"])]
    if "PATH_MODELS" in os.environ
    else Path(__file__).parents[4].glob("*/models")
)
WEIGHTS = [file for folder in MODELS for file in [folder / "yolox_nano.onnx"] if file.is_file()]
needs_weights = pytest.mark.skipif(
    not WEIGHTS, reason="no yolox_nano.onnx in $PATH_MODELS, or in models/ beside it"
)

SIDE = 64
CELLS = 8 * 8 + 4 * 4 + 2 * 2
CLASSES = 3


def raw_cells(
    marks: Mapping[int, Sequence[float]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    raw = np.zeros((CELLS, 5 + CLASSES), np.float32)
    for cell, values in marks.items():
        raw[cell] = values
    return raw


def test_cells_become_boxes_of_their_level() -> None:
    cells, steps = grid(SIDE, SIDE)
    assert cells.shape == (CELLS, 2)
    marks = {
        8 * 3 + 5: (0.5, 0.25, 0.0, math.log(2.0), 0.9, 0.1, 0.8, 0.0),  # stride 8, column 5, row 3
        # stride 16, column 2, row 1
        64 + 4 * 1 + 2: (0.0, 0.0, math.log(3.0), 0.0, 0.5, 0.9, 0.0, 0.0),
        # stride 32, but not of a class looked for
        64 + 16 + 3: (0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
        7: (0.0, 0.0, 200.0, 0.0, 1.0, 1.0, 0.0, 0.0),  # overflows
    }
    boxes, scores, classes = decode(
        raw_cells(marks), cells, steps, np.array([True, True, False]), 0.3
    )
    assert boxes == pytest.approx(np.array([[44.0, 26.0, 8.0, 16.0], [32.0, 16.0, 48.0, 16.0]]))
    assert scores == pytest.approx([0.72, 0.45])
    assert classes.tolist() == [1.0, 0.0]


def test_of_boxes_that_overlap_the_best_of_each_class_stays() -> None:
    boxes = np.array(
        [[50, 50, 20, 20], [52, 50, 20, 20], [52, 51, 20, 20], [90, 50, 20, 20]], np.float32
    )
    scores = np.array([0.6, 0.9, 0.8, 0.5], np.float32)
    classes = np.array([0, 0, 1, 0], np.float32)
    assert suppress(boxes, scores, classes, 0.45).tolist() == [1, 2, 3]
    assert suppress(boxes, scores, classes, 0.95).tolist() == [1, 2, 0, 3]
    assert (
        suppress(
            np.zeros((0, 4), np.float32), np.zeros(0, np.float32), np.zeros(0, np.float32), 0.5
        ).tolist()
        == []
    )


@pytest.fixture
def bright_cells(tmp_path: Path) -> Path:
    return bright_cells_network(tmp_path / "bright.onnx", SIDE, CLASSES)


def config(file: Path, **options: object) -> YoloxDetectorConfig:
    return YoloxDetectorConfig(file, **options)  # type: ignore[arg-type]


def scene(
    width: int, height: int, x: int, y: int, side: int
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    image = np.zeros((height, width, 3), np.uint8)
    image[y : y + side, x : x + side, 2] = 255
    return image


@pytest.mark.parametrize(
    ("width", "height", "scale"), [(64, 64, 1), (128, 96, 2), (96, 128, 2), (320, 64, 5)]
)
def test_boxes_are_in_the_images_own_pixels(
    bright_cells: Path, width: int, height: int, scale: int
) -> None:
    side = 8 * scale
    detector = YoloxDetector(config(bright_cells))
    (found,) = detector.detect(scene(width, height, 3 * side, 1 * side, side), None)
    rounding = 1.0 if scale == 5 else 1e-4  # 64 px become 13 of 12.8
    # the first pixel's edge is at -0.5
    assert (found.box.x, found.box.y) == pytest.approx((3 * side - 0.5, side - 0.5), abs=rounding)
    assert (found.box.w, found.box.h) == pytest.approx((side, side), abs=rounding)
    assert found.score > (0.6 if scale == 5 else 0.95)


def test_a_search_region_is_looked_at_enlarged_and_only_centres_inside_count(
    bright_cells: Path,
) -> None:
    detector = YoloxDetector(config(bright_cells, sizes_px=(8.0,), max_zoom=2.0))
    image = scene(256, 256, 100, 140, 4)  # one pixel of the input when the image is seen whole
    assert detector.detect(image, None) == []
    # seen from 84, 124 on, twice enlarged
    region = Region(90.0, 130.0, 109.5, 149.5, side_px=4.0)
    (found,) = detector.detect(image, region)
    assert (found.box.x, found.box.y, found.box.w, found.box.h) == pytest.approx(
        (99.5, 139.5, 4.0, 4.0)
    )
    assert detector.detect(image, Region(104.5, 130.0, 124.5, 150.0)) == []
    assert detector.detect(image, Region(300.0, 0.0, 400.0, 50.0)) == ()


def test_only_the_classes_asked_for_are_found(bright_cells: Path, tmp_path: Path) -> None:
    names = tmp_path / "names.txt"
    names.write_text("cube\nball\n\ncone\n", "utf-8")
    image = scene(64, 64, 24, 8, 8)
    assert (
        len(
            YoloxDetector(config(bright_cells, names=names, classes=("cone", "ball"))).detect(
                image, None
            )
        )
        == 1
    )
    assert (
        len(YoloxDetector(config(bright_cells, names=names, classes=("ball",))).detect(image, None))
        == 0
    )
    with pytest.raises(PartError, match=r"knows no 'bell' \(did you mean 'ball'\?\)") as caught:
        YoloxDetector(config(bright_cells, names=names, classes=("bell",)))
    assert caught.value.remedy == "it knows cube, ball, cone"
    with pytest.raises(PartError, match="expected 3 names of classes, COCO has 80"):
        YoloxDetector(config(bright_cells, classes=("car",)))


def test_a_model_that_is_missing_or_of_the_wrong_shape_is_refused_with_expected_and_found(
    tmp_path: Path,
) -> None:
    with pytest.raises(PartError, match=r"gone\.onnx: there is no such file") as caught:
        YoloxDetector(config(tmp_path / "gone.onnx"))
    assert "export_onnx.py" in caught.value.remedy
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(
        PartError, match="expected a network in ONNX, found a file that cannot be read"
    ):
        YoloxDetector(config(tmp_path / "text.onnx"))
    (tmp_path / "other.onnx").write_bytes(identity_network((1, 3, 416, 416)))
    with pytest.raises(
        PartError,
        match="expected an output of rows of boxes, found 1x3x416x416 -> 1x3x416",
    ):
        YoloxDetector(config(tmp_path / "other.onnx"))
    (tmp_path / "odd.onnx").write_bytes(identity_network((1, 3, 100, 416)))
    with pytest.raises(
        PartError,
        match=r"expected an input of 1x3xHxW, H and W multiples of 32, found 1x3x100x416",
    ):
        YoloxDetector(config(tmp_path / "odd.onnx"))


@pytest.mark.parametrize("options", [{"min_score": 0.0}, {"max_iou": 1.0}, {"max_zoom": 0.5}])
def test_options_that_cannot_be_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        config(Path("x.onnx"), **options)


def test_coco_has_its_classes() -> None:
    assert len(COCO) == len(set(COCO)) == 80
    assert (COCO[0], COCO[2], COCO[79]) == ("person", "car", "toothbrush")


def clock_face() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Drawn: no photograph comes with the tests."""
    image = np.full((480, 640, 3), 180, np.uint8)
    cv2.circle(image, (400, 240), 110, (250, 250, 250), -1)
    cv2.circle(image, (400, 240), 110, (20, 20, 20), 8)
    for hour in range(12):
        angle = hour * np.pi / 6.0
        at = (int(400 + 88 * np.sin(angle)) - 12, int(240 - 88 * np.cos(angle)) + 8)
        cv2.putText(image, str(hour or 12), at, cv2.FONT_HERSHEY_SIMPLEX, 0.7, (20, 20, 20), 2)
    cv2.line(image, (400, 240), (400, 170), (20, 20, 20), 5)
    cv2.line(image, (400, 240), (450, 270), (20, 20, 20), 5)
    return image


@needs_weights
def test_the_real_network_answers_the_same_for_an_image_and_a_region_around_it() -> None:
    image = clock_face()
    detector = YoloxDetector(config(WEIGHTS[0], classes=("clock",)))
    (whole,) = detector.detect(image, None)
    assert whole.box.center == pytest.approx((400.0, 240.0), abs=8.0)
    assert (whole.box.w, whole.box.h) == pytest.approx((228.0, 228.0), rel=0.1)
    (part,) = detector.detect(image, Region(350.0, 190.0, 450.0, 290.0, side_px=228.0))
    assert part.box.center == pytest.approx((400.0, 240.0), abs=8.0)
    assert detector.detect(image, Region(0.0, 0.0, 100.0, 100.0)) == []
    assert YoloxDetector(config(WEIGHTS[0], classes=("cat",))).detect(image, None) == []


def test_the_model_may_be_named_outside_the_rig(
    bright_cells: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(MODEL_VARIABLE, raising=False)
    with pytest.raises(PartError, match="none was named") as none:
        YoloxDetector(YoloxDetectorConfig())
    assert "--model" in none.value.remedy
    monkeypatch.setenv(MODEL_VARIABLE, str(tmp_path / "gone.onnx"))
    with pytest.raises(PartError, match=r"gone\.onnx: there is no such file"):
        YoloxDetectorConfig().check_ready()
    monkeypatch.setenv(MODEL_VARIABLE, str(bright_cells))
    assert len(YoloxDetector(YoloxDetectorConfig()).detect(scene(64, 64, 24, 8, 8), None)) == 1
    with pytest.raises(PartError, match=r"own\.onnx"):  # the rig's own comes first
        YoloxDetectorConfig(tmp_path / "own.onnx").check_ready()


def test_what_a_rig_lets_through_is_believed_in_flight(bright_cells: Path) -> None:
    assert BELIEVED == MIN_SCORE
    image = scene(64, 64, 24, 8, 8) // 255 * 180
    scores = [
        YoloxDetector(config(bright_cells, min_score=least)).detect(image, None)[0].score
        for least in (0.3, 0.1, 0.05)
    ]
    assert 0.3 <= scores[0] < scores[1] < scores[2] < 1.0
    assert scores[1] == pytest.approx(scores[0] ** (math.log(0.3) / math.log(0.1)))


def test_a_small_object_is_found_in_a_region_and_in_tiles_of_the_whole_image(
    bright_cells: Path,
) -> None:
    image = scene(640, 480, 400, 240, 4)
    detector = YoloxDetector(config(bright_cells, sizes_px=(8.0,), max_looks=1000))
    assert detector.detect(image, None) == []
    for region in (Region(380.0, 220.0, 420.0, 260.0), Region(0.0, 0.0, 640.0, 480.0)):
        found = detector.detect(image, replace(region, side_px=4.0))
        assert found[0].box.center == pytest.approx((401.5, 241.5), abs=1.0)
    known = YoloxDetector(config(bright_cells, sizes_px=(8.0,), max_looks=1000, side_px=4.0))
    assert known.detect(image, None) == found


def test_a_whole_image_is_looked_at_in_turns_and_a_region_at_once(bright_cells: Path) -> None:
    image = scene(640, 480, 400, 240, 4)
    detector = YoloxDetector(config(bright_cells, sizes_px=(8.0,), max_looks=12))
    everywhere = Region(0.0, 0.0, 640.0, 480.0, side_px=4.0)
    parts = len(windows(everywhere, 640, 480, Input(SIDE, SIDE, (8.0,), 4.0, 12)))
    calls = [bool(detector.detect(image, everywhere)) for _ in range(math.ceil(parts / 12))]
    assert sum(calls) in (1, 2)  # two tiles may share it
    near = Region(300.0, 200.0, 500.0, 300.0, side_px=8.0)
    assert len(windows(near, 640, 480, Input(SIDE, SIDE, (16.0,), 4.0, 2))) <= 2


@pytest.mark.parametrize("region", [(0, 0, 640, 480), (200, 100, 420, 300), (-50, 400, 90, 600)])
@pytest.mark.parametrize("side_px", [12.0, 40.0, 170.0])
def test_an_object_whose_middle_is_in_the_region_is_whole_in_a_part(
    region: tuple[float, float, float, float], side_px: float
) -> None:
    asked = Region(*region, side_px=side_px)
    inside = asked.clipped(640, 480)
    assert inside is not None
    parts = windows(asked, 640, 480, Input(416, 416, (64.0, 128.0), 4.0, 4))
    rng = np.random.default_rng(0)
    for u, v in rng.uniform((inside.x0, inside.y0), (inside.x1, inside.y1), (60, 2)):
        half = 0.5 * side_px
        x0, y0, x1, y1 = max(u - half, 0), max(v - half, 0), min(u + half, 640), min(v + half, 480)
        whole = [p[0] <= x0 and p[1] <= y0 and p[2] >= x1 and p[3] >= y1 for p in parts]
        assert any(whole)
