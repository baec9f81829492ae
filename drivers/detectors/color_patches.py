"""Connected patches of a coarse mask: found, joined, cut apart, and what their shape is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from path.arrays import Flags
from path.observations import Extent
from path.values import frozen

Image = NDArray[Any]  # uint8; OpenCV's own annotation is wider

SHALLOWEST_DENT = 0.06  # of the size of a patch: what can be a waist
SMALLEST_PIECE = 0.45  # of the size of a patch: what can be one of two vehicles
# share of a patch cut off, and a cut's length over the size of that
SMALLEST_CUT_OFF = 0.1
LONGEST_CUT = 1.3
SMALLEST_SLIVER = 0.3  # of the size of a patch: what is left by a cut and is no piece
SOLID = 0.9  # share of its convex hull that one vehicle fills, and two that touch hardly ever
# tried of each dent; share of a cut within the outline
CUTS = 12
WITHIN = 0.9
CROSS = np.ones((3, 3), np.uint8)


@frozen
class Patch:
    """A connected patch in the coarse mask: its corner there, and its own pixels (0 or 255) from
    that corner on.
    """

    x: int
    y: int
    mask: Image

    @property
    def w(self) -> int:
        return self.mask.shape[1]

    @property
    def h(self) -> int:
        return self.mask.shape[0]

    @property
    def size(self) -> float:
        """Side of the square of equal area, in coarse pixels."""
        return math.sqrt(cv2.countNonZero(self.mask))


@frozen
class Shape:
    """Share of its convex hull that a vehicle fills, length over width."""

    solidity: float
    aspect: float


def _labels(mask: Image) -> tuple[int, Image, Image, Image]:
    """Connected components with their statistics; with 16-bit labels in two thirds of the usual
    time.
    """
    return cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_16U, cv2.CCL_SPAGHETTI)


def in_pixels_of(step: int, extent: Extent) -> Extent:
    """An extent in coarse pixels."""
    return Extent(extent.usual_px / step, extent.most_px / step, extent.longest_px / step)


def components(mask: Image) -> list[Patch]:
    count, labels, stats, _ = _labels(mask)
    patches: list[Patch] = []
    for i in range(1, count):
        x, y, w, h, area = (int(n) for n in stats[i])
        if area > 1:
            own = labels[y : y + h, x : x + w] == i
            patches.append(Patch(x, y, own.astype(np.uint8) * np.uint8(255)))
    return patches


def join(
    patches: list[Patch],
    gap: float,
    longest: float = math.inf,
) -> list[Patch]:
    """Join patches whose pixels are closer than ``gap`` times the size of the larger one.

    Those that are longer together than one object can be, in coarse pixels, are several.
    """
    patches = sorted(patches, key=lambda p: -p.size)
    joined: list[Patch] = []
    while patches:
        whole = patches.pop(0)
        rest: list[Patch] = []
        for other in patches:
            if _longest_side(whole, other) <= longest and _distance(whole, other) <= max(
                1.5, gap * whole.size
            ):
                whole = _union(whole, other)
            else:
                rest.append(other)
        patches = rest
        joined.append(whole)
    return joined


def with_dark(
    patch: Patch,
    dark: Image,
    colored: Image,
    reach: float,
) -> Patch:
    """The patch with the dark parts that touch it; a dark thing that goes on beyond ``reach`` is
    not part of it.

    What is nearer to another coloured patch is that one's.
    """
    grow = max(3, math.ceil(reach * patch.size))
    x0 = max(patch.x - grow, 0)
    y0 = max(patch.y - grow, 0)
    around = dark[y0 : patch.y + patch.h + grow, x0 : patch.x + patch.w + grow]
    height, width = around.shape
    own = np.zeros((height, width), np.uint8)
    own[patch.y - y0 : patch.y - y0 + patch.h, patch.x - x0 : patch.x - x0 + patch.w] = patch.mask
    others = cv2.subtract(colored[y0 : y0 + height, x0 : x0 + width], own)
    if cv2.countNonZero(others) > 0:
        to_own, to_others = (
            cv2.distanceTransform(cv2.bitwise_not(m), cv2.DIST_L2, cv2.DIST_MASK_3)
            for m in (own, others)
        )
        around = np.where(to_own < to_others, around, np.uint8(0))
    count, labels, stats, _ = _labels(around)
    near = cv2.dilate(own, CROSS)
    for i in np.unique(labels[(near > 0) & (around > 0)]) if count > 1 else ():
        x, y, w, h, _ = stats[i].tolist()
        ends = (x > 0 or x0 == 0) and (y > 0 or y0 == 0)
        ends = ends and (x + w < width or x0 + width == dark.shape[1])
        if ends and (y + h < height or y0 + height == dark.shape[0]):
            own[labels == i] = 255
    return Patch(x0, y0, own)


def _distance(a: Patch, b: Patch) -> float:
    """Least distance between the pixels of two patches, in coarse pixels; boxes far apart are not
    looked into.
    """
    gap_x = max(a.x - (b.x + b.w), b.x - (a.x + a.w), 0)
    gap_y = max(a.y - (b.y + b.h), b.y - (a.y + a.h), 0)
    if gap_x + gap_y > 16:
        return math.hypot(gap_x, gap_y)
    pa = np.argwhere(a.mask)
    pb = np.argwhere(b.mask) + np.array([b.y - a.y, b.x - a.x])
    if len(pa) * len(pb) > 100_000:
        pa = pa[:: 1 + len(pa) // 300]
        pb = pb[:: 1 + len(pb) // 300]
    return float(np.sqrt(((pa[:, None] - pb[None]) ** 2).sum(axis=2).min())) - 1.0


def _longest_side(a: Patch, b: Patch) -> int:
    """The longer side of the box around two patches."""
    w = max(a.x + a.w, b.x + b.w) - min(a.x, b.x)
    return max(w, max(a.y + a.h, b.y + b.h) - min(a.y, b.y))


def _union(a: Patch, b: Patch) -> Patch:
    x0 = min(a.x, b.x)
    y0 = min(a.y, b.y)
    x1 = max(a.x + a.w, b.x + b.w)
    y1 = max(a.y + a.h, b.y + b.h)
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    for p in (a, b):
        mask[p.y - y0 : p.y - y0 + p.h, p.x - x0 : p.x - x0 + p.w] |= p.mask
    return Patch(x0, y0, mask)


def _outlines(mask: Image) -> list[Image]:
    return list(cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0])


def shape_of(mask: Image) -> Shape:
    """Holes count as filled."""
    outlines = _outlines(mask)
    hull = cv2.convexHull(np.concatenate(outlines) if len(outlines) > 1 else outlines[0])
    filled = np.zeros(mask.shape, np.uint8)
    whole = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(filled, outlines, -1, (1,), cv2.FILLED)
    cv2.fillConvexPoly(whole, hull, (1,))
    a, b = cv2.minAreaRect(hull)[1]
    return Shape(
        cv2.countNonZero(filled) / cv2.countNonZero(whole), (max(a, b) + 1.0) / (min(a, b) + 1.0)
    )


def split(patch: Patch) -> list[Patch]:
    """Cut a patch at its waist, between the two deepest dents of its outline; the patch itself when
    it has none.
    """
    outline = _longest_outline(patch.mask)
    dents = _dents(outline, SHALLOWEST_DENT * patch.size)
    if len(dents) < 2:
        return [patch]
    ends = outline[dents[0]].tolist(), outline[dents[1]].tolist()
    pieces = components(cv2.line(patch.mask.copy(), *ends, (0,), 1, cv2.LINE_4))
    pieces = [p for p in pieces if p.size > SMALLEST_PIECE * patch.size]
    return (
        [Patch(p.x + patch.x, p.y + patch.y, p.mask) for p in pieces]
        if len(pieces) == 2
        else [patch]
    )


def divide(patch: Patch, extent: Extent) -> list[Patch]:
    """Cut a patch that is larger than one object can be, in coarse pixels, into those that touch in
    it.

    Where two touch there may be one dent alone, between their heads, and a straight outline at
    their feet. So a cut may begin at any dent and end anywhere; of all it is the one that is
    shortest for what it cuts off. What has no such cut stays whole: it is too large, but it is one.
    So does what fills its convex hull and is too large in both directions: those that touch are so
    in one, and this is nearer.
    """
    if (
        max(patch.w, patch.h) <= extent.longest_px
        and math.sqrt(patch.w * patch.h) <= extent.most_px
    ):
        return [patch]
    if min(patch.w, patch.h) > extent.most_px and shape_of(patch.mask).solidity >= SOLID:
        return [patch]
    outline = _longest_outline(patch.mask)
    filled = np.zeros(patch.mask.shape, np.uint8)
    cv2.drawContours(filled, [outline], -1, (255,), cv2.FILLED)
    ends = _shortest_cut(outline, filled, _dents(outline, SHALLOWEST_DENT * patch.size))
    if ends is None:
        return [patch]
    count, sides = cv2.connectedComponents(
        cv2.line(filled, *ends, (0,), 1, cv2.LINE_4), connectivity=4
    )
    pieces = [_only(patch, sides == side) for side in range(1, count)]
    pieces = [
        each for each in pieces if each is not None and each.size > SMALLEST_SLIVER * patch.size
    ]
    return (
        [each for piece in pieces for each in divide(piece, extent)] if len(pieces) > 1 else [patch]
    )


def _only(patch: Patch, where: Flags) -> Patch | None:
    """The pixels of a patch that are somewhere; None when there are none."""
    mask = np.where(where, patch.mask, np.uint8(0))
    x, y, w, h = cv2.boundingRect(mask)
    return Patch(patch.x + x, patch.y + y, mask[y : y + h, x : x + w].copy()) if w * h > 0 else None


def _longest_outline(mask: Image) -> Image:
    """Corners of the longest outline of a mask, (n, 2)."""
    return max(_outlines(mask), key=len).reshape(-1, 2)  # OpenCV 4 and 5 differ in the shape


def _dents(outline: Image, least: float) -> list[int]:
    """Return where an outline's dents are deepest, those at least so deep, the deepest first."""
    # OpenCV may start in the middle
    hull = np.sort(cv2.convexHull(outline, returnPoints=False), axis=0)[::-1]
    defects = cv2.convexityDefects(outline, hull) if len(hull) > 3 else None
    if defects is None:
        return []
    _, _, at, depth = defects.astype(np.int64).reshape(-1, 4).T
    return [int(at[i]) for i in np.argsort(depth)[::-1] if depth[i] / 256.0 >= least]


