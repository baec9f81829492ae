"""How a detector does on pictures that somebody labelled: what it finds, by size and by light, how
far its edges are off, and what it invents. Pure but for the pictures.

A label is found when a box overlaps it by ``LEAST_IOU`` of their union, each box for one label. A
box that overlaps none is invented, unless it lies in a region in which nothing was labelled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from drivers.recordings.labels import Label
from path.arrays import Image
from path.gate.agreement import iou
from path.observations import Box, Detection, Region, common_area
from path.target.kernels import MAD_TO_SIGMA
from path.values import frozen

LEAST_IOU = 0.5
SIZES_PX = (0.0, 20.0, 40.0, 80.0, 160.0, 320.0, math.inf)  # of a label's larger side
LIGHT = (0.0, 50.0, 100.0, math.inf)  # mean grey of a picture, 0..255
LIGHT_NAMES = ("dark", "dim", "bright")
WIDER = 1.0  # of an object's larger side: how much of the picture a search region has on each side

Detect = Callable[[Image, Region | None], Sequence[Detection]]


@frozen
class Judged:
    """What became of one label.

    ``off_px``: of its box's edges (left, top, right, bottom), positive to the right and down; None
    where it was missed.
    """

    side_px: float
    light: float
    off_px: tuple[float, float, float, float] | None


@dataclass(slots=True)
class Measured:
    """All that was counted."""

    pictures: int = 0
    boxes: int = 0
    invented: int = 0
    judged: list[Judged] = field(default_factory=list[Judged])

    def look(
        self,
        picture: Image,
        labels: Iterable[Label],
        detect: Detect,
        regions: bool,
    ) -> None:
        """Judge a detector on one picture.

        Args:
            regions: show it each object in a search region of its own, as D2 does, instead of the
                whole picture once.
        """
        height, width = picture.shape[:2]
        self.pictures += 1
        light = float(picture.mean())
        every = list(labels)
        ignored = [each.in_picture(width, height) for each in every if each.ignored]
        wanted = [each.in_picture(width, height) for each in every if not each.ignored]
        if not regions:
            self._judge(detect(picture, None), wanted, wanted, ignored, light)
            return
        for box in wanted:
            self._judge(detect(picture, _around(box)), [box], wanted, ignored, light)

    def _judge(
        self,
        found: Sequence[Detection],
        wanted: Sequence[Box],
        known: Sequence[Box],
        ignored: Sequence[Box],
        light: float,
    ) -> None:
        """Take up what was found where ``wanted`` was looked for. ``known``: all that is there."""
        self.boxes += len(found)
        free = list(range(len(wanted)))
        off: dict[int, tuple[float, float, float, float]] = {}
        for each in sorted(found, key=lambda each: -each.score):
            best = max(free, key=lambda at: iou(each.box, wanted[at]), default=None)
            if best is not None and iou(each.box, wanted[best]) >= LEAST_IOU:
                free.remove(best)
                off[best] = _edges_off(each.box, wanted[best])
            elif not _is_there(each.box, known, ignored):
                self.invented += 1
        for at, box in enumerate(wanted):
            self.judged.append(Judged(max(box.w, box.h), light, off.get(at)))

    def record(self) -> dict[str, Any]:
        """Return all figures, for a file."""
        return {
            "pictures": self.pictures,
            "boxes": self.boxes,
            "invented": self.invented,
            "least_iou": LEAST_IOU,
            "all": _figures(self.judged),
            "by_size": [
                {"from_px": low, "to_px": None if math.isinf(high) else high, **_figures(of)}
                for low, high, of in self.by_size()
            ],
            "by_light": [{"light": name, **_figures(of)} for name, of in self.by_light()],
        }

    def by_size(self) -> list[tuple[float, float, list[Judged]]]:
        """Return the labels of each range of sizes in which there are some."""
        ranges = pairwise(SIZES_PX)
        parts = [
            (low, high, [each for each in self.judged if low <= each.side_px < high])
            for low, high in ranges
        ]
        return [part for part in parts if part[2]]

    def by_light(self) -> list[tuple[str, list[Judged]]]:
        """Return the labels of each kind of light in which there are some."""
        ranges = zip(LIGHT_NAMES, LIGHT, LIGHT[1:], strict=False)
        parts = [
            (name, [each for each in self.judged if low <= each.light < high])
            for name, low, high in ranges
        ]
        return [part for part in parts if part[1]]

    def lines(self) -> list[str]:
        """Return the table that is printed."""
        rows = [
            f"{'px or light':>12}  {'labelled':>8}  {'found':>7}  {'95 %':>13}  edges off (left, top, right, bottom)"
        ]
        for low, high, of in self.by_size():
            name = f"over {low:.0f}" if math.isinf(high) else f"{low:.0f} to {high:.0f}"
            rows.append(_row(name, of))
        rows += [_row(name, of) for name, of in self.by_light()]
        rows.append(_row("all", self.judged))
        each = self.invented / max(1, self.pictures)
        share = self.invented / max(1, self.boxes)
        rows.append(
            f"invented: {self.invented} of {self.boxes} boxes ({100.0 * share:.1f} %), {each:.2f} a picture"
        )
        return rows


def _around(box: Box) -> Region:
    wider = WIDER * max(box.w, box.h)
    return Region(box.x - wider, box.y - wider, box.x + box.w + wider, box.y + box.h + wider)


def _is_there(
    box: Box,
    known: Sequence[Box],
    ignored: Sequence[Box],
) -> bool:
    """Return whether a box is of another labelled object, or where nothing was labelled."""
    if any(iou(box, each) >= LEAST_IOU for each in known):
        return True
    return any(common_area(box, each) >= 0.5 * box.area for each in ignored)


def _edges_off(found: Box, true: Box) -> tuple[float, float, float, float]:
    return (
        found.x - true.x,
        found.y - true.y,
        found.x + found.w - true.x - true.w,
        found.y + found.h - true.y - true.h,
    )


def _figures(of: Sequence[Judged]) -> dict[str, Any]:
    edges = np.array([each.off_px for each in of if each.off_px is not None])
    low, high = _interval(len(edges), len(of))
    if len(edges):
        bias = np.median(edges, axis=0).round(2).tolist()
        sigma = (MAD_TO_SIGMA * np.median(np.abs(edges - bias), axis=0)).round(2).tolist()
    else:
        bias = sigma = None
    return {
        "labelled": len(of),
        "found": len(edges),
        "found_95": [round(low, 4), round(high, 4)],
        "bias_px": bias,
        "sigma_px": sigma,
    }


def _interval(found: int, labelled: int) -> tuple[float, float]:
    if not labelled:
        return 0.0, 1.0
    from scipy.stats import binomtest  # noqa: PLC0415 (a second to import)

    between = binomtest(found, labelled).proportion_ci(method="wilson")
    return float(between.low), float(between.high)


def _row(name: str, of: Sequence[Judged]) -> str:
    it = _figures(of)
    labelled = it["labelled"]
    low, high = it["found_95"]
    share = f"{100.0 * it['found'] / labelled:.1f} %" if labelled else "-"
    between = f"{100.0 * low:.1f} to {100.0 * high:.1f}"
    off = "-"
    if it["bias_px"] is not None:
        pairs = zip(it["bias_px"], it["sigma_px"], strict=True)
        off = ", ".join(f"{bias:+.1f} ± {sigma:.1f}" for bias, sigma in pairs)
    return f"{name:>12}  {labelled:>8}  {share:>7}  {between:>13}  {off}"
