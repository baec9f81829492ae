"""Corners of a marker from a fit of its whole image, not of its edges.

Gauss-Newton with robust weights on the model of ``path.marker.pattern``. The normal matrix, the size of the residual
and how far it is correlated from pixel to pixel give the covariance of the corners: what the model cannot explain
(sharpening, ink spread) is correlated, and counts for fewer pixels than it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from path.camera import CameraModel
from path.marker.kernels import Array, cholesky, cholesky_solve, distort, lens_of
from path.marker.pattern import BLUR, TONE, UNKNOWNS, accumulate
from path.marker.print_pixels import Gray, corner_rays, frame_of, gather, homography

START_BLUR_PX = 0.75  # an ordinary lens and pixel
MAX_PASSES = 8
MAX_DRIFT_PX = 3.0  # a step longer than this is not a refinement
REGATHER_PX = 0.2  # after a step longer than this the pixels of the print are chosen anew
SETTLED_PX = 0.03  # a step shorter than this is followed by none that matters
UNSETTLED_PX = 0.15  # longest last step of a fit that creeps towards its end
MAX_CORRELATION = 0.5  # of neighbouring residuals; counted in both directions, it divides the pixels by up to 9
MISFIT_PX = 2.5  # what a correlated residual as large as the contrast moves a corner; from a real, sharpened photograph
CONSISTENCY = 1.6  # weights take 1.28 off the residual's variance; the rest is measured on exact images of markers


@dataclass(frozen=True, slots=True)
class PhotometricFit:
    """Corners with what tells whether to trust them.

    Attributes:
        corners_px: shape (4, 2), distorted camera pixels.
        covariance_px2: shape (8, 8).
        residual: standard deviation of the robust residual, grey levels.
        contrast: white minus black at the centre, grey levels.
        blur_px: standard deviation of the blur, pixel area included.
        explained: share of the image's variance that the model explains, 0..1.
        passes: Gauss-Newton passes used.
    """

    corners_px: Array
    covariance_px2: Array
    residual: float
    contrast: float
    blur_px: float
    explained: float
    passes: int


def fit(
    image: Gray, offset: tuple[int, int], start_px: Array, camera: CameraModel, cells: Array
) -> PhotometricFit | None:
    """Fit the printed pattern to a grey image.

    Args:
        image: uint8, C-contiguous, shape (h, w); its pixel (0, 0) is the camera's pixel ``offset``.
        start_px: corners to start from, shape (4, 2), C-contiguous, distorted camera pixels, good to about a pixel.
        cells: pattern with a border of white cells, shape (cells + 2, cells + 2).

    Returns:
        None when the fit does not converge or too few pixels show the print.
    """
    n = cells.shape[0] - 2
    lens = lens_of(camera)
    frame, rays, theta = np.empty(9), np.empty((4, 2)), np.zeros(UNKNOWNS)
    theta[BLUR] = START_BLUR_PX
    if not frame_of(start_px, lens, frame, rays) or not homography(rays, n, theta):
        return None
    pixels = gather(image, offset[0], offset[1], frame, lens, theta, n, START_BLUR_PX)
    if len(pixels) < 3 * UNKNOWNS:
        return None
    low, high = np.percentile(pixels[:, 2], (10.0, 90.0))
    theta[8], theta[11] = low, high - low
    corners, jacobian = rays.copy(), np.empty((8, 8))
    normal, factor = np.empty((UNKNOWNS, UNKNOWNS + 1)), np.empty((UNKNOWNS, UNKNOWNS))
    spread, moved, passes, residuals = 1e3, math.inf, 0, np.empty(0)
    for passes in range(1, MAX_PASSES + 1):
        residuals = np.empty(len(pixels))
        accumulate(pixels, theta, frame, cells, spread, normal, residuals)
        noise = robust_scale(residuals)
        spread = 4.0 * noise
        moved = step(normal, noise, frame, n, theta, factor, corners, jacobian)
        if moved >= MAX_DRIFT_PX:
            return None
        if passes > 1 and moved < SETTLED_PX:
            break
        if moved > REGATHER_PX:
            pixels = gather(image, offset[0], offset[1], frame, lens, theta, n, theta[BLUR])
            if len(pixels) < 3 * UNKNOWNS:
                return None
    if moved > UNSETTLED_PX:
        return None
    covariance = np.empty((8, 8))
    residual, explained = finish(
        pixels, residuals, factor, lens, frame, spread, theta[11], corners, jacobian, covariance
    )
    return PhotometricFit(corners, covariance, residual, float(theta[11]), float(theta[BLUR]), explained, passes)


@njit(cache=True, nogil=True, error_model="numpy")
def robust_scale(residuals: Array) -> float:
    """Robust standard deviation of the residuals (from their median size), at least half a grey level."""
    bins = np.zeros(512, np.int64)
    count = 0
    for k in range(residuals.shape[0]):
        if residuals[k] != 0.0:
            bins[min(511, int(abs(residuals[k]) * 4.0))] += 1
            count += 1
    half, total = count // 2, 0
    for k in range(512):
        total += bins[k]
        if total > half:
            return max(0.5, 1.4826 * (k + 0.5) / 4.0)
    return 190.0


@njit(cache=True, nogil=True, error_model="numpy")
def step(
    normal: Array, noise: float, frame: Array, n: int, theta: Array, factor: Array, corners: Array, jacobian: Array
) -> float:
    """One Gauss-Newton step: changes ``theta``, ``corners`` and their ``jacobian``; keeps the Cholesky ``factor``.

    Weak priors keep tone, blur and the slope of light finite on tiny markers.

    Returns:
        The longest way a corner moved, px; 1e9 when there was no step.
    """
    change = np.empty(UNKNOWNS)
    for i in range(UNKNOWNS):
        change[i] = normal[i, UNKNOWNS]
        for j in range(UNKNOWNS):
            factor[i, j] = normal[i, j]
        if i > 8 and i != 11:
            sigma = 0.5 if i >= BLUR else 0.25 * max(abs(theta[11]), 1.0)
            weight = (noise / sigma) ** 2
            factor[i, i] += weight
            change[i] -= weight * (theta[i] - (START_BLUR_PX if i == BLUR else 0.0))
    if not cholesky(factor):
        return 1e9
    cholesky_solve(factor, change)
    for i in range(UNKNOWNS):
        theta[i] += change[i]
    theta[BLUR] = min(max(theta[BLUR], 0.3), 3.0)
    theta[TONE] = min(max(theta[TONE], -0.8), 0.8)
    before = corners.copy()
    corner_rays(theta, n, corners, jacobian)
    px = 1.0 / math.sqrt(abs(frame[5] * frame[8] - frame[6] * frame[7]))
    moved = 0.0
    for k in range(4):
        for j in range(2):
            way = abs(corners[k, j] - before[k, j]) * px
            moved = max(moved, way if way < 1e9 else 1e9)  # NaN is too far
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def finish(
    pixels: Array,
    residuals: Array,
    factor: Array,
    lens: Array,
    frame: Array,
    spread: float,
    contrast: float,
    corners: Array,
    jacobian: Array,
    covariance: Array,
) -> tuple[float, float]:
    """Turn ``corners`` from rays into pixels and fill ``covariance``; returns the residual and the share explained."""
    total = squares = grey = grey2 = beside = near = 0.0
    w_before = 0.0
    for k in range(pixels.shape[0]):
        r = residuals[k]
        if r == 0.0:
            w_before = 0.0
            continue
        w = 1.0 / (1.0 + (r / spread) ** 2) ** 2
        total, squares = total + w, squares + w * r * r
        grey, grey2 = grey + w * pixels[k, 2], grey2 + w * pixels[k, 2] ** 2
        if pixels[k, 3] > 0.5:
            pair = math.sqrt(w * w_before)
            beside += pair * r * residuals[k - 1]
            near += pair * 0.5 * (r * r + residuals[k - 1] ** 2)
        w_before = w
    variance = squares / max(total - UNKNOWNS, 1.0)
    explained = 1.0 - squares / max(grey2 - grey * grey / total, 1e-9)
    correlation = min(max(beside / near, 0.0), MAX_CORRELATION) if near > 0.0 else 0.0
    variance_used = CONSISTENCY * variance * ((1.0 + correlation) / (1.0 - correlation)) ** 2
    for k in range(4):
        u, v, ux, uy, vx, vy = distort(corners[k, 0] / frame[4] + frame[2], corners[k, 1] / frame[4] + frame[3], lens)
        corners[k, 0], corners[k, 1] = u, v
        for j in range(8):
            p, q = jacobian[2 * k, j] / frame[4], jacobian[2 * k + 1, j] / frame[4]
            jacobian[2 * k, j], jacobian[2 * k + 1, j] = ux * p + uy * q, vx * p + vy * q
    column = np.empty(UNKNOWNS)
    for i in range(8):
        for k in range(UNKNOWNS):
            column[k] = jacobian[i, k] if k < 8 else 0.0
        cholesky_solve(factor, column)
        for j in range(8):
            s = 0.0
            for k in range(8):
                s += jacobian[j, k] * column[k]
            covariance[i, j] = s * variance_used
        covariance[i, i] += correlation * variance * (MISFIT_PX / contrast) ** 2
    return math.sqrt(variance), explained
