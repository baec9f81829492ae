"""Which export of a detector a model file is. There are many, and some differ in nothing but their
values.

An export of YOLOX gives for each cell of its grid the offset of a box's centre from the cell, in
cells, and the logarithm of its size. With ``--decode_in_inference`` it gives the centre and size in
pixels instead, in an output of the very same shape: read as the other one, nothing is ever found.
YOLOv5 and YOLOv7 have three such rows a cell, YOLOv8 and YOLO11 none for the objectness, RT-DETR a
few hundred rows of no cell in shares of the image, and what is exported with suppression inside, or
needs none, a list. So the shapes are judged first, and then what the network says to one test
picture. ``drivers.detectors.yolox`` asks; nothing here looks for objects.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from drivers.detectors.onnx_model import FLOAT, HALF, OnnxModel, Shape, Tensor, shown
from drivers.detectors.yolox_boxes import STRIDES, grid
from drivers.interfaces import PartError
from path.arrays import Singles
from path.values import frozen

EXPORT = (
    "export a YOLOX model to ONNX with its authors' tools/export_onnx.py, in float32 and at one size "
    "(github.com/Megvii-BaseDetection/YOLOX), or one of YOLOv5 to YOLO26 or RT-DETR with Ultralytics' export"
)
NO_YOLO = f"its boxes are not read here: {EXPORT}"

FOLLOWS = 0.9  # correlation with the cells' places from which on a number is a place in the image
# YOLOX-nano: half of its centres are within 0.6 cells of their cell, all within 4.1
NEAR_CELLS = 4.0
MOST_LOG = 10.0  # a box of e^10 cells would be as large as no image is
# YOLOX never taught its classes what background is: theirs are 0.08 to 0.16 there, others' below
# 1e-4
LITTLE = 1e-3
SLACK = 0.01  # of float16, beyond 0..1
BEYOND = 0.5  # of the image, that a box in shares of it may reach over it
MOST_LISTED = 1000  # rows of a list; 300 are usual
TO_ONE = 1.0 / 255.0
CELLS_A_PX2 = sum(1.0 / stride**2 for stride in STRIDES)
SQUARE = 0.01  # px, by which a number of cells may miss that of a square input
OPEN_SIDES = (640, 416)  # tried where an export left its size open and names none

Head = Literal["cells", "pixels", "anchors", "plain", "queries", "listed"]
KINDS: Mapping[Head, str] = {
    "pixels": "as of YOLOX",
    "anchors": "as of YOLOv5 or YOLOv7, with three anchors a cell",
    "plain": "as of YOLOv8 or YOLO11",
}
SEEN = 0.2  # score of the drawn clock from which on a network has seen it


@frozen
class Export:
    """What a network takes and gives.

    Attributes:
        classes: their number; 0 where the output does not tell.
        head: what a row is. "cells": offset from its cell and logarithm of its size, objectness,
            classes. "pixels": centre and size in px, objectness, classes; "anchors": three of those
            a cell. "plain": centre and size in px, classes. "queries": that in shares of the input.
            "listed": two corners in px, score, class.
        scale: times 0..255, what it is given; YOLOX takes BGR, all others RGB.
        turned: a row stands in a column.
        names: of the classes, as the file has them; () where it has none.
    """

    height: int
    width: int
    classes: int
    head: Head
    turned: bool = False
    names: tuple[str, ...] = ()
    scale: float = 1.0

    @property
    def is_yolox(self) -> bool:
        return self.head in ("cells", "pixels")


def identify(model: OnnxModel, file: Path) -> Export:
    """Return how a network's output is to be read.

    Raises:
        PartError: it is none of these, by shape or by what it says to a test picture; with what it
            probably is.
    """
    _check_one(model, file)
    names = _names(model.metadata)
    sizes = _input_sizes(
        model.inputs[0], model.metadata, model.outputs[0].shape, file, _found(model)
    )
    if model.outputs[0].kind not in (FLOAT, HALF):
        wanted = "expected an output of float32 or float16"
        raise PartError(f"{file}: {wanted}, {_found(model)}", EXPORT)
    height, width, raw = _tried(model, sizes, file)
    _check_said(model.outputs[0].shape, (1, *raw.shape), file)
    head, turned = _by_shape(raw, height, width, names, f"{file}: {_found(model)}")
    scale = 1.0
    if head == "cells":
        head = _by_values(raw, height, width, names, file)
    if head not in ("cells", "pixels"):
        picture = test_picture(height, width)
        answers = {by: _answer(model, as_rgb(picture, by), file) for by in (TO_ONE, 1.0)}
        best = {by: _best(answer.T if turned else answer) for by, answer in answers.items()}
        # most take 0..1; some have that inside, and see nothing in what is as good as black
        scale = 1.0 if best[1.0] > SEEN > best[TO_ONE] else TO_ONE
        raw = answers[scale]
    rows = raw.T if turned else raw
    if head in ("plain", "anchors"):
        _check_pixels(rows, height, width, file, head)
    elif head == "queries":
        head = _of_few(rows, file)
    of_class = {"cells": 5, "pixels": 5, "anchors": 5, "plain": 4, "queries": 4}
    classes = len(names) if head == "listed" else rows.shape[1] - of_class[head]
    return Export(height, width, classes, head, turned, names, scale)


def as_rgb(picture: Singles, scale: float) -> Singles:
    """Return a picture (1, 3, h, w) of BGR 0..255 as RGB, so many times as large."""
    return np.ascontiguousarray(picture[:, ::-1]) * np.float32(scale)


def _best(rows: Singles) -> float:
    """Return the best score in rows of whichever head, about."""
    return float(rows[:, 4:].max()) if rows.shape[1] != 6 else float(rows[:, 4].max())


def test_picture(height: int, width: int) -> Singles:
    """Return a picture for a network, (1, 3, h, w) BGR 0..255: a clock, which networks of COCO know,
    and a plate on slopes of grey.
    """
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0] = np.linspace(0, 255, width)
    picture[..., 1] = np.linspace(0, 255, height)[:, None]
    picture[..., 2] = 114
    side = min(height, width)
    middle = (width // 2, height // 2)
    dark = (20.0, 20.0, 20.0)
    cv2.circle(picture, middle, side // 4, (250.0, 250.0, 250.0), -1)
    cv2.circle(picture, middle, side // 4, dark, max(1, side // 55))
    for hour in range(12):
        angle = hour * math.pi / 6.0
        u = middle[0] + 0.2 * side * math.sin(angle) - 0.027 * side
        v = middle[1] - 0.2 * side * math.cos(angle) + 0.018 * side
        size = side / 630.0
        written = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, str(hour or 12), (int(u), int(v)), written, size, dark, 2)
    thick = max(1, side // 90)
    cv2.line(picture, middle, (middle[0], int(middle[1] - 0.16 * side)), dark, thick)
    cv2.line(
        picture, middle, (int(middle[0] + 0.11 * side), int(middle[1] + 0.07 * side)), dark, thick
    )
    cv2.rectangle(
        picture,
        (width // 20, height // 20),
        (width // 6, height // 5),
        (0.0, 0.0, 0.0),
        -1,
    )
    return np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)


# --- by shape


def _found(model: OnnxModel) -> str:
    return f"found {_told(model.inputs)} -> {_told(model.outputs)}"


def _check_one(model: OnnxModel, file: Path) -> None:
    """Raise PartError for a network of several inputs or outputs."""
    if len(model.inputs) != 1:
        raise PartError(f"{file}: expected one input, an image, {_found(model)}", NO_YOLO)
    if len(model.outputs) != 1:
        what = _many_outputs(model.outputs)
        raise PartError(f"{file}: expected one output of boxes, {_found(model)}: {what}", NO_YOLO)


def _names(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """Return the classes' names that Ultralytics' exports have beside the network; () without."""
    try:
        named = ast.literal_eval(metadata.get("names", "{}"))
    except (ValueError, SyntaxError):
        return ()
    if isinstance(named, dict):
        of: dict[Any, Any] = named  # pyright: ignore[reportUnknownVariableType]
        return tuple(str(of[key]) for key in sorted(of))
    return ()


def _input_sizes(
    image: Tensor,
    metadata: Mapping[str, str],
    said: Shape,
    file: Path,
    found: str,
) -> list[tuple[int, int]]:
    """Return height and width, several to try where they were left open. A batch that may be of any
    size is one of 1. Raises PartError.
    """
    stride = STRIDES[-1]
    expected = f"expected an input of 1x3xHxW, H and W multiples of {stride}, {found}"
    if image.kind not in (FLOAT, HALF):
        whole = "its input is whole numbers: this is a quantised export, or one that scales the image itself"
        raise PartError(f"{file}: {expected}: {whole}", EXPORT)
    shape = image.shape
    if len(shape) != 4:
        raise PartError(f"{file}: {expected}", EXPORT)
    if shape[3] == 3:
        raise PartError(
            f"{file}: {expected}: its colours come last, as of an export for TensorFlow", EXPORT
        )
    batch, channels, height, width = shape
    if isinstance(batch, int) and batch != 1:
        raise PartError(
            f"{file}: {expected}: it takes {batch} images at once",
            f"export it with a batch of 1: {EXPORT}",
        )
    if channels != 3:
        raise PartError(f"{file}: {expected}", EXPORT)
    if not isinstance(height, int) or not isinstance(width, int):
        trained = [int(side) for side in re.findall(r"\d+", metadata.get("imgsz", ""))]
        rows = [side for side in said if isinstance(side, int)]
        squares = [math.sqrt(side / CELLS_A_PX2) for side in rows]
        fitting = [
            round(side) for side in squares if abs(side - stride * round(side / stride)) < SQUARE
        ]
        sides = trained[:1] or fitting[:1] or list(OPEN_SIDES)
        return [(side, trained[1] if len(trained) == 2 else side) for side in sides]
    if height <= 0 or width <= 0 or height % stride or width % stride:
        raise PartError(f"{file}: {expected}", EXPORT)
    return [(height, width)]


def _tried(
    model: OnnxModel,
    sizes: Sequence[tuple[int, int]],
    file: Path,
) -> tuple[int, int, Singles]:
    """Return the first size at which a network answers, and what it says. Raises PartError."""
    for height, width in sizes[:-1]:
        try:
            return height, width, _answer(model, test_picture(height, width), file)
        except PartError:
            continue
    height, width = sizes[-1]
    return height, width, _answer(model, test_picture(height, width), file)


def _answer(model: OnnxModel, picture: Singles, file: Path) -> Singles:
    """Return what a network says to a picture, without the batch. Raises PartError."""
    try:
        raw = model.run(picture)
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        said = str(error).splitlines()[0]
        raise PartError(f"{file}: it fails on a test picture: {said}", EXPORT) from error
    if raw.ndim == 2 and raw.shape[1] in (6, 7):
        what = f"{_found(model)}: of an export with suppression (NMS) inside, as of YOLOv7"
        raise PartError(f"{file}: expected rows of boxes, {what}", f"export it without; {NO_YOLO}")
    if raw.ndim != 3 or len(raw) != 1:
        raise PartError(f"{file}: expected an output of rows of boxes, {_found(model)}", NO_YOLO)
    if not np.isfinite(raw).all():
        raise PartError(
            f"{file}: its output is not finite on a test picture",
            f"was it cut to float16? {EXPORT}",
        )
    return raw[0]


def _check_said(said: Shape, found: tuple[int, ...], file: Path) -> None:
    """Raise PartError where an output has another shape than it is said to have."""
    fits = len(said) == len(found) and all(
        isinstance(side, str) or side == own for side, own in zip(said, found, strict=True)
    )
    if not fits:
        shape = shown(found)
        raise PartError(
            f"{file}: its output is said to be of another shape than it has, {shape}", EXPORT
        )


def _by_shape(
    raw: Singles,
    height: int,
    width: int,
    names: Sequence[str],
    where: str,
) -> tuple[Head, bool]:
    """Return which head it is, and whether rows stand in columns, as far as the shape tells. Raises
    PartError naming what else it is.
    """
    cells = len(grid(height, width)[0])
    rows, columns = raw.shape
    if rows == cells and columns >= 5:
        without = columns == 5 or columns - 4 == len(names)
        return ("plain", False) if without else ("cells", False)
    if columns == cells and rows >= 5:
        return "plain", True
    if rows == 3 * cells and columns >= 6:
        return "anchors", False
    with_coarsest = cells + (height // 64) * (width // 64)
    if with_coarsest in (rows, columns) or 3 * with_coarsest in (rows, columns):
        raise PartError(f"{where}: of a model with a fourth level, of stride 64 (P6)", NO_YOLO)
    if rows <= MOST_LISTED and columns >= 5:
        return "queries", False
    raise PartError(
        f"{where}: expected {cells} rows of 5 + classes, or 4 + classes, or 3 x {cells} rows",
        NO_YOLO,
    )


def _many_outputs(outputs: Sequence[Tensor]) -> str:
    """Return what a network with several outputs, or none, probably is."""
    names = " ".join(output.name.lower() for output in outputs)
    shapes = [output.shape for output in outputs]
    if "logits" in names:
        return "as of DETR and its kin"
    if "num_det" in names or any(word in names for word in ("nms", "detection_boxes", "labels")):
        return "of an export with suppression (NMS) inside"
    if any(len(shape) == 5 for shape in shapes):
        return "as of YOLOv5's or YOLOv7's layers, without their last one"
    if len(outputs) == 2 and [len(shape) for shape in shapes] == [3, 4]:
        return "as of a YOLO that gives outlines too (segmentation)"
    if len(outputs) in (3, 6, 9):
        return "the levels one by one, cut off before they are put together"
    return "as of another kind of detector"


def _told(tensors: Sequence[Tensor]) -> str:
    """Return shapes for a message, with the names where there are several, and kinds where they are
    not usual.
    """
    if len(tensors) == 1 and tensors[0].kind == FLOAT:
        return shown(tensors[0].shape)
    return ", ".join(tensor.text for tensor in tensors) or "nothing"


# --- by values


def _by_values(
    raw: Singles,
    height: int,
    width: int,
    names: Sequence[str],
    file: Path,
) -> Head:
    """Return which head an output (n, 5 + classes), or (n, 4 + classes), is. Raises PartError.

    In pixels, a box's centre follows its cell from left to right and from top to bottom; in cells
    it does not.
    """
    _check_scores(raw, file)
    places = _places(height, width, "pixels")
    if not all(_follows(raw[:, axis], places[:, axis]) for axis in (0, 1)):
        if _in_cells(raw):
            return "cells"
        raise PartError(
            f"{file}: its boxes on a test picture are neither in cells nor in pixels of its grid of strides "
            f"{', '.join(map(str, STRIDES))}",
            NO_YOLO,
        )
    _check_pixels(raw, height, width, file, "pixels")
    has_objectness = raw.shape[1] - 5 == len(names) or (
        float(np.median(raw[:, 5:].max(axis=1))) >= LITTLE
    )
    return "pixels" if has_objectness else "plain"


def _places(height: int, width: int, head: Head) -> Singles:
    """Return where in the input each row's cell is, (n, 2) px."""
    cells, steps = grid(height, width)
    places = (cells + 0.5) * steps
    if head != "anchors":
        return places
    ends = np.flatnonzero(np.diff(steps[:, 0])) + 1
    return np.concatenate([np.tile(level, (3, 1)) for level in np.split(places, ends)])


