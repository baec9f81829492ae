"""Small numba routines shared by the photometric fit and the pose: lens, homography, Cholesky.

Written out in scalars and plain loops, in float64 without fast-math, so that results do not depend on the machine.
A lens is the array ``(fx, fy, cx, cy, k1, k2, p1, p2, k3)`` of ``lens_of``.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from path.camera import CameraModel

Array = NDArray[np.float64]


@lru_cache(maxsize=8)
def lens_of(camera: CameraModel) -> Array:
    """A camera as the array the kernels take, shape (9,). Shared: do not change it."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion], dtype=np.float64)


@njit(cache=True, nogil=True)
def distort(x: float, y: float, lens: Array) -> tuple[float, float, float, float, float, float]:
    """Pixel of an undistorted ray and its derivatives: ``u, v, du/dx, du/dy, dv/dx, dv/dy``."""
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    xy = x * y * slope + 2.0 * (p1 * x + p2 * y)
    yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return lens[0] * xd + lens[2], lens[1] * yd + lens[3], lens[0] * xx, lens[0] * xy, lens[1] * xy, lens[1] * yy


@njit(cache=True, nogil=True)
def undistort(u: float, v: float, lens: Array, x: float, y: float) -> tuple[float, float]:
    """Undistorted ray of a pixel by Newton's method from a first guess ``(x, y)``."""
    for _ in range(20):
        gu, gv, ux, uy, vx, vy = distort(x, y, lens)
        gu -= u
        gv -= v
        det = ux * vy - uy * vx
        x -= (vy * gu - uy * gv) / det
        y -= (ux * gv - vx * gu) / det
        if abs(gu) + abs(gv) < 1e-4:  # px before this step; it squares the error
            break
    return x, y


@njit(cache=True, nogil=True)
def rays(pixels: Array, lens: Array) -> Array:
    """Undistorted rays, shape (n, 2), of pixels (n, 2)."""
    out = np.empty(pixels.shape)
    for k in range(pixels.shape[0]):
        u, v = pixels[k, 0], pixels[k, 1]
        out[k, 0], out[k, 1] = undistort(u, v, lens, (u - lens[2]) / lens[0], (v - lens[3]) / lens[1])
    return out


@njit(cache=True, nogil=True)
def cholesky(a: Array) -> bool:
    """Replace the lower triangle of a symmetric matrix by its Cholesky factor; False when not positive definite."""
    n = a.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                a[i, i] = math.sqrt(s)
            else:
                a[i, j] = s / a[j, j]
    return True


@njit(cache=True, nogil=True)
def cholesky_solve(factor: Array, b: Array) -> None:
    """Solve ``L L^T x = b`` in place, ``L`` from ``cholesky``, ``b`` of shape (n,)."""
    n = factor.shape[0]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= factor[i, k] * b[k]
        b[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * b[k]
        b[i] = s / factor[i, i]
