"""Small numba routines of the photometric fit: scale of its residuals, its steps, its
covariance.
"""

from __future__ import annotations

import math

import numpy as np

from path.compiled import inner, kernel
from path.marker.kernels import Array, cholesky, cholesky_solve, distort
from path.marker.photometric.misfit import SHADOW, Places
from path.marker.photometric.pattern import BLUR, TONE, UNKNOWNS
from path.marker.photometric.print_pixels import corner_rays

Statistics = tuple[float, float, float, float]
"""Sum of weights, variance of the residual, share of the image explained, correlation of neighbours
in a row.
"""

START_BLUR_PX = 0.75  # an ordinary lens and pixel
FILTERED_BLUR_SIGMA_PX = 0.003  # beside the filter blur is as good as known: the filter can be one
SHADOW_DAMPING = 0.005
# in a step, of a shadow's depth, direction, offset, log width; of others
MOST_CHANGE = (0.2, 0.2, 0.15, 0.5, 1.0)
# of neighbouring residuals; counted in both directions, it divides the pixels by up to 9
MAX_CORRELATION = 0.5
# what a correlated residual as large as the contrast moves a corner; from photographs of boards
MISFIT_PX = 2.0
# more hides what moves a corner; less has too few pixels an edge
USUAL_BLUR_PX = 0.63
LEAST_BLUR_PX = 0.4
SHARP_MISFIT = 0.62  # the same where blur is less, times its power of 1.5 in px
SURE_CORRELATION = 0.18  # of neighbouring residuals, from which on they are no noise
# weights take 1.28 off the residual's variance; the rest is measured on exact images of markers
CONSISTENCY = 1.6


@kernel
def robust_scale(residuals: Array) -> float:
    """Robust standard deviation of the residuals (from their median size), at least half a grey
    level.
    """
    bins = np.zeros(512, np.int64)
    count = 0
    for k in range(residuals.shape[0]):
        if residuals[k] != 0.0:
            bins[min(511, int(abs(residuals[k]) * 4.0))] += 1
            count += 1
    half = count // 2
    total = 0
    for k in range(512):
        total += bins[k]
        if total > half:
            return max(0.5, 1.4826 * (k + 0.5) / 4.0)
    return 190.0


@kernel
def tones(pixels: Array) -> tuple[float, float]:
    """Black and contrast to start from: what 10 % of the pixels stay below, and how far above it 10
    % are.
    """
    bins = np.zeros(256, np.int64)
    total = 0
    for k in range(pixels.shape[0]):
        bins[int(pixels[k, 2])] += 1
    low = high = -1
    for k in range(256):
        total += bins[k]
        if low < 0 and total >= 0.1 * pixels.shape[0]:
            low = k
        if high < 0 and total >= 0.9 * pixels.shape[0]:
            high = k
    return float(low), float(high - low)


@inner
def _change(
    normal: Array,
    noise: float,
    theta: Array,
    extra: Array,
    used: Places,
    sigmas: Array,
    factor: Array,
) -> Array:
    """Right side of the normal equations with what is expected of the unknowns; their matrix into
    ``factor``.
    """
    size = normal.shape[0]
    change = np.empty(size)
    for i in range(size):
        change[i] = normal[i, size]
        for j in range(i + 1):
            factor[i, j] = normal[j, i]
        sigma = 0.0
        away = 0.0
        if i >= UNKNOWNS:
            sigma = sigmas[i - UNKNOWNS]
            away = extra[used[i - UNKNOWNS]]
        elif i > 8 and i != 11:
            sigma = 0.5 if i >= BLUR else 0.25 * max(abs(theta[11]), 1.0)
            away = theta[i] - (START_BLUR_PX if i == BLUR else 0.0)
            if i == BLUR and size > UNKNOWNS:
                sigma = FILTERED_BLUR_SIGMA_PX
                away = 0.0
        if sigma > 0.0:
            weight = (noise / sigma) ** 2
            factor[i, i] += weight
            change[i] -= weight * away
    # a wide shadow is almost a slope of the light
    if size > UNKNOWNS and used[-1] == extra.shape[0] - 1:
        for i in range(size):
            if 8 <= i < BLUR or i >= size - SHADOW:
                factor[i, i] *= 1.0 + SHADOW_DAMPING
    return change