def _check_pixels(rows: Singles, height: int, width: int, file: Path, head: Head) -> None:
    """Raise PartError for boxes that are not centre and size in px of their cells."""
    _check_scores(rows, file)
    places = _places(height, width, head)
    if not all(_follows(rows[:, axis], places[:, axis]) for axis in (0, 1)):
        raise PartError(
            f"{file}: its boxes on a test picture do not follow the places of its grid, {KINDS[head]}",
            NO_YOLO,
        )
    if _follows(rows[:, 2], places[:, 0]) and _follows(rows[:, 3], places[:, 1]):
        raise PartError(f"{file}: its boxes are two corners each, not centre and size", EXPORT)
    reach = float(np.median(rows[:, 0] / places[:, 0]))
    if not 0.5 < reach < 2.0:
        raise PartError(
            f"{file}: its boxes are in fractions of the image, not in its pixels", EXPORT
        )
    if float(rows[:, 2:4].min()) <= 0.0:
        raise PartError(
            f"{file}: on a test picture there are boxes in pixels without a size", EXPORT
        )


def _of_few(rows: Singles, file: Path) -> Head:
    """Return which of the heads without a grid it is. Raises PartError."""
    whole = rows.shape[1] == 6 and bool((rows[:, 5] == np.round(rows[:, 5])).all())
    if whole and bool((rows[:, 2:4] >= rows[:, :2]).all()):
        _check_scores(rows[:, :5], file)
        return "listed"
    if float(rows[:, :4].min()) < -SLACK or float(rows[:, :4].max()) > 1.0 + BEYOND:
        raise PartError(
            f"{file}: {len(rows)} rows of {rows.shape[1]} numbers on a test picture are neither a list of boxes, scores"
            " and classes, as with suppression (NMS) inside or of YOLOv10, nor in shares of the image as of RT-DETR",
            NO_YOLO,
        )
    _check_scores(rows, file)
    return "queries"


def _check_scores(raw: Singles, file: Path) -> None:
    scores = raw[:, 4:]
    if float(scores.min()) < -SLACK or float(scores.max()) > 1.0 + SLACK:
        raise PartError(
            f"{file}: its scores on a test picture are {scores.min():.3g} to {scores.max():.3g}, no probabilities: "
            "the sigmoid was left out, or they stand elsewhere",
            EXPORT,
        )


def _follows(values: Singles, places: Singles) -> bool:
    """Return whether numbers grow with their cells' places in the image."""
    if float(np.ptp(values)) <= 0.0:
        return False
    return float(np.corrcoef(values, places)[0, 1]) > FOLLOWS


def _in_cells(raw: Singles) -> bool:
    """Return whether centres are near their cells, and sizes are logarithms."""
    near = float(np.median(np.abs(raw[:, :2]))) < NEAR_CELLS
    return near and float(np.abs(raw[:, 2:4]).max()) < MOST_LOG
