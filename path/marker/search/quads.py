"""Quadrilaterals from outlines of components: by their convex hull, then by the image's gradient.

Corners follow each other clockwise, x to the right and y down.
"""

from __future__ import annotations

import math

import numpy as np

from path.compiled import inner
from path.marker.kernels import Array
from path.marker.photometric.print_pixels import Gray
from path.marker.search.dark import Integers

LEAST_FILLED = 0.8  # of a hull, that its largest quadrilateral covers
LEAST_AREA_PX2 = 15.0
LEAST_SIDE_PX = 4.0
CORNER_PX = 0.7  # from the middle of a hull's corner pixel to the corner
# how far from a hull's side the edge is looked for, and the shortest mean side for which so far
REACH_PX = ((30.0, 2.0), (15.0, 1.5), (0.0, 1.0))
STEP_PX = 0.5
ENDS = 0.08  # of a side, where the other sides blur it
# points of a side: one each so many px
POINT_PX = 2.0
LEAST_POINTS = 5
MOST_POINTS = 24
LEAST_GRADIENT2 = 16.0  # sum of squared steps from dark to light, each over a pixel
LEAST_SEEN = 0.6  # of a side's points
LEAST_SINE = 0.1  # between two sides


@inner
def _turn(hull: Array, count: int, x: float, y: float) -> float:
    """Return how far a hull turns clockwise at its newest point towards another one."""
    ax = hull[count - 1, 0] - hull[count - 2, 0]
    ay = hull[count - 1, 1] - hull[count - 2, 1]
    return ax * (y - hull[count - 2, 1]) - ay * (x - hull[count - 2, 0])


@inner
def hull_of(sides: Integers, start: int, rows: int, top: int, hull: Array) -> int:
    """Fill ``hull``, (2 rows, 2), clockwise from the top along the right side; returns how many
    points it has.
    """
    count = 0
    for i in range(rows):
        x = sides[1, start + i]
        while count >= 2 and _turn(hull, count, x, top + i) <= 0.0:
            count -= 1
        hull[count, 0] = x
        hull[count, 1] = top + i
        count += 1
    for i in range(rows - 1, -1, -1):
        x = sides[0, start + i]
        while count >= 2 and _turn(hull, count, x, top + i) <= 0.0:
            count -= 1
        hull[count, 0] = x
        hull[count, 1] = top + i
        count += 1
    return count


@inner
def _area(points: Array, count: int) -> float:
    twice = 0.0
    for i in range(count):
        j = (i + 1) % count
        twice += points[i, 0] * points[j, 1] - points[j, 0] * points[i, 1]
    return 0.5 * twice


@inner
def _farthest(hull: Array, count: int, x: float, y: float) -> int:
    best = 0
    most = -1.0
    for i in range(count):
        away = (hull[i, 0] - x) ** 2 + (hull[i, 1] - y) ** 2
        if away > most:
            most = away
            best = i
    return best


@inner
def _beside(hull: Array, count: int, a: int, b: int) -> tuple[int, int]:
    """Return the points farthest to the left and to the right of the line between two."""
    dx = hull[b, 0] - hull[a, 0]
    dy = hull[b, 1] - hull[a, 1]
    left = a
    right = a
    least = 0.0
    most = 0.0
    for i in range(count):
        off = dx * (hull[i, 1] - hull[a, 1]) - dy * (hull[i, 0] - hull[a, 0])
        if off < least:
            least = off
            left = i
        if off > most:
            most = off
            right = i
    return left, right


@inner
def quad_of(hull: Array, count: int, quad: Array) -> bool:
    """Fill ``quad``, (4, 2), with the corners of a hull; False when it is no quadrilateral."""
    area = _area(hull, count)
    if area < LEAST_AREA_PX2:
        return False
    a = _farthest(hull, count, hull[:count, 0].mean(), hull[:count, 1].mean())
    c = _farthest(hull, count, hull[a, 0], hull[a, 1])
    b = a
    d = c
    for _ in range(2):
        b, d = _beside(hull, count, a, c)
        # the farthest two may lie on sides: those beside the other diagonal are corners
        c, a = _beside(hull, count, b, d)
    quad[0] = hull[a]
    quad[1] = hull[b]
    quad[2] = hull[c]
    quad[3] = hull[d]
    return _area(quad, 4) >= LEAST_FILLED * area


