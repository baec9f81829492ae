"""A pass of the fit that knows of errors of the camera, the light and the print.

    I = F * (l M),    F = 1 + sum_k f_k D_k,    l = 1 - d S((p cos a + q sin a - c) / w)

M is the image of an ideal marker (``pattern``), F a symmetric filter of 5 x 5 pixels (sharpening,
motion, what a mosaic and a codec leave) made of the second differences D_k, l the edge of a shadow,
straight in the image, soft or hard, and the inner cell edges of M may be off, because the picture
that was printed had whole pixels. The filter works on the model and not on the image, so that noise
stays noise.

The unknowns ``extra`` are, in this order: f 6, offsets of the inner edges 2 (n - 1), shadow (d, a,
c, log w) 4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.camera.kernels import place
from path.compiled import inner, kernel
from path.marker.kernels import Array, undistort
from path.marker.photometric.pattern import (
    BLOCK,
    SATURATED,
    UNKNOWNS,
    add_last,
    add_row,
    clear,
    evaluate,
)

Flags = NDArray[np.bool_]
Indices = NDArray[np.int32]
Places = NDArray[np.int64]

GROUPS = 3
FILTERED = 0
COARSE = 1
SHADOWED = 2
TAPS = 6
SHADOW = 4
# deviations expected: of taps, and in cells
FILTER_SIGMA = 0.3
EDGE_SIGMA = 0.05

_DU = np.array([1, 2, 0, 0, 1, 1])
_DV = np.array([0, 0, 1, 2, 1, -1])


@inner
def _raster(pixels: Array) -> tuple[int, int, Indices]:
    """-1 for each pixel of the box around some pixels and 2 px more, and where that box begins."""
    u0 = int(pixels[0, 4])
    v0 = int(pixels[0, 5])
    u1 = int(pixels[0, 4])
    v1 = int(pixels[0, 5])
    for k in range(pixels.shape[0]):
        u = int(pixels[k, 4])
        v = int(pixels[k, 5])
        u0 = min(u0, u)
        v0 = min(v0, v)
        u1 = max(u1, u)
        v1 = max(v1, v)
    places = np.empty((v1 - v0 + 5, u1 - u0 + 5), np.int32)
    for v in range(places.shape[0]):
        for u in range(places.shape[1]):
            places[v, u] = -1
    return u0 - 2, v0 - 2, places


@kernel
def stencil(pixels: Array, frame: Array, lens: Array) -> tuple[Array, Indices]:
    """Places at which the filter needs the model: their rays (m, 2), and for each pixel (n, 13)
    which ones.

    A pixel's own place comes first, then both ends of each difference.
    """
    count = pixels.shape[0]
    u0, v0, places = _raster(pixels)
    height, width = places.shape
    for k in range(count):
        u = int(pixels[k, 4]) - u0
        v = int(pixels[k, 5]) - v0
        for i in range(TAPS):
            for side in (-1, 1):
                if places[v + side * _DV[i], u + side * _DU[i]] == -1:
                    places[v + side * _DV[i], u + side * _DU[i]] = -2
        places[v, u] = -3 - k
    rays = np.empty((width * height, 2))
    at = np.empty((count, 2 * TAPS + 1), np.int32)
    total = 0
    for v in range(height):
        for u in range(width):
            k = places[v, u]
            if k == -1:
                continue
            if k < -2:
                rays[total, 0], rays[total, 1] = pixels[-3 - k, 0], pixels[-3 - k, 1]
            else:
                at_u = place(lens, 0, u + u0)
                at_v = place(lens, 1, v + v0)
                du = at_u - frame[0]
                dv = at_v - frame[1]
                p = frame[5] * du + frame[6] * dv
                q = frame[7] * du + frame[8] * dv
                x, y = undistort(at_u, at_v, lens, frame[2] + p / frame[4], frame[3] + q / frame[4])
                rays[total, 0], rays[total, 1] = (
                    (x - frame[2]) * frame[4],
                    (y - frame[3]) * frame[4],
                )
            places[v, u] = total
            total += 1
    for k in range(count):
        u = int(pixels[k, 4]) - u0
        v = int(pixels[k, 5]) - v0
        at[k, 0] = places[v, u]
        for i in range(TAPS):
            at[k, 1 + 2 * i] = places[v - _DV[i], u - _DU[i]]
            at[k, 2 + 2 * i] = places[v + _DV[i], u + _DU[i]]
    return rays[:total], at


@kernel
def own_places(pixels: Array) -> tuple[Array, Indices]:
    """The places of a model without a filter, as ``stencil`` gives them: the pixels' own."""
    rays = np.empty((pixels.shape[0], 2))
    at = np.empty((pixels.shape[0], 1), np.int32)
    for k in range(pixels.shape[0]):
        rays[k, 0], rays[k, 1], at[k, 0] = pixels[k, 0], pixels[k, 1], k
    return rays, at


