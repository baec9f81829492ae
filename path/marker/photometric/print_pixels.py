"""Homography between a printed marker and the rays that see it, and which pixels of an image show
the print.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.camera.kernels import place
from path.compiled import inner, kernel
from path.marker.kernels import Array, distort, undistort

Gray = NDArray[np.uint8]

MAX_PIXELS = 1600  # a larger marker is fitted on a selection of its pixels


@kernel
def frame_of(corners_px: Array, lens: Array, frame: Array, rays: Array) -> bool:
    """Coordinates in which a fit works: rays about the marker's centre, scaled to be of size one.

    Fills ``frame`` with (centre u, v in px; centre ray x, y; scale; d(p, q)/d(u, v) by rows), shape
    (9,), and ``rays`` with (p, q) of the corners, shape (4, 2). False when the corners are no
    quadrilateral in front of the camera.
    """
    u = 0.25 * (corners_px[0, 0] + corners_px[1, 0] + corners_px[2, 0] + corners_px[3, 0])
    v = 0.25 * (corners_px[0, 1] + corners_px[1, 1] + corners_px[2, 1] + corners_px[3, 1])
    cx, cy = undistort(u, v, lens, (u - lens[2]) / lens[0], (v - lens[3]) / lens[1])
    reach = 0.0
    for k in range(4):
        rays[k, 0], rays[k, 1] = undistort(corners_px[k, 0], corners_px[k, 1], lens, cx, cy)
        reach = max(reach, math.hypot(rays[k, 0] - cx, rays[k, 1] - cy))
    if not 0.0 < reach < 10.0:
        return False
    for k in range(4):
        rays[k, 0], rays[k, 1] = (rays[k, 0] - cx) / reach, (rays[k, 1] - cy) / reach
    _, _, ux, uy, vx, vy = distort(cx, cy, lens)
    gain = 1.0 / (reach * (ux * vy - uy * vx))
    frame[0], frame[1], frame[2], frame[3], frame[4] = u, v, cx, cy, 1.0 / reach
    frame[5], frame[6], frame[7], frame[8] = vy * gain, -uy * gain, -vx * gain, ux * gain
    return True


@kernel
def homography(corners: Array, n: int, theta: Array) -> bool:
    """Homography from ``corners`` (4, 2) to the print's corners (0,0) (n,0) (n,n) (0,n), into
    ``theta[:8]``.
    """
    x0 = corners[0, 0]
    y0 = corners[0, 1]
    x1 = corners[1, 0]
    y1 = corners[1, 1]
    x2 = corners[2, 0]
    y2 = corners[2, 1]
    x3 = corners[3, 0]
    y3 = corners[3, 1]
    ax = x1 - x2
    ay = y1 - y2
    bx = x3 - x2
    by = y3 - y2
    sx = x0 - x1 + x2 - x3
    sy = y0 - y1 + y2 - y3
    det = ax * by - bx * ay
    if abs(det) < 1e-9:
        return False
    g = (sx * by - sy * bx) / det
    h = (ax * sy - ay * sx) / det
    a = x1 - x0 + g * x1
    b = x3 - x0 + h * x3
    c = x0
    d = y1 - y0 + g * y1
    e = y3 - y0 + h * y3
    f = y0
    last = a * e - b * d
    if abs(last) < 1e-9:
        return False
    scale = n / last
    theta[0], theta[1], theta[2] = (e - f * h) * scale, (c * h - b) * scale, (b * f - c * e) * scale
    theta[3], theta[4], theta[5] = (f * g - d) * scale, (a - c * g) * scale, (c * d - a * f) * scale
    theta[6], theta[7] = (d * h - e * g) / last, (b * g - a * h) / last
    return True


@inner
def corner_rays(theta: Array, n: int, corners: Array, jacobian: Array) -> None:
    """The print's corners back in the fit's ray coordinates (4, 2), and d(corners)/d(theta[:8]),
    shape (8, 8).
    """
    for k in range(4):
        x = 0.0 if k in (0, 3) else float(n)
        y = 0.0 if k < 2 else float(n)
        a = theta[0] - x * theta[6]
        b = theta[1] - x * theta[7]
        c = x - theta[2]
        d = theta[3] - y * theta[6]
        e = theta[4] - y * theta[7]
        f = y - theta[5]
        det = a * e - b * d
        p = (c * e - b * f) / det
        q = (a * f - c * d) / det
        corners[k, 0], corners[k, 1] = p, q
        gains = (-p, -q, -1.0, x * p, x * q, y * p, y * q)
        for j in range(3):
            jacobian[2 * k, j], jacobian[2 * k + 1, j] = gains[j] * e / det, -gains[j] * d / det
            jacobian[2 * k, 3 + j], jacobian[2 * k + 1, 3 + j] = (
                -gains[j] * b / det,
                gains[j] * a / det,
            )
        for j in range(2):
            gx = gains[3 + j]
            gy = gains[5 + j]
            jacobian[2 * k, 6 + j] = (e * gx - b * gy) / det
            jacobian[2 * k + 1, 6 + j] = (a * gy - d * gx) / det


@inner
def _on_print(p: float, q: float, theta: Array) -> tuple[float, float]:
    """Print coordinates of a ray."""
    w = 1.0 + theta[6] * p + theta[7] * q
    return (theta[0] * p + theta[1] * q + theta[2]) / w, (
        theta[3] * p + theta[4] * q + theta[5]
    ) / w


@inner
def _mixed(a: int, b: int) -> int:
    """A whole number that looks random: a regular selection could run along the edges of a
    print.
    """
    h = (a * 73856093) ^ (b * 19349663)
    h = ((h >> 13) ^ h) * 1274126177
    return h >> 7


@kernel
def gather(  # noqa: PLR0915 (one pass over the pixels, compiled)
    image: Gray,
    u_off: int,
    v_off: int,
    frame: Array,
    lens: Array,
    theta: Array,
    n: int,
    blur_px: float,
    border: bool = True,
    most: int = MAX_PIXELS,
    block: int = 0,
) -> Array:
    """Pixels of the print and of the part of its quiet border that its outer edge does not reach.

    Without a ``border`` only those within its black frame that the outer edge does not reach.

    Of a large print about ``most`` are selected: pairs in a row, or squares of 2**block.

    Returns rows (p, q, grey, 1 when the row before is the pixel to the left, u, v), the last two
    the numbers of the camera's pixels.
    """
    height, width = image.shape
    cx = frame[2]
    cy = frame[3]
    scale = frame[4]
    xs = math.hypot(
        theta[0] * frame[5] + theta[1] * frame[7], theta[0] * frame[6] + theta[1] * frame[8]
    )
    ys = math.hypot(
        theta[3] * frame[5] + theta[4] * frame[7], theta[3] * frame[6] + theta[4] * frame[8]
    )
    if border:
        x_out = max(0.1, 1.0 - 2.0 * blur_px * xs)
        y_out = max(0.1, 1.0 - 2.0 * blur_px * ys)
    else:
        x_out = -min(0.9, 2.0 * blur_px * xs)
        y_out = -min(0.9, 2.0 * blur_px * ys)
    # the image box of the print, with its quiet border
    low_u = 1e9
    high_u = -1e9
    low_v = 1e9
    high_v = -1e9
    for k in range(4):
        x = -1.0 if k in (0, 3) else n + 1.0
        y = -1.0 if k < 2 else n + 1.0
        a = theta[0] - x * theta[6]
        b = theta[1] - x * theta[7]
        c = x - theta[2]
        d = theta[3] - y * theta[6]
        e = theta[4] - y * theta[7]
        f = y - theta[5]
        det = a * e - b * d
        u, v, _, _, _, _ = distort(
            (c * e - b * f) / det / scale + cx, (a * f - c * d) / det / scale + cy, lens
        )
        low_u = min(low_u, u - u_off)
        high_u = max(high_u, u - u_off)
        low_v = min(low_v, v - v_off)
        high_v = max(high_v, v - v_off)
    u0 = max(0, int(low_u))
    u1 = min(width, int(high_u) + 2)
    v0 = max(0, int(low_v))
    v1 = min(height, int(high_v) + 2)
    area = abs(frame[5] * frame[8] - frame[6] * frame[7]) * abs(
        theta[0] * theta[4] - theta[1] * theta[3]
    )
    share = round(1024.0 * most * area / ((n + x_out + x_out) * (n + y_out + y_out)))
    pixels = np.empty((max(0, (u1 - u0) * (v1 - v0)), 6))
    count = 0
    for v in range(v0, v1):
        previous = -2
        at_v = place(lens, 1, v + v_off)
        for u in range(u0, u1):
            if share < 1024 and _mixed(u >> max(block, 1), v >> block) & 1023 >= share:
                continue
            at_u = place(lens, 0, u + u_off)
            du = at_u - frame[0]
            dv = at_v - frame[1]
            p = frame[5] * du + frame[6] * dv
            q = frame[7] * du + frame[8] * dv
            mx, my = _on_print(p, q, theta)  # as if the lens were affine over the marker
            if not (-x_out - 0.5 < mx < n + x_out + 0.5 and -y_out - 0.5 < my < n + y_out + 0.5):
                continue
            x, y = undistort(at_u, at_v, lens, cx + p / scale, cy + q / scale)
            p = (x - cx) * scale
            q = (y - cy) * scale
            mx, my = _on_print(p, q, theta)
            if -x_out < mx < n + x_out and -y_out < my < n + y_out:
                pixels[count, 0], pixels[count, 1] = p, q
                pixels[count, 2] = image[v, u]
                pixels[count, 3] = 1.0 if previous == u - 1 else 0.0
                pixels[count, 4], pixels[count, 5] = u + u_off, v + v_off
                previous = u
                count += 1
    return pixels[:count]
