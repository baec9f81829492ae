"""Compiled parts of ``path.marker.track``: where corners are expected, and what a look at the place
says.

Coordinates in the print's plane are those of its samples, ``SAMPLES`` a cell, ``MARGIN`` cells
before the print.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.camera.kernels import project
from path.compiled import inner, kernel
from path.marker.kernels import Array

SAMPLES = 4  # a cell
MARGIN = 2  # cells around the print that are looked at
# samples by which a marker may be elsewhere: the border takes half a cell
RANGE = SAMPLES * MARGIN - SAMPLES // 2


@kernel
def seen_at(
    lens: Array, R: Array, t: Array, corners_v: Array, n: int
) -> tuple[float, Array, Array]:
    """The view of a marker of n cells from a pose: cosine of its incidence, pixels (4, 2) of its
    corners (4, 3), and the homography (3, 3) from its plane as it is sampled to pixels. The cosine
    is -1 when the marker is not in front.
    """
    points = np.empty((4, 3))
    pixels = np.empty((4, 2))
    H = np.empty((3, 3))
    for k in range(4):
        for i in range(3):
            points[k, i] = (
                R[i, 0] * corners_v[k, 0]
                + R[i, 1] * corners_v[k, 1]
                + R[i, 2] * corners_v[k, 2]
                + t[i]
            )
        x = points[k, 0]
        y = points[k, 1]
        z = points[k, 2]
        if not (z > 0.0 and x * x + y * y <= (lens[11] * z) * (lens[11] * z)):
            return -1.0, pixels, H
        pixels[k, 0], pixels[k, 1] = project(lens, x, y, z)
    from_square(pixels, SAMPLES * MARGIN - 0.5, 1.0 / (SAMPLES * n), H)
    # corners follow each other clockwise from the top left: along the top times up looks at the
    # viewer
    ax = points[1, 0] - points[0, 0]
    ay = points[1, 1] - points[0, 1]
    az = points[1, 2] - points[0, 2]
    bx = points[0, 0] - points[3, 0]
    by = points[0, 1] - points[3, 1]
    bz = points[0, 2] - points[3, 2]
    nx = ay * bz - az * by
    ny = az * bx - ax * bz
    nz = ax * by - ay * bx
    x = points[0, 0]
    y = points[0, 1]
    z = points[0, 2]
    size = math.sqrt((nx * nx + ny * ny + nz * nz) * (x * x + y * y + z * z))
    return -(nx * x + ny * y + nz * z) / size, pixels, H


@inner
def from_square(quad: Array, low: float, per_side: float, H: Array) -> None:
    """Homography from a square, whose sides begin at ``low`` and are 1/``per_side`` long, to a
    quadrilateral.
    """
    x0 = quad[0, 0]
    y0 = quad[0, 1]
    x1 = quad[1, 0]
    y1 = quad[1, 1]
    x2 = quad[2, 0]
    y2 = quad[2, 1]
    x3 = quad[3, 0]
    y3 = quad[3, 1]
    ax = x1 - x2
    ay = y1 - y2
    bx = x3 - x2
    by = y3 - y2
    sx = x0 - x1 + x2 - x3
    sy = y0 - y1 + y2 - y3
    det = ax * by - bx * ay
    g = (sx * by - sy * bx) / det * per_side
    h = (ax * sy - ay * sx) / det * per_side
    H[0, 0], H[0, 1] = (x1 - x0) * per_side + g * x1, (x3 - x0) * per_side + h * x3
    H[1, 0], H[1, 1] = (y1 - y0) * per_side + g * y1, (y3 - y0) * per_side + h * y3
    H[2, 0], H[2, 1] = g, h
    for i in range(3):
        last = x0 if i == 0 else y0 if i == 1 else 1.0
        H[i, 2] = last - low * (H[i, 0] + H[i, 1])


@kernel
def read(
    likeness: NDArray[np.float32],
    patch: NDArray[np.uint8],
    pattern: Array,
    H: Array,
    least: float,
    quad: Array,
) -> float:
    """Return the light around a print that is in a patch, cell by cell as it should be; NaN when
    it is not.

    Its corners (4, 2) in px go into ``quad``. The light is 0 as of its black, 1 as of its white
    cells.

    Args:
        likeness: (2 RANGE + 1, 2 RANGE + 1), correlation of the patch with the print at each place.
        pattern: cells, 0 black and 1 white.
        H: (3, 3), from the patch to pixels.
        least: correlation below which it is not there.
    """
    x = 0
    y = 0
    for i in range(likeness.shape[0]):
        for j in range(likeness.shape[1]):
            if likeness[i, j] > likeness[y, x]:
                x = j
                y = i
    if not (likeness[y, x] >= least and 0 < x < 2 * RANGE and 0 < y < 2 * RANGE):
        return math.nan
    border = _border_of_print(patch, x + SAMPLES // 2, y + SAMPLES // 2, pattern)
    if math.isnan(border):
        return math.nan
    n = pattern.shape[0]
    low = SAMPLES * MARGIN - 0.5
    middle = likeness[y, x]
    at_x = low + x - RANGE + _peak(likeness[y, x - 1], middle, likeness[y, x + 1])
    at_y = low + y - RANGE + _peak(likeness[y - 1, x], middle, likeness[y + 1, x])
    for k in range(4):
        u = at_x + (SAMPLES * n if k in (1, 2) else 0)
        v = at_y + (SAMPLES * n if k > 1 else 0)
        w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
        quad[k, 0] = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
        quad[k, 1] = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
    return border


@inner
def _peak(before: float, at: float, after: float) -> float:
    """Return where a parabola through three neighbours is highest, from the middle one."""
    bend = 2.0 * at - before - after
    return 0.5 * (after - before) / bend if bend > 0.0 else 0.0


@inner
def _shade(patch: NDArray[np.uint8], x: int, y: int, column: int, row: int) -> float:
    """Return the light on the middle of a cell of a print that begins at a sample: its edges are
    blurred.
    """
    total = 0.0
    for b in range(1, SAMPLES - 1):
        for a in range(1, SAMPLES - 1):
            total += patch[y + SAMPLES * row + b, x + SAMPLES * column + a]
    return total


@inner
def _border_of_print(patch: NDArray[np.uint8], x: int, y: int, pattern: Array) -> float:
    """Return the light around a print that begins at a sample; NaN when a cell is not on its side
    of the middle.
    """
    n = pattern.shape[0]
    shades = np.empty((n, n))
    white = black = 0.0
    whites = 0
    for i in range(n):
        for j in range(n):
            total = _shade(patch, x, y, j, i)
            shades[i, j] = total
            if pattern[i, j] > 0.5:
                white += total
                whites += 1
            else:
                black += total
    white = white / whites
    black = black / (n * n - whites)
    middle = 0.5 * (white + black)
    for i in range(n):
        for j in range(n):
            if (shades[i, j] > middle) != (pattern[i, j] > 0.5):
                return math.nan
    around = 0.0
    for i in range(n):
        around += _shade(patch, x, y, i, -1) + _shade(patch, x, y, i, n)
        around += _shade(patch, x, y, -1, i) + _shade(patch, x, y, n, i)
    return (around / (4 * n) - black) / (white - black)
