"""Exports of detectors as people have them: those of YOLOX are read, others are refused as what
they are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.detectors.yolox import YoloxDetector, YoloxDetectorConfig
from drivers.detectors.yolox_boxes import grid
from drivers.interfaces import PartError
from tests.drivers.detectors.onnx_graphs import HALF, UINT8, fixed_network, lit_network

Floats = NDArray[np.float32]

SIDE, CLASSES = 256, 3
CELLS, STEPS = grid(SIDE, SIDE)
FOUND = 32 * 3 + 5  # the cell in column 5, row 3 of the finest level; the others see nothing
IMAGE = np.zeros((SIDE, SIDE, 3), np.uint8)


def in_cells() -> Floats:
    """One object of 16 x 24 px about (44, 28), in a plain export."""
    rng = np.random.default_rng(0)
    raw = np.empty((len(CELLS), 5 + CLASSES), np.float32)
    raw[:, :2] = rng.normal(0.5, 0.6, (len(CELLS), 2))
    raw[:, 2:4] = rng.normal(0.8, 0.5, (len(CELLS), 2))
    raw[:, 4] = 1e-5
    raw[:, 5:] = 0.1
    raw[FOUND] = (0.5, 0.5, np.log(2.0), np.log(3.0), 0.9, 0.05, 0.95, 0.05)
    return raw[None]


def in_pixels() -> Floats:
    """The same, exported with its decoding inside."""
    raw = in_cells()
    raw[0, :, :2] = (raw[0, :, :2] + CELLS) * STEPS
    raw[0, :, 2:4] = np.exp(raw[0, :, 2:4]) * STEPS
    return raw


def without_objectness() -> Floats:
    rows = in_pixels()
    return np.concatenate((rows[..., :4], rows[..., 4:5] * rows[..., 5:]), axis=2)


def corners() -> Floats:
    rows = in_pixels()
    center, size = rows[..., :2].copy(), rows[..., 2:4].copy()
    rows[..., :2], rows[..., 2:4] = center - 0.5 * size, center + 0.5 * size
    return rows


def fractions() -> Floats:
    rows = in_pixels()
    rows[..., :4] /= SIDE
    return rows


def logits() -> Floats:
    rows = in_cells()
    rows[..., 4:] = np.log(rows[..., 4:] / (1.0 - rows[..., 4:]))
    return rows


def other_strides() -> Floats:
    rows = in_cells()
    rows[..., :2] *= 20.0
    return rows


def not_finite() -> Floats:
    rows = in_cells()
    rows[0, 3, 2] = np.nan
    return rows


def detector(file: Path) -> YoloxDetector:
    return YoloxDetector(YoloxDetectorConfig(file))


@pytest.mark.parametrize("kind", ["float32", "float16", "a batch of any size", "any size"])
@pytest.mark.parametrize("decoded", [False, True], ids=["plain", "decoded inside"])
def test_an_export_of_yolox_gives_the_same_box_in_whichever_form_it_is(
    tmp_path: Path, decoded: bool, kind: str
) -> None:
    options: dict[str, Any] = {}
    if kind == "float16":
        options["kind"] = HALF
    if kind == "a batch of any size":
        options["shape"] = ("batch", 3, SIDE, SIDE)
    if kind == "any size":  # its rows tell which one
        options["shape"] = ("batch", 3, "height", "width")
    file = fixed_network(tmp_path / "m.onnx", in_pixels() if decoded else in_cells(), **options)
    (found,) = detector(file).detect(IMAGE, None)
    assert found.box.center == pytest.approx((44.0 - 0.5, 28.0 - 0.5), abs=0.05)
    assert (found.box.w, found.box.h) == pytest.approx((16.0, 24.0), abs=0.05)
    assert found.score == pytest.approx(0.9 * 0.95, abs=0.01)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (corners(), "two corners each"),
        (fractions(), "fractions of the image"),
        (logits(), "no probabilities: the sigmoid was left out"),
        (other_strides(), "neither in cells nor in pixels"),
        (not_finite(), "not finite on a test picture"),
    ],
    ids=["corners", "fractions", "logits", "other strides", "not finite"],
)
def test_values_that_do_not_fit_an_output_of_the_right_shape_are_refused_as_what_they_are(
    tmp_path: Path, rows: Floats, said: str
) -> None:
    with pytest.raises(PartError, match=said) as caught:
        detector(fixed_network(tmp_path / "m.onnx", rows))
    assert "tools/export_onnx.py" in caught.value.remedy


N = len(CELLS)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((1, N + 16, 85), r"a fourth level, of stride 64 \(P6\)"),
        ((7, 7), r"with suppression \(NMS\) inside"),
        ((1, 1000), "expected an output of rows of boxes"),
        ((1, 2 * N, 85), rf"expected {N} rows of 5 \+ classes"),
    ],
    ids=["p6", "nms of v7", "classifier", "other rows"],
)
def test_an_output_of_another_shape_is_refused_as_what_it_is(
    tmp_path: Path, shape: tuple[int, ...], said: str
) -> None:
    with pytest.raises(PartError, match=said) as caught:
        detector(fixed_network(tmp_path / "m.onnx", np.zeros(shape, np.float32)))
    assert "x".join(map(str, shape)) in str(caught.value)
    assert "export" in caught.value.remedy


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"shape": (8, 3, SIDE, SIDE)}, "it takes 8 images at once"),
        ({"shape": (1, SIDE, SIDE, 3)}, "colours come last, as of an export for TensorFlow"),
        ({"shape": (1, 1, SIDE, SIDE)}, "expected an input of 1x3xHxW"),
        ({"kind": UINT8}, "a quantised export"),
        ({"names": ("logits", "pred_boxes")}, "as of DETR"),
        ({"names": ("num_dets", "boxes", "scores", "classes")}, r"with suppression \(NMS\) inside"),
        ({"names": ("p3", "p4", "p5")}, "the levels one by one"),
    ],
    ids=[
        "batch",
        "colours last",
        "grey",
        "uint8",
        "detr",
        "nms of several outputs",
        "levels",
    ],
)
def test_a_network_of_other_inputs_or_outputs_is_refused_as_what_it_is(
    tmp_path: Path, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(PartError, match=said) as caught:
        detector(fixed_network(tmp_path / "m.onnx", in_cells(), **options))
    assert "export" in caught.value.remedy


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"PK\x03\x04" + bytes(200), "PyTorch's own weights"),
        (b"\x1c\0\0\0TFL3" + bytes(200), "TensorFlow Lite"),
        (b"ftrt" + bytes(200), "an engine of TensorRT"),
        (b"", "cannot be read"),
    ],
    ids=["pt", "tflite", "engine", "empty"],
)
def test_weights_of_another_program_are_refused_as_what_they_are(
    tmp_path: Path, content: bytes, said: str
) -> None:
    file = tmp_path / "m.onnx"
    file.write_bytes(content)
    with pytest.raises(PartError, match=said) as caught:
        detector(file)
    assert "export" in caught.value.remedy


def anchors() -> Floats:
    """As YOLOv5: each level's cells three times."""
    rows = in_pixels()[0]
    ends = np.flatnonzero(np.diff(STEPS[:, 0])) + 1
    levels = [np.tile(level, (3, 1)) for level in np.split(rows, ends)]
    thrice = np.concatenate(levels)
    thrice[np.flatnonzero(thrice[:, 4] > 0.5)[1:], 4] = 1e-5
    return thrice[None]