@inner
def at(grey: Gray, x: float, y: float) -> float:
    """Return the light between pixels; beyond the image that of its edge."""
    x = min(max(x, 0.0), grey.shape[1] - 1.001)
    y = min(max(y, 0.0), grey.shape[0] - 1.001)
    i = int(x)
    j = int(y)
    a = x - i
    b = y - j
    above = (1.0 - a) * grey[j, i] + a * grey[j, i + 1]
    below = (1.0 - a) * grey[j + 1, i] + a * grey[j + 1, i + 1]
    return (1.0 - b) * above + b * below


@inner
def _edge(grey: Gray, x: float, y: float, nx: float, ny: float, reach: float) -> float:
    """Return how far outwards of a point dark turns into light; NaN where it does not."""
    steps = int(2.0 * reach / STEP_PX) + 1
    weight = 0.0
    total = 0.0
    before = at(grey, x - (reach + STEP_PX) * nx, y - (reach + STEP_PX) * ny)
    here = at(grey, x - reach * nx, y - reach * ny)
    for k in range(steps):
        off = k * STEP_PX - reach
        after = at(grey, x + (off + STEP_PX) * nx, y + (off + STEP_PX) * ny)
        lighter = max(after - before, 0.0)
        weight += lighter * lighter
        total += lighter * lighter * off
        before = here
        here = after
    return total / weight if weight > LEAST_GRADIENT2 else math.nan


@inner
def _side(grey: Gray, quad: Array, k: int, reach: float, line: Array) -> bool:
    """Fill ``line`` with a point and the direction of a quadrilateral's side; False when there is
    no edge.
    """
    ax = quad[k, 0]
    ay = quad[k, 1]
    dx = quad[(k + 1) & 3, 0] - ax
    dy = quad[(k + 1) & 3, 1] - ay
    length = math.hypot(dx, dy)
    if length < LEAST_SIDE_PX:
        return False
    points = int(min(max(length / POINT_PX, LEAST_POINTS), MOST_POINTS))
    nx = dy / length
    ny = -dx / length
    seen = 0
    mx = my = xx = xy = yy = 0.0
    for i in range(points):
        along = ENDS + (1.0 - 2.0 * ENDS) * (i + 0.5) / points
        x = ax + along * dx
        y = ay + along * dy
        off = _edge(grey, x, y, nx, ny, reach)
        if not math.isnan(off):
            # from the side's beginning, so that squares stay small
            x += off * nx - ax
            y += off * ny - ay
            seen += 1
            mx += x
            my += y
            xx += x * x
            xy += x * y
            yy += y * y
    if seen < max(3.0, LEAST_SEEN * points):
        return False
    mx /= seen
    my /= seen
    longer = (xx - yy) / seen - mx * mx + my * my
    turned = 0.5 * math.atan2(2.0 * (xy / seen - mx * my), longer)
    line[0] = ax + mx
    line[1] = ay + my
    line[2] = math.cos(turned)
    line[3] = math.sin(turned)
    return True


@inner
def on_edges(grey: Gray, quad: Array, fine: Array) -> bool:
    """Fill ``fine``, (4, 2), with corners where the edges near a hull's sides meet; False when one
    is missing, or a corner is elsewhere or beyond the image.
    """
    x = quad[:, 0].mean()
    y = quad[:, 1].mean()
    around = 0.0
    for k in range(4):
        away = math.hypot(quad[k, 0] - x, quad[k, 1] - y)
        quad[k, 0] += CORNER_PX / away * (quad[k, 0] - x)
        quad[k, 1] += CORNER_PX / away * (quad[k, 1] - y)
    for k in range(4):
        j = (k + 1) & 3
        around += math.hypot(quad[j, 0] - quad[k, 0], quad[j, 1] - quad[k, 1])
    reach = 0.0
    for shortest, far in REACH_PX:
        if 0.25 * around >= shortest:
            reach = max(reach, far)
    lines = np.empty((4, 4))
    for k in range(4):
        if not _side(grey, quad, k, reach, lines[k]):
            return False
    for k in range(4):
        one = lines[(k + 3) & 3]
        other = lines[k]
        sine = one[2] * other[3] - one[3] * other[2]
        if abs(sine) < LEAST_SINE:
            return False
        far = ((other[0] - one[0]) * other[3] - (other[1] - one[1]) * other[2]) / sine
        fine[k, 0] = one[0] + far * one[2]
        fine[k, 1] = one[1] + far * one[3]
        if math.hypot(fine[k, 0] - quad[k, 0], fine[k, 1] - quad[k, 1]) > 2.0 * reach + 1.0:
            return False
        if not (1.0 <= fine[k, 0] < grey.shape[1] - 2 and 1.0 <= fine[k, 1] < grey.shape[0] - 2):
            return False
    return True
