"""Corners of an image that lie on a surface, and what the surface around each looks like from
straight before it.

Two drones look at one place from up to a right angle apart. Depth says how each surface is turned,
gravity and heading how a view of it is: every patch is drawn as it would be seen from before it,
upright and in its true size. So descriptors need not bear viewpoint, size or turn, but what is left
of the headings' error.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from path.arrays import Array, Singles
from path.common_view.surface_kernels import planes

Bits = NDArray[np.uint8]
Image = NDArray[np.uint8]

PATCH_PX = 32
"""Side of the described patch as it is drawn."""
TILE_PX = 48
"""Side of what is drawn of it: descriptors look a little beyond."""
LEVELS = 4
FLAT = 0.75
"""From this share of a normal along gravity on, a patch is turned by north instead of by gravity."""
FACING = 0.2
"""Least cosine between a surface's normal and the view: below, nothing of it can be drawn."""
FAST_THRESHOLD = 7
CELLS_ACROSS = 32
IN_A_CELL = 3
PLANE_REACH_PX = 10
PLANE_LEAST = 40


def corners(grey: Image, most: int) -> Array:
    """Return the strongest corners (n, 2) px, spread over the image: few in each cell."""
    found = cv2.FastFeatureDetector.create(FAST_THRESHOLD).detect(grey)
    if not found:
        return np.zeros((0, 2))
    places = np.array([corner.pt for corner in found])
    strength = np.array([corner.response for corner in found])
    side = grey.shape[1] / CELLS_ACROSS
    cells = (places[:, 1] // side).astype(np.int64) * CELLS_ACROSS + (places[:, 0] // side).astype(
        np.int64
    )
    order = np.lexsort((-strength, cells))
    ordered = cells[order]
    firsts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    sizes = np.diff(np.r_[firsts, len(ordered)])
    rank = np.arange(len(ordered)) - np.repeat(firsts, sizes)
    kept = order[rank < IN_A_CELL]
    strongest = kept[np.argsort(-strength[kept], kind="stable")]
    return places[strongest[:most]]


def surfaces(
    depth: Singles,
    lens: Array,
    pixels: Array,
) -> tuple[Array, Array]:
    """Return corners (n, 3) on their surfaces, and normals (n, 3); z is 0 where there is no surface
    or it is seen along itself.
    """
    depths, normals = planes(depth, lens, pixels, PLANE_REACH_PX, PLANE_LEAST)
    points = np.empty((len(pixels), 3))
    points[:, 0] = (pixels[:, 0] - lens[2]) / lens[0] * depths
    points[:, 1] = (pixels[:, 1] - lens[3]) / lens[1] * depths
    points[:, 2] = depths
    across = -np.einsum("ij,ij->i", points, normals)
    points[across < FACING * np.linalg.norm(points, axis=1)] = 0.0
    return points, normals


def upright(normals: Array, R_l_c: Array) -> tuple[Array, Array]:
    """Return the axes right and down (n, 3) of surfaces, in the camera's frame."""
    level = normals @ R_l_c.T
    flat = np.abs(level[:, 2]) > FLAT
    along = np.where(flat[:, None], np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    down = along - level * np.einsum("ij,ij->i", along, level)[:, None]
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    right = np.cross(down, level)
    return right @ R_l_c, down @ R_l_c


def describe(
    grey: Image,
    lens: Array,
    R_l_c: Array,
    points: Array,
    normals: Array,
    patch_m: float,
) -> Bits:
    """Return 32 bytes for each of n points (n, 3) on surfaces, z > 0, in the camera's frame."""
    n = len(points)
    right, down = upright(normals, R_l_c)
    steps = (np.arange(TILE_PX) - 0.5 * (TILE_PX - 1)) * (patch_m / PATCH_PX)
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    places = points[:, None] + x[:, None] * right[:, None] + y[:, None] * down[:, None]
    z = np.maximum(places[..., 2], 0.1 * points[:, None, 2])
    u = (places[..., 0] / z * lens[0] + lens[2]).astype(np.float32)
    v = (places[..., 1] / z * lens[1] + lens[3]).astype(np.float32)
    # Pixels of the image by pixels drawn: from a smaller image where there are many.
    finer = patch_m / PATCH_PX * lens[0] / points[:, 2]
    level = np.clip(np.rint(np.log2(finer)), 0, LEVELS - 1).astype(np.int64)
    tiles = np.zeros((n, TILE_PX * TILE_PX), np.uint8)
    image = grey
    for number in range(LEVELS):
        own = level == number
        if own.any():
            scale = 0.5**number
            tiles[own] = cv2.remap(
                image,
                (u[own] + 0.5) * scale - 0.5,
                (v[own] + 0.5) * scale - 0.5,
                cv2.INTER_LINEAR,
            )
        image = cv2.pyrDown(image)
    return bits(tiles)


def bits(tiles: Image) -> Bits:
    """Return 32 bytes for each drawn patch (n, 48 * 48)."""
    n = len(tiles)
    strip = np.asarray(tiles.reshape(n * TILE_PX, TILE_PX))
    middle = 0.5 * (TILE_PX - 1)
    places = [
        cv2.KeyPoint(middle, number * TILE_PX + middle, PATCH_PX - 1.0, 0.0, 0.0, 0, number)
        for number in range(n)
    ]
    describer = cv2.xfeatures2d.TEBLID.create(1.0, cv2.xfeatures2d.TEBLID_SIZE_256_BITS)
    kept, descriptors = describer.compute(strip, places)
    if len(kept) != n:
        raise RuntimeError("OpenCV left out patches that lie inside of their image")
    return np.asarray(descriptors, np.uint8).reshape(n, -1)
