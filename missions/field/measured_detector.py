"""How a detector does on pictures that somebody labelled: what it finds, by size and by light, how
far its edges are off, what it invents, and for how many pictures a thing stays missed. Pure but for
the pictures.

A label is found when a box overlaps it by ``LEAST_IOU`` of their union, each box for one label. A
box that has hardly anything of one (``NOTHING_IOU``) is invented, unless it lies in a region in
which nothing was labelled. The record is what ``drivers.detectors.measured`` reads.
"""

from __future__ import annotations

import math
import re
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

LEAST_IOU = 0.4  # as the rates were counted that `sim` draws from
NOTHING_IOU = 0.1
SCORES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
SAME_IOU = 0.3  # of a label in one picture and one in the next, from which on they are of one thing
SIZES_PX = (0.0, 20.0, 40.0, 60.0, 80.0, 110.0, 160.0, 320.0, math.inf)  # of a label's larger side
LIGHT = (0.0, 50.0, 100.0, math.inf)  # mean grey of a picture, 0..255
LIGHT_NAMES = ("dark", "dim", "bright")
USUAL_PX = (
    50.0  # side of a region in a picture in which nothing is labelled, until one was labelled
)
WIDER = 1.0  # of an object's larger side: how much of the picture a search region has on each side

_NUMBERED = re.compile(r"(.*?)(\d+)")
Detect = Callable[[Image, Region | None], Sequence[Detection]]


@frozen
class Judged:
    """What became of one label.

    ``off_px``: of its box's edges (left, top, right, bottom), positive to the right and down; None
    where it was missed. ``score``: of that box.
    """

    box: Box
    light: float
    off_px: tuple[float, float, float, float] | None
    score: float = 0.0

    @property
    def side_px(self) -> float:
        return max(self.box.w, self.box.h)


@dataclass(slots=True)
class _Followed:
    """A thing in pictures that follow each other. ``missed``: in the newest one."""

    box: Box
    missed: bool