@kernel
def step(
    normal: Array,
    noise: float,
    frame: Array,
    n: int,
    theta: Array,
    extra: Array,
    used: Places,
    sigmas: Array,
    factor: Array,
    corners: Array,
    jacobian: Array,
) -> float:
    """One Gauss-Newton step: changes the unknowns, ``corners``, their ``jacobian``; fills the
    Cholesky ``factor``.

    Weak priors keep tone, blur and the slope of light finite on tiny markers. The first 16 rows of
    ``normal`` are of ``theta``, the others of those of ``extra`` that are ``used``, with the
    deviations ``sigmas`` expected of them.

    Returns:
        The longest way a corner moved, px; 1e9 when there was no step.
    """
    size = normal.shape[0]
    change = _change(normal, noise, theta, extra, used, sigmas, factor)
    if not cholesky(factor):
        return 1e9
    cholesky_solve(factor, change)
    for i in range(UNKNOWNS):
        theta[i] += change[i]
    for i in range(UNKNOWNS, size):
        at = used[i - UNKNOWNS]
        most = MOST_CHANGE[max(at - extra.shape[0] + SHADOW, -1)]
        extra[at] += min(max(change[i], -most), most)
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


@kernel
def statistics(pixels: Array, residuals: Array, spread: float, used: int) -> Statistics:
    """Sum of weights, variance of the residual, share of the image explained, correlation of
    neighbours in a row.
    """
    total = squares = grey = grey2 = beside = near = 0.0
    w_before = 0.0
    for k in range(pixels.shape[0]):
        r = residuals[k]
        if r == 0.0:
            w_before = 0.0
            continue
        w = 1.0 / (1.0 + (r / spread) ** 2) ** 2
        total = total + w
        squares = squares + w * r * r
        grey = grey + w * pixels[k, 2]
        grey2 = grey2 + w * pixels[k, 2] ** 2
        if pixels[k, 3] > 0.5:
            pair = math.sqrt(w * w_before)
            beside += pair * r * residuals[k - 1]
            near += pair * 0.5 * (r * r + residuals[k - 1] ** 2)
        w_before = w
    variance = squares / max(total - used, 1.0)
    # few pixels are explained by as many unknowns, whatever they show: each takes one
    explained = 1.0 - variance * max(total - 1.0, 1.0) / max(grey2 - grey * grey / total, 1e-9)
    correlation = min(max(beside / near, 0.0), MAX_CORRELATION) if near > 0.0 else 0.0
    return total, variance, explained, correlation


@kernel
def finish(
    factor: Array,
    measured: Statistics,
    lens: Array,
    frame: Array,
    contrast: float,
    blur_px: float,
    corners: Array,
    jacobian: Array,
    covariance: Array,
) -> None:
    """Turn ``corners`` from rays into pixels and fill ``covariance``."""
    _, variance, _, correlation = measured
    # of a camera that leaves out pixels: it is those of its sensor that are too few or not
    if lens[12] > 0.0:
        blur_px *= lens[13] / lens[12]
    sharp = (
        min(correlation / SURE_CORRELATION, 1.0) * SHARP_MISFIT / max(blur_px, LEAST_BLUR_PX) ** 1.5
    )
    soft = MISFIT_PX * math.sqrt(correlation) * max(1.0, blur_px / USUAL_BLUR_PX)
    misfit_px = max(sharp, soft) * math.sqrt(variance) / contrast
    variance_used = CONSISTENCY * variance * ((1.0 + correlation) / (1.0 - correlation)) ** 2
    for k in range(4):
        u, v, ux, uy, vx, vy = distort(
            corners[k, 0] / frame[4] + frame[2], corners[k, 1] / frame[4] + frame[3], lens
        )
        corners[k, 0], corners[k, 1] = u, v
        for j in range(8):
            p = jacobian[2 * k, j] / frame[4]
            q = jacobian[2 * k + 1, j] / frame[4]
            jacobian[2 * k, j], jacobian[2 * k + 1, j] = ux * p + uy * q, vx * p + vy * q
    column = np.empty(factor.shape[0])
    for i in range(8):
        for k in range(column.shape[0]):
            column[k] = jacobian[i, k] if k < 8 else 0.0
        cholesky_solve(factor, column)
        for j in range(8):
            s = 0.0
            for k in range(8):
                s += jacobian[j, k] * column[k]
            covariance[i, j] = s * variance_used
        covariance[i, i] += misfit_px * misfit_px
