"""The image of a printed marker: grey value and derivatives at one pixel, and the normal equations
over all.

    I = (b0 + b1 x + b2 y) + (a0 + a1 x + a2 y) (T + kappa T (1 - T)),    (x, y) = homography(undistorted ray)

where T is the printed pattern blurred by an isotropic Gaussian *of the image*. Seen from the print
that blur has deviations s_x, s_y and a correlation rho that change with the view; per axis a cell
edge becomes a normal distribution function, and the correlation enters at the vertices of cells as
Mehler's expansion of the bivariate normal (to second order). kappa stands for a camera that is not
linear in light. The 16 unknowns ``theta`` are, in this order: homography 8 (its last element is 1),
b 3, a 3, blur in px, kappa.

Print coordinates count cells, x right and y *down* from the top-left corner of the black frame;
light is linear in coordinates that run from -1 to 1 over it.
"""

from __future__ import annotations

import math

import numpy as np

from path.compiled import inner, kernel
from path.marker.kernels import Array

UNKNOWNS = 16
# places of blur and kappa in theta
BLUR = 14
TONE = 15
SATURATED = 254.0  # grey level
BLOCK = 4  # rows added at once
REACH = 4.0  # standard deviations after which an edge is not blurred any more

_GRID = np.arange(-6.0, 6.0 + 1e-9, 1.0 / 64.0)
_PDF = np.exp(-0.5 * _GRID**2) / math.sqrt(2.0 * math.pi)
_CDF = np.array([0.5 * math.erfc(-z / math.sqrt(2.0)) for z in _GRID])


@inner
def _edges(
    x: float, s: float, edges: Array, z: Array, pdf: Array, weight: Array
) -> tuple[int, int]:
    """Blurred cell edges along one axis at position ``x``.

    Fills, for the active edges ``i = first..last``, ``z[i]`` = (x - edges[i])/s and ``pdf[i]``, and
    for the cells ``first - 1..last`` their share ``weight[cell + 1]`` of the blur. Edges run 0..n,
    cells -1 (quiet) .. n (quiet). Phi and phi come from a table with a third-order Taylor step
    (error below 1e-9).
    """
    first = 0
    last = edges.shape[0] - 1
    while first <= last and edges[first] < x - REACH * s:
        first += 1
    while last >= first and edges[last] > x + REACH * s:
        last -= 1
    before = 1.0
    for i in range(first, last + 1):
        zi = (x - edges[i]) / s
        k = round((zi + 6.0) * 64.0)
        node = k / 64.0 - 6.0
        d = zi - node
        p = _PDF[k]
        h = node * node - 1.0
        cdf = _CDF[k] + p * d * (1.0 + d * (-0.5 * node + d * h / 6.0))
        z[i] = zi
        pdf[i] = p * (1.0 + d * (-node + d * (0.5 * h - d * node * (node * node - 3.0) / 6.0)))
        weight[i] = before - cdf
        before = cdf
    weight[last + 1] = before
    return first, last


