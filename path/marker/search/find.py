"""The markers of a layout in an image, see the package."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from path.compiled import inner, kernel
from path.marker.kernels import Array
from path.marker.layout import MarkerLayout
from path.marker.photometric.print_pixels import Gray
from path.marker.photometric.texture import cells
from path.marker.search.dark import (
    BOTTOM,
    LEFT,
    RIGHT,
    TILE,
    TOP,
    Integers,
    components,
    extremes,
    limits,
    outlines,
    runs_of,
    spread,
)
from path.marker.search.quads import at, hull_of, on_edges, quad_of
from path.marker.track_kernels import from_square

# where dark ends, from the darkest to the lightest around: in the middle; nearer to dark, where
# something lighter than the print is beside it; nearer to light, where the print is hardly light
SHARES = (0.5, 0.3, 0.7)
LEAST_CONTRAST = 20  # grey levels, within some pixels
# of a component, along the image's sides
LEAST_LONG_PX = 9
LEAST_SHORT_PX = 7
LEAST_LIKENESS = 0.55  # correlation of cells with a print: a closer look follows
SAMPLE = 0.2  # of a cell: its four samples are so far from its middle
MOST_FOUND = 512
APART = 0.5  # of a side: two of the same print nearer than that are one


def search(grey: NDArray[np.uint8], layout: MarkerLayout) -> list[tuple[int, Array]]:
    """Return id and corners (4, 2) in px of what looks like a marker of the layout, each once.

    Corners are good to about half a pixel, in the print's order.

    Args:
        grey: uint8, C-contiguous, at any size.
    """
    ids = tuple(marker.id for marker in layout.markers)
    prints = _prints(layout.dictionary, ids)
    quads = np.empty((MOST_FOUND, 4, 2))
    found = np.empty((MOST_FOUND, 2))
    count = look_through(grey, prints, math.isqrt(len(prints)), quads, found)
    return [(ids[int(found[k, 0])], quads[k].copy()) for k in range(count)]


@lru_cache(maxsize=8)
def _prints(dictionary: str, ids: tuple[int, ...]) -> Array:
    """Cells of prints turned by 0, 90, 180 and 270 degrees, each a column of mean 0 and length 1.
    Shared: do not change it.
    """
    columns: list[NDArray[np.float64]] = []
    for marker_id in ids:
        pattern = cells(dictionary, marker_id)
        pattern = pattern - pattern.mean()
        pattern /= np.linalg.norm(pattern)
        columns += [np.rot90(pattern, -turns).ravel() for turns in range(4)]
    return np.ascontiguousarray(np.stack(columns, axis=1))


@inner
def _likest(grey: Gray, quad: Array, prints: Array, n: int) -> tuple[int, float]:
    """Return the column of ``prints`` that a quadrilateral is most like, and their correlation."""
    H = np.empty((3, 3))
    from_square(quad, 0.0, 1.0 / n, H)
    shades = np.zeros(n * n)
    for i in range(n):
        for j in range(n):
            for k in range(4):
                u = j + 0.5 + (SAMPLE if k & 1 else -SAMPLE)
                v = i + 0.5 + (SAMPLE if k & 2 else -SAMPLE)
                w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
                x = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
                y = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
                shades[n * i + j] += at(grey, x, y)
    shades -= shades.mean()
    square = 1e-9
    alike = np.zeros(prints.shape[1])
    for cell in range(n * n):
        square += shades[cell] * shades[cell]
        for column in range(prints.shape[1]):
            alike[column] += shades[cell] * prints[cell, column]
    best = int(np.argmax(alike))
    return best, alike[best] / math.sqrt(square)


@inner
def _plausible(boxes: Integers, count: int) -> Integers:
    """Return where the rows of each component that may be a marker begin, -1 for others."""
    starts = np.empty(count, np.int32)
    rows = 0
    for k in range(count):
        wide = boxes[k, RIGHT] - boxes[k, LEFT] + 1
        high = boxes[k, BOTTOM] - boxes[k, TOP] + 1
        if max(wide, high) >= LEAST_LONG_PX and min(wide, high) >= LEAST_SHORT_PX:
            starts[k] = rows
            rows += high
        else:
            starts[k] = -1
    return starts


@inner
def _place_of(print_: int, quad: Array, quads: Array, found: Array, count: int) -> int:
    """Return which of those found is the same marker; ``count`` when none is."""
    x = quad[:, 0].mean()
    y = quad[:, 1].mean()
    side = math.hypot(quad[1, 0] - quad[0, 0], quad[1, 1] - quad[0, 1])
    side = max(side, math.hypot(quad[2, 0] - quad[1, 0], quad[2, 1] - quad[1, 1]))
    for k in range(count):
        away = math.hypot(quads[k, :, 0].mean() - x, quads[k, :, 1].mean() - y)
        if found[k, 0] == print_ and away < APART * side:
            return k
    return count


@kernel
def look_through(grey: Gray, prints: Array, n: int, quads: Array, found: Array) -> int:
    """Fill ``quads``, (m, 4, 2), and ``found``, (m, 2), number of the print and likeness; returns
    how many there are.

    Args:
        prints: (n n, 4 k), see ``_prints``.
    """
    height, width = grey.shape
    low = np.empty((height // TILE, width // TILE), np.uint8)
    high = np.empty_like(low)
    limit = np.empty_like(low)
    runs = np.empty((4, height * (width // 2 + 1)), np.int32)
    hull = np.empty((2 * height, 2))
    quad = np.empty((4, 2))
    fine = np.empty((4, 2))
    count = 0
    if low.size == 0:
        return count
    extremes(grey, low, high)
    spread(low, high)
    for share in SHARES:
        limits(low, high, share, LEAST_CONTRAST, limit)
        many = runs_of(grey, limit, runs)
        boxes = np.empty((many, 4), np.int32)
        starts = _plausible(boxes, components(runs, many, boxes))
        sides = outlines(runs, many, boxes, starts)
        for k in range(starts.shape[0]):
            if starts[k] < 0 or count == quads.shape[0]:
                continue
            rows = boxes[k, BOTTOM] - boxes[k, TOP] + 1
            corners = hull_of(sides, starts[k], rows, boxes[k, TOP], hull)
            if not (quad_of(hull, corners, quad) and on_edges(grey, quad, fine)):
                continue
            column, likeness = _likest(grey, fine, prints, n)
            if likeness < LEAST_LIKENESS:
                continue
            place = _place_of(column // 4, fine, quads, found, count)
            if place == count or likeness > found[place, 1]:
                found[place, 0] = column // 4
                found[place, 1] = likeness
                for c in range(4):
                    quads[place, c] = fine[(c + column) & 3]
                count = max(count, place + 1)
    return count
