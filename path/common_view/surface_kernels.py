"""Depth images, compiled: registering one to another camera, thinning it to a grid, planes in it.

A lens is ``(fx, fy, cx, cy)`` in px, without distortion; depths are along the optical axis, in
metres, and 0 where nothing was measured. A plane is a straight function of pixels in inverse depth.
"""

from __future__ import annotations

import math

import numpy as np

from path.arrays import Array, Singles
from path.compiled import inner, kernel

PLANE_ROUNDS = 3
SAME_SURFACE = 0.06
"""Share of its inverse depth by which a pixel may differ from the middle and belong to it."""
ON_PLANE = 0.01
"""Share of its inverse depth by which a pixel may miss the plane in the last round."""


@kernel
def registered(depth: Singles, lens: Array, R: Array, t: Array, other: Array, out: Singles) -> None:
    """Draw a depth image as another camera sees it, the nearest surface in each pixel.

    Args:
        R, t: (3, 3) and (3,), from the depth camera's frame to the other's.
        other: the other camera's lens. ``out``: its image, overwritten.
    """
    height, width = out.shape
    out[:] = 0.0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not z > 0.0:
                continue
            x = (u - lens[2]) / lens[0] * z
            y = (v - lens[3]) / lens[1] * z
            there = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
            if not there > 0.0:
                continue
            right = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
            down = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
            # Two pixels each way, so that a finer image has no holes.
            left = math.floor(other[0] * right / there + other[2])
            top = math.floor(other[1] * down / there + other[3])
            for row in range(max(top, 0), min(top + 2, height)):
                for column in range(max(left, 0), min(left + 2, width)):
                    if out[row, column] == 0.0 or there < out[row, column]:
                        out[row, column] = there


@kernel
def thinned(depth: Singles, height: int, width: int) -> Singles:
    """Return the median depth of each cell of a coarser grid; 0 where less than half is known."""
    out = np.zeros((height, width), np.float32)
    high = depth.shape[0] / height
    wide = depth.shape[1] / width
    found = np.empty(25, np.float32)
    for row in range(height):
        for column in range(width):
            n = 0
            for i in range(5):
                v = int((row + (i + 0.5) / 5.0) * high)
                for j in range(5):
                    z = depth[v, int((column + (j + 0.5) / 5.0) * wide)]
                    if z > 0.0:
                        found[n] = z
                        n += 1
            if n > 12:
                some = np.sort(found[:n])
                out[row, column] = some[n // 2]
    return out


@inner
def _solve3(M: Array, b: Array, x: Array) -> bool:
    """Solve a symmetric 3 x 3 system by cofactors; False when it is singular."""
    a = M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1]
    c = M[1, 2] * M[2, 0] - M[1, 0] * M[2, 2]
    d = M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0]
    det = M[0, 0] * a + M[0, 1] * c + M[0, 2] * d
    if not abs(det) > 1e-9:
        return False
    e = M[0, 2] * M[2, 1] - M[0, 1] * M[2, 2]
    f = M[0, 0] * M[2, 2] - M[0, 2] * M[2, 0]
    g = M[0, 1] * M[2, 0] - M[0, 0] * M[2, 1]
    h = M[0, 1] * M[1, 2] - M[0, 2] * M[1, 1]
    i = M[0, 2] * M[1, 0] - M[0, 0] * M[1, 2]
    j = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    x[0] = (a * b[0] + e * b[1] + h * b[2]) / det
    x[1] = (c * b[0] + f * b[1] + i * b[2]) / det
    x[2] = (d * b[0] + g * b[1] + j * b[2]) / det
    return True


@inner
def _nearest(depth: Singles, u: int, v: int) -> float:
    """Return the least depth of a pixel and its neighbours; 0 where none is known."""
    nearest = 0.0
    for row in range(max(v - 1, 0), min(v + 2, depth.shape[0])):
        for column in range(max(u - 1, 0), min(u + 2, depth.shape[1])):
            z = depth[row, column]
            if z > 0.0 and (nearest == 0.0 or z < nearest):
                nearest = z
    return nearest


@inner
def _add_on_plane(
    depth: Singles, u: int, v: int, reach: int, x: Array, tolerance: float, M: Array, b: Array
) -> int:
    """Write the normal equations of the pixels near a plane ``x``; return how many they are."""
    M[:] = 0.0
    b[:] = 0.0
    count = 0
    for row in range(max(v - reach, 0), min(v + reach + 1, depth.shape[0])):
        for column in range(max(u - reach, 0), min(u + reach + 1, depth.shape[1])):
            z = depth[row, column]
            if not z > 0.0:
                continue
            q = 1.0 / z
            i = float(column - u)
            j = float(row - v)
            if abs(x[0] * i + x[1] * j + x[2] - q) > tolerance:
                continue
            count += 1
            M[0, 0] += i * i
            M[0, 1] += i * j
            M[0, 2] += i
            M[1, 1] += j * j
            M[1, 2] += j
            b[0] += i * q
            b[1] += j * q
            b[2] += q
    M[2, 2] = count
    M[1, 0] = M[0, 1]
    M[2, 0] = M[0, 2]
    M[2, 1] = M[1, 2]
    return count


@kernel
def planes(
    depth: Singles, lens: Array, pixels: Array, reach: int, least: int
) -> tuple[Array, Array]:
    """Fit a plane around each pixel, to what belongs to the nearest surface there.

    Args:
        pixels: (n, 2). ``reach``: pixels to each side that are asked. ``least``: of them on a plane.

    Returns:
        Singles (n,), 0 where there is no plane, and unit normals (n, 3) towards the camera.
    """
    depths = np.zeros(len(pixels))
    normals = np.zeros((len(pixels), 3))
    M = np.empty((3, 3))
    b = np.empty(3)
    x = np.empty(3)
    for k in range(len(pixels)):
        u = int(np.rint(pixels[k, 0]))
        v = int(np.rint(pixels[k, 1]))
        nearest = _nearest(depth, u, v)
        if not nearest > 0.0:
            continue
        middle = 1.0 / nearest
        x[0], x[1], x[2] = 0.0, 0.0, middle
        tolerance = SAME_SURFACE * middle
        fits = True
        for _ in range(PLANE_ROUNDS):
            count = _add_on_plane(depth, u, v, reach, x, tolerance, M, b)
            fits = count >= least and _solve3(M, b, x)
            if not fits:
                break
            tolerance = max(ON_PLANE * middle, 0.5 * tolerance)
        if not fits:
            continue
        q = x[2] + x[0] * (pixels[k, 0] - u) + x[1] * (pixels[k, 1] - v)
        if not q > 0.25 * middle:
            continue
        # 1/z = n . ray: the plane's normal by its distance.
        nx = x[0] * lens[0]
        ny = x[1] * lens[1]
        nz = x[2] - nx * (u - lens[2]) / lens[0] - ny * (v - lens[3]) / lens[1]
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        depths[k] = 1.0 / q
        normals[k, 0] = -nx / size
        normals[k, 1] = -ny / size
        normals[k, 2] = -nz / size
    return depths, normals
