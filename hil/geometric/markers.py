"""Markers of the geometric perception: which are found, and their noisy corners. Compiled."""

# pyright: reportMissingParameterType=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import EYE, NEAREST_M, distorted, gauss, mix, nearest, uniform
from path.compiled import inner, kernel


class MarkerNoise(NamedTuple):
    """The difference of found marker corners to the true ones, and the chance that a marker is
    found.
    """

    half_side_px: float
    side_slope_per_px: float
    lapse_rate: float
    corner_sigma_px2: float
    corner_floor_px: float
    corner_spread: float
    claimed_factor: float
    coarse_rate: float
    coarse_sigma_px: float
    max_incidence_cos: float


PLATE_GAP_M = 0.004  # what is so little in front of a marker is its own plate


@kernel
def marker(
    boxes, extents, per_car, frame, lens, R, t, corners, region, noise, key, slow_key, found
):
    """The corners of one marker as the finder gives them.

    Args:
        R, t: the sender in the world; corners: (4, 3) of the marker in the sender's body frame, in
            the order of the print.
        slow_key: changes only now and then: for what goes wrong for a while.
        region: x0 y0 x1 y1, what is searched.
        found: (9,) filled: u v of each corner, then the standard deviation that is claimed for each
            coordinate (px).

    Returns:
        Whether the marker is found.
    """
    at = np.empty((4, 3))
    pixels = np.empty((4, 2))
    if (
        not _project(frame, lens, R, t, corners, at, pixels)
        or _facing(at) < noise.max_incidence_cos
    ):
        return False
    side = np.inf
    for k in range(4):
        a = pixels[k]
        b = pixels[(k + 1) % 4]
        side = min(side, math.hypot(b[0] - a[0], b[1] - a[1]))
    chance = 1.0 / (1.0 + math.exp(-noise.side_slope_per_px * (side - noise.half_side_px)))
    lapse = uniform(mix(slow_key, 202)) < noise.lapse_rate
    if lapse or not _inside(pixels, region, lens, side / 12.0) or uniform(mix(key, 200)) > chance:
        return False
    if _covered(boxes, extents, per_car, lens, at):
        return False
    draws = np.empty(9)
    gauss(key, draws)
    sigma = math.hypot(noise.corner_sigma_px2 / side, noise.corner_floor_px)
    found[8] = noise.claimed_factor * sigma
    sigma *= math.exp(noise.corner_spread * draws[8])
    if uniform(mix(key, 201)) < noise.coarse_rate:
        sigma = found[8] = noise.coarse_sigma_px
    for k in range(8):
        found[k] = pixels[k // 2, k % 2] + sigma * draws[k]
    return True


@inner
def _project(frame, lens, R, t, corners, at, pixels):
    """Corners in the camera frame, ``at`` (4, 3), and their pixels (4, 2); False when one is behind
    the camera.
    """
    for k in range(4):
        at[k] = 0.0
        for i in range(3):
            w = (
                R[i, 0] * corners[k, 0]
                + R[i, 1] * corners[k, 1]
                + R[i, 2] * corners[k, 2]
                + t[i]
                - frame[EYE + i]
            )
            for j in range(3):
                at[k, j] += frame[3 * j + i] * w
        z = at[k, 2]
        if z < NEAREST_M or at[k, 0] ** 2 + at[k, 1] ** 2 > (lens[11] * z) ** 2:
            return False
        pixels[k, 0], pixels[k, 1] = distorted(lens, at[k, 0] / z, at[k, 1] / z)
    return True


@inner
def _inside(pixels, region, lens, margin):
    """Return whether all corners, and ``margin`` px of white around them, are in the region and in
    the image.
    """
    low_u = max(region[0], -0.5) + margin
    low_v = max(region[1], -0.5) + margin
    high_u = min(region[2], lens[9] - 0.5) - margin
    high_v = min(region[3], lens[10] - 0.5) - margin
    outside = 0
    for k in range(pixels.shape[0]):
        if not (low_u <= pixels[k, 0] <= high_u and low_v <= pixels[k, 1] <= high_v):
            outside += 1
    return outside == 0


@inner
def _facing(at):
    """Cosine between the print's normal and the line of sight; ``at`` (4, 3): corners in the camera
    frame.
    """
    across = np.empty(3)
    up = np.empty(3)
    middle = np.empty(3)
    for i in range(3):
        across[i], up[i] = at[1, i] - at[0, i], at[0, i] - at[3, i]
        middle[i] = 0.25 * (at[0, i] + at[1, i] + at[2, i] + at[3, i])
    nx = across[1] * up[2] - across[2] * up[1]
    ny = across[2] * up[0] - across[0] * up[2]
    nz = across[0] * up[1] - across[1] * up[0]
    size = math.sqrt(
        (nx * nx + ny * ny + nz * nz) * (middle[0] ** 2 + middle[1] ** 2 + middle[2] ** 2)
    )
    return -(nx * middle[0] + ny * middle[1] + nz * middle[2]) / size


@inner
def _covered(boxes, extents, per_car, lens, at):
    """Return whether a part of the sender is in front of the marker's middle or of a point near a
    corner.
    """
    for k in range(5):
        x = 0.0
        y = 0.0
        z = 0.0
        for corner in range(4):
            weight = 0.25 if k == 4 else (0.925 if corner == k else 0.025)
            x = x + weight * at[corner, 0]
            y = y + weight * at[corner, 1]
            z = z + weight * at[corner, 2]
        u, v = distorted(lens, x / z, y / z)
        if nearest(boxes, extents, per_car, x / z, y / z, u, v, -1)[0] < z - PLATE_GAP_M:
            return True
    return False
