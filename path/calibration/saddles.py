"""Corners of a chessboard to a few hundredths of a pixel: the image around each is fitted as a
whole.

Around a corner where four squares meet, the image is ``m + c E(s1 / b1) E(s2 / b2)``: s1, s2 are
the distances from the two edges, b1, b2 the blur across them, E the integral of a Gaussian from -1
to 1. The image is the same when it is turned by half a turn about the corner, whatever blur, ink,
sharpening and tone curve do to it: none of them moves the corner.
"""

from __future__ import annotations

import numpy as np

from path.arrays import Array, Flags, Image
from path.camera.thinning import Thinning
from path.values import frozen

REACH_PX = (2.5, 8.0)  # radius of what is fitted
ITERATIONS = 12
FIRST_BLUR_PX = 0.8
BLUR_PX = (0.25, 6.0)
MOST_STEP_PX = 0.5
MOST_MOVED_PX = 2.5
MOST_LEFT = 0.25  # largest rms residual of a fit, as a share of its contrast
LEAST_CONTRAST = 8.0  # grey levels
UNKNOWNS = 8  # u, v, two angles, two blurs, mean, contrast


@frozen(eq=False)
class Saddles:
    """Refined corners, n of them; ``good``: (n,) where the fit can be trusted. The rest as in
    ``BoardView``.
    """

    corners_px: Array
    sigma_px: Array
    blur_px: Array
    good: Flags


def refine_saddles(
    grey: Image,
    corners_px: Array,
    edges: Array,
    clear_px: Array,
    thinning: Thinning | None = None,
) -> Saddles:
    """Fit the image around each corner.

    Args:
        grey: (h, w).
        corners_px: (n, 2), where to start.
        edges: (n, 2, 2), unit directions of the two edges that cross there.
        clear_px: (n,), radius within which nothing else is printed.
        thinning: how the camera leaves out pixels; corners come out in its evenly spaced image.
    """
    height, width = grey.shape
    radius = np.clip(clear_px, *REACH_PX)
    reach = int(np.ceil(radius.max(initial=REACH_PX[0])))
    middle = np.round(corners_px).astype(np.int64)
    offsets = np.arange(-reach, reach + 1)
    du, dv = (o.ravel() for o in np.meshgrid(offsets, offsets))
    columns = middle[:, :1] + du
    rows = middle[:, 1:] + dv
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    levels = grey[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float64)
    distance = np.hypot(columns - corners_px[:, :1], rows - corners_px[:, 1:])
    weights = np.clip(radius[:, None] + 0.5 - distance, 0.0, 1.0) * inside
    whole = ((middle >= reach) & (middle < np.array([width, height]) - reach)).all(axis=1)
    if thinning is not None:
        columns = thinning.places(columns, 0)
        rows = thinning.places(rows, 1)
        corners_px = thinning.even(corners_px)
    columns = columns.astype(np.float64)
    rows = rows.astype(np.float64)
    state = _start(levels, weights, corners_px, edges, columns, rows)
    for _ in range(ITERATIONS):
        state = _stepped(state, levels, weights, columns, rows)
    return _judged(
        state,
        levels,
        weights,
        columns,
        rows,
        corners_px,
        whole & (clear_px >= REACH_PX[0]),
    )


def _start(
    levels: Array,
    weights: Array,
    corners: Array,
    edges: Array,
    columns: Array,
    rows: Array,
) -> Array:
    """Unknowns (n, 8): u, v, angle of the normal of each edge, blur across each, mean, contrast."""
    normals = np.arctan2(edges[:, :, 0], -edges[:, :, 1])
    state = np.empty((len(corners), UNKNOWNS))
    state[:, :2], state[:, 2:4], state[:, 4:6] = corners, normals, FIRST_BLUR_PX
    state[:, 6], state[:, 7] = 0.0, 1.0
    shape, _ = _model(state, columns, rows)
    total = weights.sum(axis=1)
    mean_level = (weights * levels).sum(axis=1) / total
    mean_shape = (weights * shape).sum(axis=1) / total
    centred = shape - mean_shape[:, None]
    spread = (weights * centred * centred).sum(axis=1)
    state[:, 7] = (weights * centred * levels).sum(axis=1) / np.maximum(spread, 1e-9)
    state[:, 6] = mean_level - state[:, 7] * mean_shape
    return state


