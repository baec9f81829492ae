"""Which export of a detector a model file is. There are many, and some differ in nothing but their
values.

An export of YOLOX gives for each cell of its grid the offset of a box's centre from the cell, in
cells, and the logarithm of its size. With ``--decode_in_inference`` it gives the centre and size in
pixels instead, in an output of the very same shape: read as the other one, nothing is ever found.
So the shapes are judged first, and then what the network says to one test picture.
``drivers.detectors.yolox`` asks; nothing here looks for objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from drivers.detectors.onnx_model import FLOAT, HALF, OnnxModel, Shape, Tensor, shown
from drivers.detectors.yolox_boxes import STRIDES, grid
from drivers.interfaces import PartError
from path.arrays import Singles
from path.values import frozen

EXPORT = (
    "export a YOLOX model to ONNX with its authors' tools/export_onnx.py, in float32 and at one size "
    "(github.com/Megvii-BaseDetection/YOLOX), or one with classes of your own"
)
NO_YOLOX = f"its boxes are not read here: {EXPORT}"

FOLLOWS = 0.9  # correlation with the cells' places from which on a number is a place in the image
# YOLOX-nano: half of its centres are within 0.6 cells of their cell, all within 4.1
NEAR_CELLS = 4.0
MOST_LOG = 10.0  # a box of e^10 cells would be as large as no image is
# YOLOX never taught its classes what background is: theirs are 0.08 to 0.16 there, others' below
# 1e-4
LITTLE = 1e-3
SLACK = 0.01  # of float16, beyond 0..1


@frozen
class YoloxExport:
    """What a network takes and gives. ``decoded``: centre and size in px, not in cells and their
    logarithm.
    """

    height: int
    width: int
    classes: int
    decoded: bool


def identify(model: OnnxModel, file: Path) -> YoloxExport:
    """Return how a network's output is to be read.

    Raises:
        PartError: it is none of YOLOX, by shape or by what it says to a test picture; with which
            export it is.
    """
    height, width, classes = _by_shape(model, file)
    try:
        raw = model.run(test_picture(height, width))[0]
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        said = str(error).splitlines()[0]
        raise PartError(f"{file}: it fails on a test picture: {said}", EXPORT) from error
    if raw.shape != (len(grid(height, width)[0]), 5 + classes):
        found = shown(raw.shape)
        raise PartError(
            f"{file}: its output is said to be of another shape than it has, {found}", EXPORT
        )
    if not np.isfinite(raw).all():
        raise PartError(
            f"{file}: its output is not finite on a test picture",
            f"was it cut to float16? {EXPORT}",
        )
    return YoloxExport(height, width, classes, decoded=_is_decoded(raw, height, width, file))


def test_picture(height: int, width: int) -> Singles:
    """Return a picture for a network, (1, 3, h, w) BGR 0..255: slopes of grey with a disc and a
    plate on them.
    """
    picture = np.zeros((height, width, 3), np.float32)
    picture[..., 0] = np.linspace(0.0, 255.0, width)
    picture[..., 1] = np.linspace(0.0, 255.0, height)[:, None]
    picture[..., 2] = 114.0
    cv2.circle(
        picture,
        (width // 2, height // 2),
        min(height, width) // 5,
        (255.0, 255.0, 255.0),
        -1,
    )
    cv2.rectangle(
        picture,
        (width // 10, height // 10),
        (width // 4, height // 3),
        (0.0, 0.0, 0.0),
        -1,
    )
    return np.ascontiguousarray(picture.transpose(2, 0, 1)[None])


# --- by shape


def _by_shape(model: OnnxModel, file: Path) -> tuple[int, int, int]:
    """Return height and width of the input and the number of classes. Raises PartError."""
    found = f"found {_told(model.inputs)} -> {_told(model.outputs)}"
    if len(model.inputs) != 1:
        raise PartError(f"{file}: expected one input, an image, {found}", NO_YOLOX)
    height, width = _input_size(model.inputs[0], file, found)
    if len(model.outputs) != 1:
        what = _many_outputs(model.outputs)
        raise PartError(f"{file}: expected one output of boxes, {found}: {what}", NO_YOLOX)
    output = model.outputs[0]
    if output.kind not in (FLOAT, HALF):
        raise PartError(f"{file}: expected an output of float32 or float16, {found}", EXPORT)
    return height, width, _classes(output.shape, height, width, file, found)


def _input_size(
    image: Tensor,
    file: Path,
    found: str,
) -> tuple[int, int]:
    """Return height and width. A batch that may be of any size is one of 1. Raises PartError."""
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
        any_size = "height and width were left open when it was exported (dynamic axes)"
        raise PartError(
            f"{file}: {expected}: {any_size}", f"export it at the size it was trained for: {EXPORT}"
        )
    if height <= 0 or width <= 0 or height % stride or width % stride:
        raise PartError(f"{file}: {expected}", EXPORT)
    return height, width


def _classes(
    shape: Shape,
    height: int,
    width: int,
    file: Path,
    found: str,
) -> int:
    """Return the number of classes of an output of YOLOX. Raises PartError naming what else it
    is.
    """
    cells = len(grid(height, width)[0])
    expected = f"{file}: expected an output of 1x{cells}x(5 + classes), {found}"
    if len(shape) == 3:
        rows = shape[1]
        columns = shape[2]
        rows_fit = rows == cells or isinstance(rows, str)  # of an export whose axes were left open
        if rows_fit and isinstance(columns, int) and columns >= 6:
            return columns - 5
        if columns == cells and isinstance(rows, int):
            what = f"as of YOLOv8 or YOLO11: {rows} numbers for each of {cells} places, classes without an objectness"
            raise PartError(f"{expected}: {what}", NO_YOLOX)
        if 3 * cells in (rows, columns):
            raise PartError(
                f"{expected}: as of YOLOv5 or YOLOv7, with three anchors a cell", NO_YOLOX
            )
        with_coarsest = cells + (height // 64) * (width // 64)
        if with_coarsest in (rows, columns) or 3 * with_coarsest in (rows, columns):
            raise PartError(
                f"{expected}: of a model with a fourth level, of stride 64 (P6)", NO_YOLOX
            )
        if columns in (6, 7):
            raise PartError(
                f"{expected}: {_SUPPRESSED}",
                f"export it without suppression (NMS) inside; {NO_YOLOX}",
            )
    if len(shape) == 2 and shape[1] in (6, 7):
        raise PartError(
            f"{expected}: {_SUPPRESSED}", f"export it without suppression (NMS) inside; {NO_YOLOX}"
        )
    raise PartError(expected, NO_YOLOX)


_SUPPRESSED = "of an export with suppression (NMS) inside, or of YOLOv10 or YOLO26: a list of boxes, scores and classes"


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


def _is_decoded(
    raw: Singles,
    height: int,
    width: int,
    file: Path,
) -> bool:
    """Return whether an output (n, 5 + classes) on the test picture has its boxes in pixels. Raises
    PartError.

    In pixels, a box's centre follows its cell from left to right and from top to bottom; in cells
    it does not.
    """
    _check_scores(raw, file)
    cells, steps = grid(height, width)
    places = (cells + 0.5) * steps
    if not all(_follows(raw[:, axis], places[:, axis]) for axis in (0, 1)):
        if _in_cells(raw):
            return False
        raise PartError(
            f"{file}: its boxes on a test picture are neither in cells nor in pixels of its grid of strides "
            f"{', '.join(map(str, STRIDES))}",
            NO_YOLOX,
        )
    if _follows(raw[:, 2], places[:, 0]) and _follows(raw[:, 3], places[:, 1]):
        raise PartError(f"{file}: its boxes are two corners each, not centre and size", EXPORT)
    reach = float(np.median(raw[:, 0] / places[:, 0]))
    if not 0.5 < reach < 2.0:
        raise PartError(
            f"{file}: its boxes are in fractions of the image, not in its pixels", EXPORT
        )
    if float(raw[:, 2:4].min()) <= 0.0:
        raise PartError(
            f"{file}: on a test picture there are boxes in pixels without a size", EXPORT
        )
    if float(np.median(raw[:, 5:].max(axis=1))) < LITTLE:
        raise PartError(
            f"{file}: {raw.shape[1]} numbers a place, as of YOLOv8 or YOLO11: classes without an objectness",
            NO_YOLOX,
        )
    return True


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
