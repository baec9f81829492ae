"""The target's point in D2's image and what is known of it, compiled: one crossing for a frame.

``path.cycle.prior`` says what it means.
"""

from __future__ import annotations

import math

from path.arrays import Array
from path.camera.kernels import project
from path.camera.model import distort_jacobian
from path.compiled import as_it_is, inner, kernel
from path.geometry.rigid import Rigid, transform
from path.messages import Vec3

Six = tuple[float, float, float, float, float, float]
Covariance2 = tuple[float, float, float]
Projected = tuple[float, float, float, Covariance2, float, float]
"""Pixel and depth, the pixel's covariance, standard deviations of D2's position (per axis) and of
the depth by it.
"""

as_it_is(distort_jacobian)
as_it_is(transform)


@inner
def _product(a: Six, covariance: Array, b: Six) -> float:
    total = 0.0
    for i in range(6):
        row = 0.0
        for k in range(6):
            row += covariance[i, k] * b[k]
        total += a[i] * row
    return total


@kernel
def projected(
    lens: Array, T_c_v: Rigid, covariance: Array, point_v: Vec3, sigma_m: float, sigma_px: float, way_v: Vec3,
    across_m: float,
) -> Projected:  # fmt: skip
    """Return the point in the image with all that is not known of it.

    NaN where the camera does not see it, also its depth where an input is not a number.

    Args:
        covariance: of ``T_c_v``, (6, 6), contiguous.
        sigma_m: of the point, per axis; along ``way_v`` only, and ``across_m`` across it, where
            that is not negative.
        sigma_px: of a detector's box centre.
    """
    nothing = math.nan, math.nan, math.nan
    x, y, z = transform(T_c_v, point_v)
    if not math.isfinite(x + y + z):
        return math.nan, math.nan, math.nan, nothing, math.nan, math.nan
    if not z > 0.0 or x * x + y * y > (lens[11] * z) * (lens[11] * z):
        return math.nan, math.nan, z, nothing, math.nan, math.nan
    u, v = project(lens, x, y, z)
    if not (-0.5 <= u < lens[9] - 0.5 and -0.5 <= v < lens[10] - 0.5):
        return math.nan, math.nan, z, nothing, math.nan, math.nan
    nx = x / z
    ny = y / z
    xx, xy, yy = distort_jacobian(nx, ny, (lens[4], lens[5], lens[6], lens[7], lens[8]))
    fx = lens[0] / z
    fy = lens[1] / z
    a = fx * xx
    b = fx * xy
    c = -fx * (nx * xx + ny * xy)
    d = fy * xy
    e = fy * yy
    f = -fy * (nx * xy + ny * yy)
    tx = T_c_v[9]
    ty = T_c_v[10]
    tz = T_c_v[11]
    # the rotation turns the point about the marker's origin: dX = dt + dw x q with q = R p_v
    x = x - tx
    y = y - ty
    z0 = z - tz
    along_u = a, b, c, c * y - b * z0, a * z0 - c * x, b * x - a * y
    along_v = d, e, f, f * y - e * z0, d * z0 - f * x, e * x - d * y
    depth = 0.0, 0.0, 1.0, y, -x, 0.0
    point = sigma_m * sigma_m
    along = 0.0
    pixel = sigma_px * sigma_px
    du = 0.0
    dv = 0.0
    if across_m >= 0.0:
        ahead = transform(T_c_v, way_v)
        rx = ahead[0] - tx
        ry = ahead[1] - ty
        rz = ahead[2] - tz
        du = a * rx + b * ry + c * rz
        dv = d * rx + e * ry + f * rz
        along = point - across_m * across_m
        point = across_m * across_m
    uu = (
        _product(along_u, covariance, along_u)
        + point * (a * a + b * b + c * c)
        + along * du * du
        + pixel
    )
    uv = _product(along_u, covariance, along_v) + point * (a * d + b * e + c * f) + along * du * dv
    vv = (
        _product(along_v, covariance, along_v)
        + point * (d * d + e * e + f * f)
        + along * dv * dv
        + pixel
    )
    # D2's position is -R^T t, in D2's own axes it moves by -(dt - dw x t)
    own_x = (1.0, 0.0, 0.0, 0.0, -tz, ty)
    own_y = (0.0, 1.0, 0.0, tz, 0.0, -tx)
    own_z = (0.0, 0.0, 1.0, -ty, tx, 0.0)
    position = _product(own_x, covariance, own_x) + _product(own_y, covariance, own_y)
    position = math.sqrt(max(0.0, position + _product(own_z, covariance, own_z)) / 3.0)
    return u, v, z, (uu, uv, vv), position, math.sqrt(max(0.0, _product(depth, covariance, depth)))
