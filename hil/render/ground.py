"""Compiled drawing of the ground and the sky: trilinear texture on a plane, row by row.

Every step is a loop of its own over a long stretch of a row, so that all but the gather itself
vectorise.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import math

import numpy as np

from hil.render.textures import GROUND_BITS, GROUND_LEVELS, GROUND_PERIOD_M, GROUND_SIZE
from path.arrays import Array
from path.compiled import inner, kernel
from path.geometry.transforms import Pose

F = np.float32
INT = np.int32
ZERO = F(0.0)
HALF = F(0.5)
ONE = F(1.0)

BLOCK = 16  # columns that share a level of detail
COARSE = 8  # the ground is modulated by itself, so many times larger, to hide the tiling
COARSE_FINER = 3  # log2(COARSE): levels by which the enlarged texture is finer
LOWEST_M = 0.01  # a camera on or below the ground sees it from here
FARTHEST_M = F(400.0)
HAZE_M = F(60.0)  # from here on the ground fades into the sky
SCRATCH_ROWS = 9


def ground_plane(T_w_c: Pose) -> Array:
    """Coefficients of u/z, v/z, 1/z of the ground, shape (3, 3); u to the east, v to the north, in
    tiles.

    Counted from a multiple of the texture's whole period near the camera, to keep the numbers
    small.
    """
    whole = GROUND_PERIOD_M * COARSE
    anchor = np.array(
        [math.floor(T_w_c.t[0] / whole) * whole, math.floor(T_w_c.t[1] / whole) * whole, 0.0]
    )
    camera = np.array([T_w_c.t[0], T_w_c.t[1], max(float(T_w_c.t[2]), LOWEST_M)])
    R_c_w = T_w_c.R.T
    M = np.column_stack(
        (R_c_w[:, 0] * GROUND_PERIOD_M, R_c_w[:, 1] * GROUND_PERIOD_M, R_c_w @ (anchor - camera))
    )
    return np.asarray(np.linalg.inv(M), float)


@inner
def _meet(plane, rx, ry, z_row, u_row, v_row, inverse_z):
    """Compute where the rays of a row meet the ground, in tiles; 1/z is 0 above the horizon."""
    u0 = F(plane[0, 0])
    u1 = F(plane[0, 1])
    u2 = F(plane[0, 2])
    v0 = F(plane[1, 0])
    v1 = F(plane[1, 1])
    v2 = F(plane[1, 2])
    w0 = F(plane[2, 0])
    w1 = F(plane[2, 1])
    w2 = F(plane[2, 2])
    nearest = ONE / FARTHEST_M
    for c in range(rx.size):
        x = rx[c]
        y = ry[c]
        w = w0 * x + w1 * y + w2
        z = ONE / max(w, nearest)
        inverse_z[c] = max(w, ZERO)
        z_row[c] = z
        u_row[c] = (u0 * x + u1 * y + u2) * z
        v_row[c] = (v0 * x + v1 * y + v2) * z


@inner
def _detail(plane, x, y, u, v, z, pixel):
    """Level of detail (log2 texels per pixel) at one pixel, within the levels there are."""
    a = plane[0, 0] - u * plane[2, 0]
    b = plane[0, 1] - u * plane[2, 1]
    c = plane[1, 0] - v * plane[2, 0]
    d = plane[1, 1] - v * plane[2, 1]
    texels = z * pixel * GROUND_SIZE
    square = 0.5 * (a * a + b * b + c * c + d * d) * texels * texels + 1e-12
    return min(0.5 * np.log2(square), GROUND_LEVELS - 1.001) if square > 1.0 else 0.0


@inner
def _lookup(texture, level, scale, u, v, words, fraction_u, fraction_v, out):
    """Bilinear texture of one mip level at u, v (tiles) times ``scale``, into ``out``; all of one
    length.
    """
    size = INT(GROUND_SIZE >> level)
    first = INT((4 * (GROUND_SIZE * GROUND_SIZE - size * size)) // 3)
    mask = INT(size - 1)
    shift = INT(GROUND_BITS - level)
    texels = F(size) * scale
    for c in range(u.size):
        tu = u[c] * texels - HALF
        tv = v[c] * texels - HALF
        iu = np.floor(tu)
        iv = np.floor(tv)
        fraction_u[c] = tu - iu
        fraction_v[c] = tv - iv
        words[c] = INT(first + INT(INT(INT(INT(iv) & mask) << shift) + INT(INT(iu) & mask)))
    for c in range(u.size):
        words[c] = texture[words[c]]
    for c in range(u.size):
        word = words[c]
        a = fraction_u[c]
        b = fraction_v[c]
        t00 = F(INT(word & INT(255)))
        t01 = F(INT(INT(word >> INT(8)) & INT(255)))
        t10 = F(INT(INT(word >> INT(16)) & INT(255)))
        t11 = F(INT(INT(word >> INT(24)) & INT(255)))
        top = t00 + a * (t01 - t00)
        bottom = t10 + a * (t11 - t10)
        out[c] = top + b * (bottom - top)


@inner
def _stretch(texture, level, finest, rows, words, c0, c1):
    """Grey levels of the columns c0..c1, which share a mip level. ``finest``: they have no share in
    the next one.
    """
    u = rows[1, c0:c1]
    v = rows[2, c0:c1]
    share = rows[3, c0:c1]
    fu = rows[4, c0:c1]
    fv = rows[5, c0:c1]
    fine = rows[6, c0:c1]
    next_fine = rows[7, c0:c1]
    rough = rows[8, c0:c1]
    words = words[c0:c1]
    _lookup(texture, level, ONE, u, v, words, fu, fv, fine)
    _lookup(texture, max(level + 1 - COARSE_FINER, 0), F(1.0 / COARSE), u, v, words, fu, fv, rough)
    if finest:
        return
    _lookup(texture, level + 1, ONE, u, v, words, fu, fv, next_fine)
    for c in range(fine.size):
        fine[c] += share[c] * (next_fine[c] - fine[c])


@kernel
def draw_ground(plane, light, pixel, ray_x, ray_y, texture, tints, rows, words, image, inverse_z):
    """Ground and sky everywhere, and the ground's 1/z.

    plane: of ``ground_plane``. light: shading factor. pixel: size of a pixel on z = 1. tints: as
    ``looks.Tints.rows``. rows: float32 scratch (SCRATCH_ROWS, >= w); words: int32 scratch (w,).
    """
    height, width = ray_x.shape
    lit = F(light)
    for r in range(height):
        _meet(
            plane,
            ray_x[r],
            ray_y[r],
            rows[0, :width],
            rows[1, :width],
            rows[2, :width],
            inverse_z[r],
        )
        start = 0
        current = -1
        finest = False
        for c0 in range(0, width, BLOCK):
            c1 = min(c0 + BLOCK, width)
            m = (c0 + c1) // 2
            detail = _detail(
                plane, ray_x[r, m], ray_y[r, m], rows[1, m], rows[2, m], rows[0, m], pixel
            )
            level = int(detail)
            rows[3, c0:c1] = F(detail - level)
            if level != current or finest != (detail == 0.0):
                if c0 > 0:
                    _stretch(texture, current, finest, rows, words, start, c0)
                start = c0
                current = level
                finest = detail == 0.0
        _stretch(texture, current, finest, rows, words, start, width)
        for k in range(3):
            base = tints[0, k]
            fine = tints[1, k]
            rough = tints[2, k]
            sky = tints[3, k]
            _tint(base, fine, rough, sky, lit, inverse_z[r], rows[6], rows[8], image[k, r])


@inner
def _tint(base, fine_gain, rough_gain, sky, lit, inverse_z, fine, rough, out):
    for c in range(out.size):
        haze = min(inverse_z[c] * HAZE_M, ONE)
        value = lit * (base + fine_gain * fine[c] + rough_gain * rough[c])
        out[c] = np.uint8(INT(sky + haze * (value - sky) + HALF))


@kernel
def ground_depth(plane, ray_x, ray_y, inverse_z):
    """1/z of the ground alone; 0 above the horizon."""
    w0 = F(plane[2, 0])
    w1 = F(plane[2, 1])
    w2 = F(plane[2, 2])
    for r in range(ray_x.shape[0]):
        rx = ray_x[r]
        ry = ray_y[r]
        out = inverse_z[r]
        for c in range(rx.size):
            out[c] = max(w0 * rx[c] + w1 * ry[c] + w2, ZERO)
