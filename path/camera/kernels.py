"""The camera's arithmetic for one pixel, compiled; ``path.camera.model`` says what it means.

A lens is the array ``(fx, fy, cx, cy, k1, k2, p1, p2, k3, width, height, max_radius, kept, of,
begins)`` of ``lens_of``; the last four are ``path.camera.thinning``'s, 0 where no pixels are left
out.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from path.arrays import Array
from path.camera.model import UNDISTORT_ITERATIONS, UNDISTORT_STEP, CameraModel
from path.camera.thinning import ROUNDING
from path.compiled import inner, kernel


@lru_cache(maxsize=64)
def lens_of(camera: CameraModel) -> Array:
    """A camera as the array the kernels take, shape (16,). Shared: do not change it."""
    focal_and_centre = camera.fx, camera.fy, camera.cx, camera.cy
    limits = camera.width, camera.height, camera.max_radius
    thin = camera.thinning
    pattern = (0.0, 0.0, 0.0, 0.0) if thin is None else (thin.kept, thin.of, *thin.begins)
    return np.array([*focal_and_centre, *camera.distortion, *limits, *pattern], dtype=np.float64)


@inner
def place(lens: Array, axis: int, pixel: int) -> float:
    """The place of a column (axis 0) or row of the camera's image in the evenly spaced one."""
    if lens[12] == 0.0:
        return float(pixel)
    begin = lens[14 + axis]
    line = math.floor((pixel - begin + 0.5) * lens[13] / lens[12] + ROUNDING)
    return (line + 0.5) * lens[12] / lens[13] + begin - 0.5


@kernel
def ray(lens: Array, u: float, v: float) -> tuple[float, float]:
    """Undistorted normalised coordinates of a pixel, by Newton's method to 1e-12; NaN where there
    are none.
    """
    k1 = lens[4]
    k2 = lens[5]
    p1 = lens[6]
    p2 = lens[7]
    k3 = lens[8]
    xd = (u - lens[2]) / lens[0]
    yd = (v - lens[3]) / lens[1]
    if k1 == 0.0 and k2 == 0.0 and p1 == 0.0 and p2 == 0.0 and k3 == 0.0:
        return xd, yd
    x = xd
    y = yd
    for _ in range(UNDISTORT_ITERATIONS):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope2 = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        xy2 = 2.0 * x * y
        gx = x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x) - xd
        gy = y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2 - yd
        xx = radial + x * x * slope2 + 2.0 * p1 * y + 6.0 * p2 * x
        xy = x * y * slope2 + 2.0 * (p1 * x + p2 * y)
        yy = radial + y * y * slope2 + 6.0 * p1 * y + 2.0 * p2 * x
        determinant = xx * yy - xy * xy
        if determinant == 0.0:
            break
        dx = (yy * gx - xy * gy) / determinant
        dy = (xx * gy - xy * gx) / determinant
        x -= dx
        y -= dy
        if abs(dx) + abs(dy) < UNDISTORT_STEP:
            return (x, y) if math.hypot(x, y) <= lens[11] else (math.nan, math.nan)
    return math.nan, math.nan


@inner
def project(lens: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a point in the camera frame with z > 0."""
    x = x / z
    y = y / z
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
    xy2 = 2.0 * x * y
    xd = x * radial + lens[6] * xy2 + lens[7] * (r2 + 2.0 * x * x)
    yd = y * radial + lens[6] * (r2 + 2.0 * y * y) + lens[7] * xy2
    return lens[0] * xd + lens[2], lens[1] * yd + lens[3]


@kernel
def extent(
    lens: Array, points_c: Array, nearest_m: float
) -> tuple[float, float, float, float, float]:
    """Return the extent in the image of points (n, 3) beyond a distance: ``u0, v0, u1, v1`` and
    the least depth.

    The depth is infinite when the image shows none.
    """
    u0 = v0 = near = np.inf
    u1 = v1 = -np.inf
    for k in range(points_c.shape[0]):
        x = points_c[k, 0]
        y = points_c[k, 1]
        z = points_c[k, 2]
        if not z > nearest_m or x * x + y * y > (lens[11] * z) * (lens[11] * z):
            continue
        u, v = project(lens, x, y, z)
        if -0.5 <= u < lens[9] - 0.5 and -0.5 <= v < lens[10] - 0.5:
            u0 = min(u0, u)
            v0 = min(v0, v)
            u1 = max(u1, u)
            v1 = max(v1, v)
            near = min(near, z)
    return u0, v0, u1, v1, near
