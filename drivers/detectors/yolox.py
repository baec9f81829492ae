"""Detectors of the YOLO family through onnxruntime. The weights are a file that a rig names; PATH
comes without.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from drivers.detectors.coco import COCO
from drivers.detectors.looks import Input, Window, windows
from drivers.detectors.onnx_model import OnnxModel
from drivers.detectors.yolox_boxes import (
    best_boxes,
    decode,
    grid,
    listed_boxes,
    merge,
    suppress,
)
from drivers.detectors.yolox_exports import EXPORT, Export, as_rgb, identify
from drivers.interfaces import PartError
from drivers.rig.tables import suggestion
from drivers.text_file import read_file
from path.arrays import Flags, Image, Singles
from path.bounds import Bounds
from path.observations import Box, Detection, Region
from path.values import frozen

FILL = 114.0  # grey level around an image that does not fill the input
# the score from which on a whole object is one to the flight (``flight.tracking.objects``)
BELIEVED = 0.3
BORDER_PX = 2.0  # of the input: what ends so near to a part of the image may go on beyond it
MODEL_VARIABLE = "PATH_YOLOX"
NAME_ONE = (
    "name one: --model yolox_nano.onnx, PATH_YOLOX=yolox_nano.onnx in the environment, or `model` in the rig's table "
    "of the detector (docs/detectors.md says what it has to be)"
)


@frozen
class YoloxDetectorConfig:
    """
    Attributes:
        model: the ONNX file, relative to the rig; None: the one that PATH_YOLOX names.
        classes: names of what is looked for; empty: everything.
        names: file with the names of the model's classes, one a line; None: the 80 of COCO.
        min_score: objectness times class, below it nothing is found; what is found is told of with
            scores on a scale on which this is ``BELIEVED``.
        max_iou: of two boxes of one class that overlap more, the better one stays.
        sizes_px: how long an object should be in the network's input. The image is cut up and
            enlarged for each, by how large the object is expected to be (``looks``): each costs a
            pass of the network, where it makes a difference.
        max_zoom: a part of the image is enlarged at most so much for that.
        max_looks: passes of the network for one image. A region is rather enlarged less; a whole
            image is looked at in turns, from call to call.
        side_px: how long an object is in whole images, where nobody says; None: they are looked at
            as they are.
        threads: of onnxruntime.
    """

    model: Path | None = None
    classes: tuple[str, ...] = ()
    names: Path | None = None
    min_score: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.3
    max_iou: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.45
    sizes_px: Annotated[tuple[float, ...], Bounds(8.0, 1024.0)] = (64.0, 128.0)
    max_zoom: Annotated[float, Bounds(1.0, 16.0, "times")] = 4.0
    max_looks: Annotated[int, Bounds(1, 256, "looks")] = 4
    side_px: Annotated[float | None, Bounds(1.0, 16384.0)] = None
    threads: Annotated[int, Bounds(0, 256, "threads")] = 1

    def __post_init__(self) -> None:
        for name in ("min_score", "max_iou"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name}: {getattr(self, name)!r} is not within 0..1")
        if self.max_zoom < 1.0 or self.max_looks < 1 or self.threads < 0:
            raise ValueError("max_zoom and max_looks must be at least 1, threads not negative")
        if not self.sizes_px or min(self.sizes_px) <= 0.0:
            raise ValueError("sizes_px must be one or more lengths above 0")

    def check_ready(self) -> None:
        """Raise PartError when no model is named, or there is no such file."""
        self.weights()

    def weights(self) -> Path:
        """Return the ONNX file. Raises PartError when none is named, or there is no such file."""
        named = os.environ.get(MODEL_VARIABLE, "")
        if self.model is None and not named:
            raise PartError(
                "YOLOX finds nothing without a model file, and none was named", NAME_ONE
            )
        file = Path(named) if self.model is None else self.model
        if not file.is_file():
            raise PartError(f"{file}: there is no such file; expected a network in ONNX", EXPORT)
        return file


class YoloxDetector:
    """Implements ``drivers.interfaces.Detector``. Between calls it only knows which part of a whole
    image it looks at next.
    """

    Config = YoloxDetectorConfig
    whole_image = True  # what depth would cut off belongs to how a thing looks

    def __init__(self, config: YoloxDetectorConfig, context: object | None = None) -> None:
        """Raise PartError: a missing file, expected and found, a class that the model has not."""
        del context  # made like every part of a rig, but needs nothing of the role
        self._config = config
        file = config.weights()
        self._model = OnnxModel(file, config.threads, EXPORT)
        self._export = identify(self._model, file)
        self._height = self._export.height
        self._width = self._export.width
        self._cells, self._steps = grid(self._height, self._width)
        self._scored = _scored(config, file, self._export)
        self._power = math.log(BELIEVED) / math.log(config.min_score)
        self._input = Input(
            self._width,
            self._height,
            config.sizes_px,
            config.max_zoom,
            config.max_looks,
        )
        self._turn = 0

    def detect(self, image: Image, region: Region | None) -> Sequence[Detection]:
        """Boxes of the classes looked for, best score first.

        Args:
            image: (h, w, 3) uint8 BGR.
            region: only objects whose box centre is inside: the network sees the image around it,
                enlarged; None for the whole image.
        """
        height, width = image.shape[:2]
        if region is None and self._config.side_px is not None:
            everywhere = (0.0, 0.0, float(width), float(height))
            region = Region(*everywhere, side_px=self._config.side_px)
        parts = self._next(windows(region, width, height, self._input))
        if not parts:
            return ()
        looks = [self._look(image, part, cut=len(parts) > 1) for part in parts]
        boxes, scores, classes = (np.concatenate(of) for of in zip(*looks, strict=True))
        whose = np.repeat(np.arange(len(looks)), [len(look[1]) for look in looks])
        kept = merge(boxes, scores, classes, whose)
        found: list[Detection] = []
        for (x, y, w, h), score in zip(boxes[kept].tolist(), scores[kept].tolist(), strict=True):
            # edges to pixel centres: the first pixel's edge is at -0.5
            box = Box(x - 0.5 * w - 0.5, y - 0.5 * h - 0.5, w, h)
            if region is None or region.contains(*box.center):
                found.append(Detection(box, min(1.0, score) ** self._power))
        return found

    def _next(self, parts: Sequence[Window]) -> Sequence[Window]:
        """Return as many parts of an image as one call may look at, those that follow the last."""
        most = self._config.max_looks
        if len(parts) <= most:
            return parts
        first = self._turn % len(parts)
        self._turn = first + most
        return [*parts[first:], *parts][:most]

    def _look(self, image: Image, part: Window, *, cut: bool) -> tuple[Singles, ...]:
        """Boxes (m, 4) as centre and size in px of the image's edges, scores and classes of one
        pass. ``cut``: boxes that end where the part does are left out, another part has them whole.
        """
        x0, y0, x1, y1 = part
        tensor, across, down = self._letterboxed(image[y0:y1, x0:x1])
        raw = self._model.run(tensor)[0]
        boxes, scores, classes = self._read(raw)
        kept = suppress(boxes, scores, classes, self._config.max_iou)
        zoom = np.array((across, down, across, down), np.float32)
        boxes = boxes[kept] / zoom + np.array((x0, y0, 0.0, 0.0), np.float32)
        if not cut:
            return boxes, scores[kept], classes[kept]
        ends = np.array(part)
        at_border = ends == (0, 0, image.shape[1], image.shape[0])
        half = 0.5 * boxes[:, 2:]
        edges = np.concatenate((boxes[:, :2] - half, boxes[:, :2] + half), axis=1)
        inside = np.abs(edges - ends) > BORDER_PX / zoom
        whole = (inside | at_border).all(axis=1)
        return boxes[whole], scores[kept][whole], classes[kept][whole]

    def _read(self, raw: Singles) -> tuple[Singles, ...]:
        """Boxes in px of the input, scores and classes, of an output of whichever form."""
        least = self._config.min_score
        head = self._export.head
        if head == "cells":
            return decode(raw, self._cells, self._steps, self._scored, least)
        if head == "listed":
            return listed_boxes(raw, self._scored, least)
        rows = np.ascontiguousarray(raw.T) if self._export.turned else raw
        with_objectness = head in ("pixels", "anchors")
        boxes, scores, classes = best_boxes(rows, self._scored, least, with_objectness)
        if head == "queries":
            boxes = boxes * np.array((self._width, self._height) * 2, np.float32)
        return boxes, scores, classes

    def _letterboxed(self, part: Image) -> tuple[Singles, float, float]:
        """The network's input, (1, 3, h, w) with grey right and below; how much larger it is, each
        way.
        """
        height, width = part.shape[:2]
        scale = min(self._height / height, self._width / width, self._config.max_zoom)
        w = max(1, round(width * scale))
        h = max(1, round(height * scale))
        fitted = cv2.resize(part, (w, h), interpolation=cv2.INTER_LINEAR)
        tensor = np.full((1, 3, self._height, self._width), FILL, np.float32)
        tensor[0, :, :h, :w] = fitted.transpose(2, 0, 1)
        if not self._export.is_yolox:
            tensor = as_rgb(tensor, self._export.scale)
        return tensor, w / width, h / height


def _scored(
    config: YoloxDetectorConfig,
    file: Path,
    export: Export,
) -> Flags:
    """Return which of the model's classes are looked for. Raises PartError."""
    names = (export.names or COCO) if config.names is None else _read_names(config.names)
    count = export.classes or len(names)
    if not config.classes:
        return np.ones(count, np.bool_)
    if len(names) != count:
        usual = "it names itself" if export.names else "COCO has"
        source = usual if config.names is None else f"{config.names} names"
        other = len(names) == count + 1
        perhaps = (
            " (is it an export without an objectness, as of YOLOv8 or YOLO11?)" if other else ""
        )
        raise PartError(
            f"{file}: expected {count} names of classes, {source} {len(names)}{perhaps}",
            'name a file with one class a line: names = "classes.txt"',
        )
    for name in config.classes:
        if name not in names:
            raise PartError(f"classes: the model knows no '{name}'{suggestion(name, names)}",
                            f"it knows {', '.join(names[:12])}{', ...' if len(names) > 12 else ''}")  # fmt: skip
    return np.array([name in config.classes for name in names])


def _read_names(file: Path) -> tuple[str, ...]:
    try:
        return tuple(
            line.strip() for line in read_file(file).decode("utf-8").splitlines() if line.strip()
        )
    except (OSError, UnicodeDecodeError) as error:
        raise PartError(
            f"{file}: {error}", "write the names of the model's classes into it, one a line"
        ) from error