def queries() -> Floats:
    """As RT-DETR: few rows, of no cell, in shares of the image."""
    rows = np.full((1, 300, 4 + CLASSES), 1e-4, np.float32)
    rows[0, :, :4] = 0.4
    rows[0, 7] = (44.0 / SIDE, 28.0 / SIDE, 16.0 / SIDE, 24.0 / SIDE, 0.04, 0.86, 0.05)
    return rows


def listed() -> Floats:
    """As with suppression inside, or YOLOv10 and YOLO26: two corners, score, class; the rest 0."""
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0] = (36.0, 16.0, 52.0, 40.0, 0.86, 1.0)
    return rows


HEADS = {
    "v8": without_objectness().transpose(0, 2, 1).copy(),
    "v8 turned": without_objectness(),
    "v5": anchors(),
    "rt-detr": queries(),
    "nms": listed(),
}


@pytest.mark.parametrize("kind", ["float32", "float16", "any size"])
@pytest.mark.parametrize("head", HEADS)
def test_exports_of_other_families_give_the_same_box_by_the_names_in_their_file(
    tmp_path: Path, head: str, kind: str
) -> None:
    options: dict[str, Any] = {"metadata": {"names": "{0: 'cat', 1: 'dog', 2: 'cow'}"}}
    if kind == "float16":
        options["kind"] = HALF
    if kind == "any size":
        options["shape"] = ("batch", 3, "height", "width")
        options["metadata"]["imgsz"] = f"[{SIDE}, {SIDE}]"
    file = fixed_network(tmp_path / "m.onnx", HEADS[head], **options)
    (found,) = YoloxDetector(YoloxDetectorConfig(file, classes=("dog",))).detect(IMAGE, None)
    assert found.box.center == pytest.approx((44.0 - 0.5, 28.0 - 0.5), abs=0.1)
    assert (found.box.w, found.box.h) == pytest.approx((16.0, 24.0), abs=0.1)
    assert found.score == pytest.approx(0.86, abs=0.01)
    assert YoloxDetector(YoloxDetectorConfig(file, classes=("cow",))).detect(IMAGE, None) == []
    with pytest.raises(PartError, match="knows no 'car'"):
        YoloxDetector(YoloxDetectorConfig(file, classes=("car",)))


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((1, 300, 9), "neither a list of boxes"),
        ((1, 84, N), "do not follow the places of its grid"),
        ((1, 3 * N, 85), "do not follow the places of its grid"),
        ((1, N, 5), "do not follow the places of its grid"),
    ],
)
def test_rows_of_a_known_number_and_of_something_else_are_refused(
    tmp_path: Path, shape: tuple[int, ...], said: str
) -> None:
    rows = np.full(shape, 40.0 if shape[1] == 300 else 0.5, np.float32)
    with pytest.raises(PartError, match=said):
        detector(fixed_network(tmp_path / "m.onnx", rows))


def test_yolox_takes_bgr_to_255_and_the_others_rgb_to_one(tmp_path: Path) -> None:
    image = np.full((SIDE, SIDE, 3), (255, 0, 51), np.uint8)
    seen: list[Floats] = []
    for rows in (in_cells(), HEADS["v8"]):
        own = detector(fixed_network(tmp_path / "m.onnx", rows))
        seen.append(own._letterboxed(image)[0][0, :, 9, 9])  # pyright: ignore[reportPrivateUsage]
    assert seen[0].tolist() == [255.0, 0.0, 51.0]
    assert seen[1].tolist() == pytest.approx([0.2, 0.0, 1.0])


def test_an_export_that_scales_the_image_itself_is_told_by_what_it_sees(tmp_path: Path) -> None:
    rows = HEADS["v8"]
    file = lit_network(tmp_path / "m.onnx", rows[:, :4].copy(), rows[:, 4:] / 230.0)
    (found,) = detector(file).detect(IMAGE + 200, None)
    assert found.box.center == pytest.approx((44.0 - 0.5, 28.0 - 0.5), abs=0.1)
