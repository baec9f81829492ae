"""Components of an image that are darker than their surroundings.

The surroundings of a tile of 4 x 4 pixels are it and its eight neighbours. Where these hardly
differ nothing is dark, so that noise makes no components; in the middle of a large dark thing
nothing is dark either, and of its outline a ring remains. After AprilTag 2 (Wang and Olson, 2016).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from path.compiled import inner
from path.marker.photometric.print_pixels import Gray

Integers = NDArray[np.int32]

TILE = 4
# rows of an array of runs: pixels [BEGIN, END) of an image's row, and a run of the same component
ROW = 0
BEGIN = 1
END = 2
PARENT = 3
# columns of an array of boxes: ends are included
LEFT = 0
TOP = 1
RIGHT = 2
BOTTOM = 3


@inner
def extremes(grey: Gray, low: Gray, high: Gray) -> None:
    """Fill ``low`` and ``high``, (height // TILE, width // TILE), with each tile's."""
    across = low.shape[1]
    dark = np.empty(across * TILE, np.uint8)
    light = np.empty(across * TILE, np.uint8)
    for i in range(low.shape[0]):
        first = grey[TILE * i]
        second = grey[TILE * i + 1]
        third = grey[TILE * i + 2]
        last = grey[TILE * i + 3]
        for x in range(across * TILE):
            dark[x] = min(first[x], second[x], third[x], last[x])
            light[x] = max(first[x], second[x], third[x], last[x])
        for j in range(across):
            x = TILE * j
            low[i, j] = min(dark[x], dark[x + 1], dark[x + 2], dark[x + 3])
            high[i, j] = max(light[x], light[x + 1], light[x + 2], light[x + 3])


@inner
def spread(low: Gray, high: Gray) -> None:
    """Replace extremes of tiles by those of their surroundings."""
    down, across = low.shape
    dark = low.copy()
    light = high.copy()
    for i in range(down):
        above = max(i - 1, 0)
        below = min(i + 1, down - 1)
        for j in range(across):
            dark[i, j] = min(low[above, j], low[i, j], low[below, j])
            light[i, j] = max(high[above, j], high[i, j], high[below, j])
    for i in range(down):
        for j in range(across):
            left = max(j - 1, 0)
            right = min(j + 1, across - 1)
            low[i, j] = min(dark[i, left], dark[i, j], dark[i, right])
            high[i, j] = max(light[i, left], light[i, j], light[i, right])


@inner
def limits(low: Gray, high: Gray, share: float, least: int, out: Gray) -> None:
    """Fill ``out`` with the grey level below which a tile's pixels are dark: so far from the
    darkest to the lightest of its surroundings; 0 where these differ by less than ``least``.
    """
    for i in range(low.shape[0]):
        for j in range(low.shape[1]):
            dark = np.float64(low[i, j])
            light = np.float64(high[i, j])
            out[i, j] = np.uint8(dark + share * (light - dark) + 0.5)
            if light - dark < least:
                out[i, j] = 0


@inner
def _root(parents: Integers, run: int) -> int:
    while parents[run] != run:
        parents[run] = parents[parents[run]]
        run = parents[run]
    return run


@inner
def _runs_of_row(row: Gray, limit: Gray, begins: Integers, ends: Integers, count: int) -> int:
    """Append the dark runs of one row; returns how many there are now."""
    dark = False
    for j in range(limit.shape[0]):
        most = limit[j]
        if most == 0 and not dark:
            continue
        for x in range(TILE * j, TILE * (j + 1)):
            if (row[x] < most) != dark:
                dark = not dark
                if dark:
                    begins[count] = x
                else:
                    ends[count] = x
                    count += 1
    if dark:
        ends[count] = TILE * limit.shape[0]
        count += 1
    return count


@inner
def runs_of(grey: Gray, limit: Gray, runs: Integers) -> int:
    """Fill ``runs``, (4, n), row by row; returns how many there are.

    Those that touch along a side of a pixel have the same root among their parents, which come
    before them.
    """
    rows = runs[ROW]
    begins = runs[BEGIN]
    ends = runs[END]
    parents = runs[PARENT]
    above = 0
    first = 0
    for y in range(TILE * limit.shape[0]):
        count = _runs_of_row(grey[y], limit[y // TILE], begins, ends, first)
        for run in range(first, count):
            rows[run] = y
            parents[run] = run
            while above < first and rows[above] < y - 1:
                above += 1
            while above < first and ends[above] <= begins[run]:
                above += 1
            other = above
            while other < first and begins[other] < ends[run]:
                one = _root(parents, other)
                two = _root(parents, run)
                parents[max(one, two)] = min(one, two)
                other += 1
        first = count
    return first


@inner
def components(runs: Integers, count: int, boxes: Integers) -> int:
    """Fill ``boxes``, (n, 4), one each component, whose number replaces the parent of its runs;
    returns how many there are.
    """
    found = 0
    for run in range(count):
        row = runs[ROW, run]
        parent = runs[PARENT, run]
        if parent == run:
            box = boxes[found]
            box[LEFT] = runs[BEGIN, run]
            box[TOP] = row
            box[RIGHT] = runs[END, run] - 1
            box[BOTTOM] = row
            runs[PARENT, run] = found
            found += 1
        else:
            # a parent comes before: it has its component's number already
            component = runs[PARENT, parent]
            box = boxes[component]
            box[LEFT] = min(box[LEFT], runs[BEGIN, run])
            box[RIGHT] = max(box[RIGHT], runs[END, run] - 1)
            box[BOTTOM] = row
            runs[PARENT, run] = component
    return found


@inner
def outlines(runs: Integers, count: int, boxes: Integers, starts: Integers) -> Integers:
    """Return the leftmost and rightmost pixel in each row of components, (2, n).

    ``starts``: where each component's rows begin in it, -1 for those that are left out.
    """
    total = 0
    for component in range(starts.shape[0]):
        if starts[component] >= 0:
            total += boxes[component, BOTTOM] - boxes[component, TOP] + 1
    sides = np.empty((2, total), np.int32)
    sides[0] = np.iinfo(np.int32).max
    sides[1] = -1
    for run in range(count):
        component = runs[PARENT, run]
        if starts[component] >= 0:
            at = starts[component] + runs[ROW, run] - boxes[component, TOP]
            sides[0, at] = min(sides[0, at], runs[BEGIN, run])
            sides[1, at] = max(sides[1, at], runs[END, run] - 1)
    return sides