@dataclass(slots=True)
class Measured:
    """All that was counted.

    Attributes:
        inventions: the best score of what was invented in each look at a picture or a region; 0
            where nothing was.
        misses: pictures in which a thing was missed that the picture before shows too;
            ``refound``: those in which one was found again.
    """

    pictures: int = 0
    boxes: int = 0
    invented: int = 0
    misses: int = 0
    refound: int = 0
    inventions: list[float] = field(default_factory=list[float])
    judged: list[Judged] = field(default_factory=list[Judged])
    _name: str = ""
    _followed: list[_Followed] = field(default_factory=list[_Followed])

    def look(
        self,
        picture: Image,
        labels: Iterable[Label],
        detect: Detect,
        regions: bool,
        name: str = "",
    ) -> None:
        """Judge a detector on one picture.

        Args:
            regions: show it each object in a search region of its own, as D2 does, instead of the
                whole picture once; where nothing is labelled, one in the picture's middle.
            name: of the picture; one that follows the last by its number shows the same things.
        """
        height, width = picture.shape[:2]
        self.pictures += 1
        light = float(picture.mean())
        every = list(labels)
        ignored = [each.in_picture(width, height) for each in every if each.ignored]
        wanted = [each.in_picture(width, height) for each in every if not each.ignored]
        before = len(self.judged)
        if not regions:
            self._judge(detect(picture, None), wanted, wanted, ignored, light)
        for box in wanted if regions else ():
            self._judge(detect(picture, _around(box)), [box], wanted, ignored, light)
        if regions and not wanted:
            side_px = self.judged[-1].side_px if self.judged else USUAL_PX
            middle = Box(0.5 * (width - side_px), 0.5 * (height - side_px), side_px, side_px)
            self._judge(detect(picture, _around(middle)), [], wanted, ignored, light)
        self._follow(self.judged[before:], follows(self._name, name))
        self._name = name

    def _follow(self, judged: Sequence[Judged], goes_on: bool) -> None:
        """Count how long things stay missed, from one picture to the next."""
        free = self._followed if goes_on else []
        now: list[_Followed] = []
        for each in judged:
            missed = each.off_px is None
            last = max(free, key=lambda one: iou(one.box, each.box), default=None)
            if last is not None and iou(last.box, each.box) >= SAME_IOU:
                free.remove(last)
                self.misses += last.missed
                self.refound += last.missed and not missed
            now.append(_Followed(each.box, missed))
        self._followed = now

    @property
    def miss_pictures(self) -> float | None:
        """The mean number of pictures for which a thing stays missed; None where that was never
        seen to end.

        Of spells whose lengths are geometric, those that the film's end cuts among them.
        """
        return self.misses / self.refound if self.refound else None

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
        worst = 0.0
        free = list(range(len(wanted)))
        of: dict[int, Detection] = {}
        for each in sorted(found, key=lambda each: -each.score):
            best = max(free, key=lambda at: iou(each.box, wanted[at]), default=None)
            if best is not None and iou(each.box, wanted[best]) >= LEAST_IOU:
                free.remove(best)
                of[best] = each
            elif not _is_there(each.box, known, ignored):
                self.invented += 1
                worst = max(worst, each.score)
        self.inventions.append(worst)
        for at, box in enumerate(wanted):
            one = of.get(at)
            off = None if one is None else _edges_off(one.box, box)
            self.judged.append(Judged(box, light, off, 0.0 if one is None else one.score))

    def record(self) -> dict[str, Any]:
        """Return all figures, for a file."""
        by_light = self.by_light()
        return {
            "pictures": self.pictures,
            "boxes": self.boxes,
            "invented": self.invented,
            "looks": len(self.inventions),
            "looks_inventing": sum(score > 0.0 for score in self.inventions),
            "miss_pictures": self.miss_pictures,
            "least_iou": LEAST_IOU,
            "by_score": self.by_score(),
            "all": _figures(self.judged),
            "by_size": _by_size(self.judged),
            "by_light": [
                {"light": name, **_figures(of), "by_size": _by_size(of)} for name, of in by_light
            ],
        }

    def by_score(self) -> list[dict[str, float]]:
        """Return what is left of finds and inventions at least scores."""
        return [
            {
                "score": least,
                "found": sum(each.score >= least for each in self.judged),
                "looks_inventing": sum(score >= least for score in self.inventions),
            }
            for least in SCORES
        ]

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
        for low, high, of in sizes(self.judged):
            name = f"over {low:.0f}" if math.isinf(high) else f"{low:.0f} to {high:.0f}"
            rows.append(_row(name, of))
        rows += [_row(name, of) for name, of in self.by_light()]
        rows.append(_row("all", self.judged))
        looks = len(self.inventions)
        rows.append(f"invented: {self.invented} of {self.boxes} boxes, in {looks} looks")
        for each in self.by_score():
            found = 100.0 * each["found"] / max(1, len(self.judged))
            inventing = 100.0 * each["looks_inventing"] / max(1, looks)
            rows.append(
                f"score {each['score']:.1f} and more: found {found:.1f} %, invented in {inventing:.1f} % of the looks"
            )
        if self.miss_pictures is not None:
            rows.append(f"what is missed stays missed for {self.miss_pictures:.1f} pictures")
        return rows


def follows(before: str, name: str) -> bool:
    """Return whether a picture's name is that of another with the next number."""
    of_before = _NUMBERED.fullmatch(before)
    of_name = _NUMBERED.fullmatch(name)
    if of_before is None or of_name is None or of_before[1] != of_name[1]:
        return False
    return int(of_name[2]) == int(of_before[2]) + 1


def sizes(judged: Sequence[Judged]) -> list[tuple[float, float, list[Judged]]]:
    """Return the labels of each range of sizes in which there are some."""
    parts = [
        (low, high, [each for each in judged if low <= each.side_px < high])
        for low, high in pairwise(SIZES_PX)
    ]
    return [part for part in parts if part[2]]


def _around(box: Box) -> Region:
    wider = WIDER * max(box.w, box.h)
    x1 = box.x + box.w + wider
    y1 = box.y + box.h + wider
    return Region(box.x - wider, box.y - wider, x1, y1, side_px=max(box.w, box.h))


def _is_there(
    box: Box,
    known: Sequence[Box],
    ignored: Sequence[Box],
) -> bool:
    """Return whether a box is of another labelled object, or where nothing was labelled."""
    if any(iou(box, each) >= NOTHING_IOU for each in known):
        return True
    return any(common_area(box, each) >= 0.5 * box.area for each in ignored)


def _edges_off(found: Box, true: Box) -> tuple[float, float, float, float]:
    return (
        found.x - true.x,
        found.y - true.y,
        found.x + found.w - true.x - true.w,
        found.y + found.h - true.y - true.h,
    )


def _by_size(of: Sequence[Judged]) -> list[dict[str, Any]]:
    return [
        {
            "from_px": low,
            "to_px": None if math.isinf(high) else high,
            "side_px": round(float(np.median([each.side_px for each in within])), 1),
            **_figures(within),
        }
        for low, high, within in sizes(of)
    ]


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