def _shortest_cut(
    outline: Image,
    filled: Image,
    dents: Sequence[int],
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Ends of the cut from a dent that is shortest for the smaller part's size, within the outline;
    None: none is.
    """
    points = outline.astype(np.float64)
    x, y = points.T
    swept = np.concatenate([[0.0], np.cumsum(x * np.roll(y, -1) - y * np.roll(x, -1))])
    area = 0.5 * abs(swept[-1])
    index = np.arange(len(points))
    best = LONGEST_CUT
    ends = None
    for dent in dents:
        low = np.minimum(dent, index)
        high = np.maximum(dent, index)
        part = 0.5 * np.abs(swept[high] - swept[low] + x[high] * y[low] - y[high] * x[low])
        smaller = np.minimum(part, area - part)
        length = np.hypot(x - x[dent], y - y[dent]) + 1.0
        worth = np.where(
            smaller >= SMALLEST_CUT_OFF * area,
            length / np.sqrt(np.maximum(smaller, 1.0)),
            np.inf,
        )
        for end in np.argsort(worth)[:CUTS].tolist():
            if worth[end] >= best:
                break
            a = (int(x[dent]), int(y[dent]))
            b = (int(x[end]), int(y[end]))
            line = cv2.line(np.zeros_like(filled), a, b, (255,), 1)
            if cv2.countNonZero(cv2.bitwise_and(line, filled)) >= WITHIN * cv2.countNonZero(line):
                best = float(worth[end])
                ends = (a, b)
                break
    return ends
