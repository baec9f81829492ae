"""The likely place of a shadow on a marker, before the fit knows of it."""

from __future__ import annotations

import math

import numpy as np

from path.compiled import kernel
from path.marker.kernels import Array, cholesky, cholesky_solve
from path.marker.photometric.pattern import TONE, UNKNOWNS, evaluate

EVERY = 5  # pixel is enough for the light on the cells
# directions over half a circle: either side may be the dark one
DIRECTIONS = 12
OFFSETS = 9
# and width of the ramp, in the fit's coordinates: a marker is about 1.4
MOST_OFFSET = 0.8
WIDTHS = (0.05, 0.2, 0.5)
# of the light
MIN_DEPTH = 0.12
MAX_DEPTH = 0.9
MIN_GAIN = 0.35  # share of the unevenness that a shadow has to explain, beyond a slope of the light


@kernel
def cell_light(pixels: Array, theta: Array, frame: Array, cells: Array, edges: Array) -> Array:
    """Light on each cell relative to an even one, shape (k, 4): its place (p, q), light, weight."""
    n = cells.shape[0] - 2
    even = theta.copy()
    even[9] = even[10] = even[12] = even[13] = even[TONE] = 0.0
    sums = np.zeros(((n + 2) * (n + 2), 5))
    work = np.empty((6, n + 3))
    row = np.empty(UNKNOWNS)
    for k in range(0, pixels.shape[0], EVERY):
        p = pixels[k, 0]
        q = pixels[k, 1]
        grey = evaluate(p, q, even, frame, cells, edges, work, row, None)
        half = 0.5 * n
        column = int(half * (row[9] + 1.0) + 1.0)
        line = int(half * (row[10] + 1.0) + 1.0)
        own = sums[min(max(line, 0), n + 1) * (n + 2) + min(max(column, 0), n + 1)]
        own[0] += grey * grey * p
        own[1] += grey * grey * q
        own[2] += grey * pixels[k, 2]
        own[3] += grey * grey
        own[4] += 1.0
    out = np.empty((sums.shape[0], 4))
    count = 0
    for k in range(sums.shape[0]):
        if sums[k, 4] > 0.0:
            weight = sums[k, 3]
            out[count, 0], out[count, 1], out[count, 2] = (
                sums[k, 0] / weight,
                sums[k, 1] / weight,
                sums[k, 2] / weight,
            )
            out[count, 3] = weight
            count += 1
    return out[:count]


@kernel
def find_shadow(light: Array, shadow: Array) -> float:
    """The straight edge of a shadow that explains uneven light of cells best, by trial, beside a
    slope of the light.

    Fills ``shadow`` with its depth, direction, offset and the logarithm of its width, see
    ``misfit``.

    Returns:
        Light beside the shadow, at the marker's centre; 0 when there is no shadow to speak of.
    """
    slopes = np.zeros((3, 3))
    right = np.zeros(3)
    squares = 0.0
    for k in range(light.shape[0]):
        row = (1.0, light[k, 0], light[k, 1])
        w = light[k, 3]
        squares += w * light[k, 2] ** 2
        for i in range(3):
            right[i] += w * row[i] * light[k, 2]
            for j in range(3):
                slopes[i, j] += w * row[i] * row[j]
    if not cholesky(slopes):
        return 0.0
    even = right.copy()
    cholesky_solve(slopes, even)
    plain = squares - even[0] * right[0] - even[1] * right[1] - even[2] * right[2]
    best = 0.0
    beside = 0.0
    most = MIN_GAIN * plain
    across = np.empty(light.shape[0])
    mixed = np.empty(3)
    for i in range(DIRECTIONS):
        a = i * math.pi / DIRECTIONS
        for k in range(light.shape[0]):
            across[k] = light[k, 0] * math.cos(a) + light[k, 1] * math.sin(a)
        for j in range(OFFSETS):
            c = MOST_OFFSET * (2.0 * j / (OFFSETS - 1) - 1.0)
            for width in WIDTHS:
                s0 = s1 = s2 = ss = sl = 0.0
                for k in range(light.shape[0]):
                    z = (across[k] - c) / width
                    s = 0.5 + 0.5 * z / math.sqrt(1.0 + z * z)
                    w = light[k, 3] * s
                    s0 = s0 + w
                    s1 = s1 + w * light[k, 0]
                    s2 = s2 + w * light[k, 1]
                    ss = ss + w * s
                    sl = sl + w * light[k, 2]
                mixed[0], mixed[1], mixed[2] = s0, s1, s2
                cholesky_solve(slopes, mixed)
                free = ss - mixed[0] * s0 - mixed[1] * s1 - mixed[2] * s2
                step = (sl - mixed[0] * right[0] - mixed[1] * right[1] - mixed[2] * right[2]) / max(
                    free, 1e-9 * ss
                )
                level = even[0] - step * mixed[0]
                lit = max(level, level + step)
                if (
                    step * step * free > max(best, most)
                    and MIN_DEPTH * lit < abs(step) < MAX_DEPTH * lit
                ):
                    best = step * step * free
                    beside = lit
                    shadow[0], shadow[3] = abs(step) / lit, math.log(width)
                    shadow[1], shadow[2] = (a, c) if step < 0.0 else (a + math.pi, -c)
    return beside
