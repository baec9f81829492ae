"""Small numba routines shared by the photometric fit and the pose: lens, homography, Cholesky.

Written out in scalars and plain loops, in float64 without fast-math, so that results do not depend
on the machine. A lens is the array of ``path.camera.kernels.lens_of``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.compiled import inner, kernel

Array = NDArray[np.float64]


@inner
def distort(x: float, y: float, lens: Array) -> tuple[float, float, float, float, float, float]:
    """Pixel of an undistorted ray and its derivatives: ``u, v, du/dx, du/dy, dv/dx, dv/dy``."""
    k1 = lens[4]
    k2 = lens[5]
    p1 = lens[6]
    p2 = lens[7]
    k3 = lens[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    xy = x * y * slope + 2.0 * (p1 * x + p2 * y)
    yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return (
        lens[0] * xd + lens[2],
        lens[1] * yd + lens[3],
        lens[0] * xx,
        lens[0] * xy,
        lens[1] * xy,
        lens[1] * yy,
    )


@inner
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


@kernel
def rays(pixels: Array, lens: Array) -> Array:
    """Undistorted rays, shape (n, 2), of pixels (n, 2)."""
    out = np.empty(pixels.shape)
    for k in range(pixels.shape[0]):
        u = pixels[k, 0]
        v = pixels[k, 1]
        out[k, 0], out[k, 1] = undistort(
            u, v, lens, (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
        )
    return out


@inner
def cholesky(a: Array) -> bool:
    """Replace the lower triangle of a symmetric matrix by its Cholesky factor; False when not
    positive definite.
    """
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


@inner
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


@kernel
def finite(a: Array) -> bool:
    """Return whether every number of a matrix is finite."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            if not math.isfinite(a[i, j]):
                return False
    return True


@kernel
def whitening(covariance: Array, floor: float, out: Array) -> bool:
    """Inverse Cholesky factor of a covariance plus ``floor`` on its diagonal: residuals times it
    have unit variance.

    Only the lower triangle of ``out`` is written. False when the covariance is not positive
    definite.
    """
    n = covariance.shape[0]
    factor = covariance.copy()
    for i in range(n):
        factor[i, i] += floor
    if not cholesky(factor):
        return False
    for j in range(n):
        out[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, n):
            s = 0.0
            for k in range(j, i):
                s -= factor[i, k] * out[k, j]
            out[i, j] = s / factor[i, i]
    return True


@inner
def inverse(a: Array, out: Array) -> bool:
    """Inverse of a symmetric matrix into ``out``; False when it is not positive definite."""
    n = a.shape[0]
    factor = a.copy()
    if not cholesky(factor):
        return False
    for i in range(n):
        column = out[i]  # by symmetry
        for j in range(n):
            column[j] = 1.0 if i == j else 0.0
        cholesky_solve(factor, column)
    return True


@inner
def identity(n: int) -> Array:
    """The unit matrix, shape (n, n)."""
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    return out


@inner
def exp_times(w: Array, R: Array) -> Array:
    """``exp(w) R`` by Rodrigues' formula."""
    angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    a = 1.0 - angle * angle / 6.0 if angle < 1e-6 else math.sin(angle) / angle
    b = 0.5 if angle < 1e-6 else (1.0 - math.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for j in range(3):
        x = R[0, j]
        y = R[1, j]
        z = R[2, j]
        cx = w[1] * z - w[2] * y
        cy = w[2] * x - w[0] * z
        cz = w[0] * y - w[1] * x
        out[0, j] = x + a * cx + b * (w[1] * cz - w[2] * cy)
        out[1, j] = y + a * cy + b * (w[2] * cx - w[0] * cz)
        out[2, j] = z + a * cz + b * (w[0] * cy - w[1] * cx)
    return out