@kernel
def model(
    rays: Array, theta: Array, extra: Array, groups: Flags, frame: Array, cells: Array, edges: Array
) -> Array:
    """The image without the filter at all places: derivatives to the 16, the offsets, the shadow;
    grey value last.
    """
    n = cells.shape[0] - 2
    offsets = 2 * (n - 1) if groups[COARSE] else 0
    shadow = SHADOW if groups[SHADOWED] else 0
    lit = UNKNOWNS + offsets
    rows = np.empty((rays.shape[0], lit + shadow + 1))
    work = np.empty((6, n + 3))
    row = np.empty(UNKNOWNS)
    edge_row = np.empty(2 * (n - 1))
    moved = edges.copy()
    for i in range(1, n):
        moved[0, i] += extra[TAPS + i - 1]
        moved[1, i] += extra[TAPS + n + i - 2]
    for k in range(rays.shape[0]):
        p = rays[k, 0]
        q = rays[k, 1]
        out = rows[k]
        if offsets:
            value = evaluate(p, q, theta, frame, cells, moved, work, row, edge_row)
            for j in range(offsets):
                out[UNKNOWNS + j] = edge_row[j]
        else:
            value = evaluate(p, q, theta, frame, cells, moved, work, row, None)
        for j in range(UNKNOWNS):
            out[j] = row[j]
        if shadow:
            light = _light(p, q, extra[-SHADOW:], value, out[lit:-1])
            for j in range(lit):
                out[j] *= light
            value *= light
        out[-1] = value
    return rows


@inner
def _light(p: float, q: float, shadow: Array, value: float, row: Array) -> float:
    """Light that a shadow leaves; fills ``row`` with the derivatives of ``value`` in that light to
    the shadow's 4.
    """
    d = shadow[0]
    a = shadow[1]
    c = shadow[2]
    w = math.exp(shadow[3])
    across = p * math.cos(a) + q * math.sin(a)
    along = q * math.cos(a) - p * math.sin(a)
    s = 1.0 / (1.0 + math.exp(-2.0 * max((across - c) / w, -20.0)))
    slope = -2.0 * d * s * (1.0 - s) / w * value
    row[0], row[1], row[2], row[3] = -s * value, slope * along, -slope, -slope * (across - c)
    return 1.0 - d * s


@kernel
def accumulate_filtered(
    pixels: Array,
    at: Indices,
    rows: Array,
    taps: Array,
    filtered: bool,
    spread: float,
    normal: Array,
    residuals: Array,
) -> None:
    """One pass over the pixels, as ``pattern.accumulate``, of the model's ``rows`` behind the
    filter.

    ``normal`` has shape (k, k + 1), its upper triangle is written; unknowns are 16, taps, then the
    rest of ``rows``.
    """
    clear(normal)
    size = normal.shape[0]
    columns = rows.shape[1] - 1
    own = TAPS if filtered else 0
    row = np.empty(size)
    mixed = np.empty(columns + 1)
    filled = 0
    block = np.zeros((2 * BLOCK, size + 1))
    total = 0.0
    for i in range(TAPS):
        total += taps[i]
    centre = 1.0 - 2.0 * total
    for k in range(pixels.shape[0]):
        middle = rows[at[k, 0]]
        for j in range(columns + 1):
            mixed[j] = centre * middle[j]
        for i in range(own):
            f = taps[i]
            one = rows[at[k, 1 + 2 * i]]
            other = rows[at[k, 2 + 2 * i]]
            row[UNKNOWNS + i] = one[columns] + other[columns] - 2.0 * middle[columns]
            if f != 0.0:
                for j in range(columns + 1):
                    mixed[j] += f * (one[j] + other[j])
        r = pixels[k, 2] - mixed[columns]
        if r < 0.0 and pixels[k, 2] >= SATURATED:
            residuals[k] = 0.0
            continue
        residuals[k] = r
        for j in range(UNKNOWNS):
            row[j] = mixed[j]
        for j in range(UNKNOWNS, columns):
            row[own + j] = mixed[j]
        filled = add_row(row, r, spread, block, filled, normal)
    add_last(block, filled, normal)


def used_unknowns(
    groups: Flags, cells: int, edge_sigma: float = EDGE_SIGMA
) -> tuple[Places, Array]:
    """Places in ``extra`` of the unknowns of some groups, in order, and the deviations expected of
    them (0: any).

    ``edge_sigma`` is that of inner edges, in cells.
    """
    offsets = 2 * (cells - 1)
    counts = (TAPS, offsets, SHADOW)
    sigmas = (FILTER_SIGMA, edge_sigma, 0.0)
    all_sigmas = np.repeat(sigmas, counts)
    used = np.flatnonzero(np.repeat(groups[: len(counts)], counts))
    return used, all_sigmas[used]