@inner
def evaluate(  # noqa: PLR0915 - one formula, written out
    p: float,
    q: float,
    theta: Array,
    frame: Array,
    cells: Array,
    edges: Array,
    work: Array,
    row: Array,
    edge_row: Array | None,
) -> float:
    """Model grey value at one pixel; fills ``row`` with its derivatives to the 16 unknowns.

    ``p, q`` is the ray in the fit's own coordinates, see ``print_pixels.frame_of`` for ``frame``.
    ``cells`` is the pattern with its quiet border, ``edges`` where its cells end along x and y,
    shape (2, cells + 1), ``work`` scratch of shape (6, cells + 3). ``edge_row`` takes the
    derivatives to the inner edges, those along x first.
    """
    n = cells.shape[0] - 2
    inv_w = 1.0 / (1.0 + theta[6] * p + theta[7] * q)
    x = min(max((theta[0] * p + theta[1] * q + theta[2]) * inv_w, -1.0), n + 1.0)
    y = min(max((theta[3] * p + theta[4] * q + theta[5]) * inv_w, -1.0), n + 1.0)
    xp = (theta[0] - x * theta[6]) * inv_w
    xq = (theta[1] - x * theta[7]) * inv_w
    yp = (theta[3] - y * theta[6]) * inv_w
    yq = (theta[4] - y * theta[7]) * inv_w
    xu = xp * frame[5] + xq * frame[7]
    xv = xp * frame[6] + xq * frame[8]
    yu = yp * frame[5] + yq * frame[7]
    yv = yp * frame[6] + yq * frame[8]
    nx = math.sqrt(xu * xu + xv * xv)
    ny = math.sqrt(yu * yu + yv * yv)
    rho = (xu * yu + xv * yv) / (nx * ny)
    sx = theta[BLUR] * nx
    sy = theta[BLUR] * ny
    zx = work[0]
    fx = work[1]
    wx = work[2]
    zy = work[3]
    fy = work[4]
    wy = work[5]
    x0, x1 = _edges(x, sx, edges[0], zx, fx, wx)
    y0, y1 = _edges(y, sy, edges[1], zy, fy, wy)

    t = t_x = t_y = curve_x = curve_y = s00 = s10 = s01 = s11 = 0.0
    left = left_1 = left_z = 0.0
    if edge_row is not None:
        for k in range(edge_row.shape[0]):
            edge_row[k] = 0.0
    for column in range(x0, x1 + 2):  # cells[:, column] lies left of edge ``column``
        value = d1 = dz = 0.0
        for i in range(y0, y1 + 2):
            value += wy[i] * cells[i, column]
        for i in range(y0, y1 + 1):
            step = fy[i] * (cells[i + 1, column] - cells[i, column])
            d1 += step
            dz += zy[i] * step
            if edge_row is not None and 0 < i < n:
                edge_row[n - 2 + i] -= wx[column] * step / sy
        t += wx[column] * value
        t_y += wx[column] * d1
        curve_y -= wx[column] * dz
        if column > x0:
            f = fx[column - 1]
            fz = fx[column - 1] * zx[column - 1]
            t_x += f * (value - left)
            curve_x -= fz * (value - left)
            s00 += f * (d1 - left_1)
            s10 += fz * (d1 - left_1)
            if edge_row is not None and 1 < column <= n:
                edge_row[column - 2] -= f * (value - left) / sx
            s01 += f * (dz - left_z)
            s11 += fz * (dz - left_z)
        left = value
        left_1 = d1
        left_z = dz
    t += rho * (s00 + 0.5 * rho * s11)
    t_x = (t_x - rho * s10) / sx
    t_y = (t_y - rho * s01) / sy
    t_blur = (curve_x + curve_y + 2.0 * rho * s00) / theta[BLUR]

    half = 0.5 * n
    ex = x / half - 1.0
    ey = y / half - 1.0
    black = theta[8] + theta[9] * ex + theta[10] * ey
    contrast = theta[11] + theta[12] * ex + theta[13] * ey
    tone = t + theta[TONE] * t * (1.0 - t)
    slope = contrast * (1.0 + theta[TONE] * (1.0 - 2.0 * t))
    gx = (slope * t_x + (theta[9] + theta[12] * tone) / half) * inv_w
    gy = (slope * t_y + (theta[10] + theta[13] * tone) / half) * inv_w
    g = -(gx * x + gy * y)
    row[0], row[1], row[2] = gx * p, gx * q, gx
    row[3], row[4], row[5] = gy * p, gy * q, gy
    row[6], row[7] = g * p, g * q
    row[8], row[9], row[10] = 1.0, ex, ey
    row[11], row[12], row[13] = tone, ex * tone, ey * tone
    row[14] = slope * t_blur
    row[15] = contrast * t * (1.0 - t)
    if edge_row is not None:
        for k in range(edge_row.shape[0]):
            edge_row[k] *= slope
    return black + contrast * tone


@kernel
def accumulate(
    pixels: Array,
    theta: Array,
    frame: Array,
    cells: Array,
    edges: Array,
    spread: float,
    normal: Array,
    residuals: Array,
) -> None:
    """One pass over the pixels: weighted normal matrix, gradient in its last column, and residuals
    (0 where saturated).

    ``normal`` has shape (16, 17), its upper triangle is written. Weights fall off with the residual
    over ``spread``.
    """
    clear(normal)
    work = np.empty((6, cells.shape[0] + 1))
    row = np.empty(UNKNOWNS)
    block = np.zeros((2 * BLOCK, UNKNOWNS + 1))
    filled = 0
    for k in range(pixels.shape[0]):
        r = pixels[k, 2] - evaluate(
            pixels[k, 0], pixels[k, 1], theta, frame, cells, edges, work, row, None
        )
        # as bright as a pixel can be: any brighter light explains it
        if r < 0.0 and pixels[k, 2] >= SATURATED:
            residuals[k] = 0.0
            continue
        residuals[k] = r
        filled = add_row(row, r, spread, block, filled, normal)
    add_last(block, filled, normal)


@inner
def clear(matrix: Array) -> None:
    """Zeros everywhere."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@inner
def add_row(row: Array, r: float, spread: float, block: Array, filled: int, normal: Array) -> int:
    """Put a pixel's derivatives, weighted by its residual, into ``block`` (2 BLOCK, k + 1); a full
    one into ``normal``.

    Several at once, because memory is the slow part. Returns how many rows the block holds.
    """
    w = 1.0 / (1.0 + (r / spread) ** 2) ** 2
    own = block[filled]
    weighted = block[BLOCK + filled]
    for i in range(row.shape[0]):
        own[i] = row[i]
        weighted[i] = w * row[i]
    own[row.shape[0]] = r
    if filled < BLOCK - 1:
        return filled + 1
    _add_block(block, normal)
    return 0


@inner
def add_last(block: Array, filled: int, normal: Array) -> None:
    """The rows that did not fill a block."""
    for i in range(BLOCK + filled, 2 * BLOCK):
        for j in range(block.shape[1]):
            block[i, j] = 0.0
    _add_block(block, normal)


@inner
def _add_block(block: Array, normal: Array) -> None:
    """Add products of four rows to the upper triangle."""
    r0 = block[0]
    r1 = block[1]
    r2 = block[2]
    r3 = block[3]
    for i in range(normal.shape[0]):
        a = block[4, i]
        b = block[5, i]
        c = block[6, i]
        d = block[7, i]
        target = normal[i]
        for j in range(i, normal.shape[0] + 1):
            target[j] += a * r0[j] + b * r1[j] + c * r2[j] + d * r3[j]