def _model(
    state: Array,
    columns: Array,
    rows: Array,
) -> tuple[Array, Array]:
    """The image (n, p), and its derivatives by the unknowns (n, p, 8)."""
    x = columns - state[:, :1]
    y = rows - state[:, 1:2]
    mean = state[:, 6:7]
    contrast = state[:, 7:8]
    jacobian = np.empty((*x.shape, UNKNOWNS))
    steps: list[tuple[Array, Array, Array, Array, Array]] = []
    for k in (0, 1):
        cos = np.cos(state[:, 2 + k : 3 + k])
        sin = np.sin(state[:, 2 + k : 3 + k])
        blur = state[:, 4 + k : 5 + k]
        s = (cos * x + sin * y) / blur
        slope = np.sqrt(2.0 / np.pi) * np.exp(-0.5 * s * s) / blur
        steps.append((_step(s), slope, cos, sin, s))
    for k in (0, 1):
        _, slope, cos, sin, s = steps[k]
        other = contrast * steps[1 - k][0] * slope
        if k == 0:
            jacobian[..., 0], jacobian[..., 1] = -cos * other, -sin * other
        else:
            jacobian[..., 0] -= cos * other
            jacobian[..., 1] -= sin * other
        jacobian[..., 2 + k] = other * (cos * y - sin * x)
        jacobian[..., 4 + k] = -other * s
    shape = steps[0][0] * steps[1][0]
    jacobian[..., 6], jacobian[..., 7] = 1.0, shape
    return mean + contrast * shape, jacobian


def _step(s: Array) -> Array:
    """erf(s / sqrt 2), to 2e-7 (Abramowitz and Stegun 7.1.26)."""
    z = np.abs(s) * np.sqrt(0.5)
    t = 1.0 / (1.0 + 0.3275911 * z)
    series = t * (
        0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))
    )
    return np.copysign(1.0 - series * np.exp(-z * z), s)


def _normal_equations(
    state: Array,
    levels: Array,
    weights: Array,
    columns: Array,
    rows: Array,
) -> tuple[Array, Array, Array]:
    """Information (n, 8, 8), gradient (n, 8), residuals (n, p)."""
    image, jacobian = _model(state, columns, rows)
    left = levels - image
    weighted = jacobian * weights[..., None]
    return (
        np.swapaxes(weighted, 1, 2) @ jacobian,
        (np.swapaxes(weighted, 1, 2) @ left[..., None])[..., 0],
        left,
    )


def _stepped(
    state: Array,
    levels: Array,
    weights: Array,
    columns: Array,
    rows: Array,
) -> Array:
    """One step of Gauss and Newton, slightly damped, with limits on how far it goes."""
    information, gradient, _ = _normal_equations(state, levels, weights, columns, rows)
    diagonal = np.einsum("nii->ni", information)
    diagonal += 1e-3 * diagonal + 1e-9
    step = np.linalg.solve(information, gradient[..., None])[..., 0]
    step[:, :2] = np.clip(step[:, :2], -MOST_STEP_PX, MOST_STEP_PX)
    step[:, 2:4] = np.clip(step[:, 2:4], -0.2, 0.2)
    step[:, 4:6] = np.clip(step[:, 4:6], -0.4, 0.4)
    stepped = state + step
    stepped[:, 4:6] = np.clip(stepped[:, 4:6], *BLUR_PX)
    return stepped


def _judged(
    state: Array,
    levels: Array,
    weights: Array,
    columns: Array,
    rows: Array,
    start: Array,
    whole: Flags,
) -> Saddles:
    information, _, left = _normal_equations(state, levels, weights, columns, rows)
    diagonal = np.einsum("nii->ni", information)
    diagonal += 1e-9 * diagonal + 1e-12
    variance = (weights * left * left).sum(axis=1) / np.maximum(weights.sum(axis=1) - UNKNOWNS, 1.0)
    covariance = np.linalg.inv(information)[:, :2, :2] * variance[:, None, None]
    sigma = np.sqrt(0.5 * np.einsum("nii->n", covariance))
    contrast = np.abs(state[:, 7])
    moved = np.linalg.norm(state[:, :2] - start, axis=1)
    good = whole & (contrast >= LEAST_CONTRAST) & (np.sqrt(variance) <= MOST_LEFT * contrast)
    good &= (moved <= MOST_MOVED_PX) & np.isfinite(sigma)
    return Saddles(state[:, :2].copy(), sigma, state[:, 4:6].max(axis=1), good)
