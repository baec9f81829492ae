"""The accuracy of corners on a photograph, without its pose: what one board cannot explain of them.

One homography of the board (the markers' side free) and a smooth term, polynomials of fourth order in the board's
coordinates for lens and paper, are fitted to all corners. The residual is the error of the corners, and whatever of
the paper is not so smooth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.geometry.transforms import Matrix

ORDER = 4
PASSES = 8
STEP = 1e-6  # of the numerical derivatives, relative
CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])  # of a side, y down, as OpenCV counts them

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """The residuals of corners.

    Attributes:
        errors_px: (n, 4, 2), found minus explained, in distorted pixels.
        side_m: of the markers, estimated. ``fitted``: number of unknowns fitted.
    """

    errors_px: Array
    side_m: float
    fitted: int


def measure(corners_px: Array, centres_m: Matrix, side_m: float, camera: CameraModel, order: int = ORDER) -> Left:
    """Corners (n, 4, 2) against the best board.

    Args:
        centres_m: (n, 2), x right and y down as printed. ``side_m``: to start from.
        order: of the smooth residual; 0 for a shift alone, which changes nothing.
    """
    found = corners_px.reshape(-1, 2)
    middle, reach = centres_m.mean(axis=0), max(float(np.ptp(centres_m, axis=0).max()) / 2.0, side_m)
    centres = (centres_m - middle) / reach

    def points(side: float) -> Array:
        return (centres[:, None] + side / reach * CORNERS).reshape(-1, 2)

    def explained(unknowns: Array) -> Array:
        p = np.column_stack([points(float(unknowns[8]) * side_m), np.ones(len(found))])
        h = p @ np.append(unknowns[:8], 1.0).reshape(3, 3).T
        return camera.project(np.column_stack([h[:, :2] / h[:, 2:], np.ones(len(found))]))

    H, _ = cv2.findHomography(points(side_m), camera.rays(found))
    unknowns: Array = np.append((H / H[2, 2]).ravel()[:8], 1.0).astype(np.float64)
    x, y = points(side_m).T
    smooth = np.column_stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])
    both, slopes = np.kron(smooth, np.eye(2)), np.zeros((0, 9))  # rows u, v of each corner
    for _ in range(PASSES):
        predicted = explained(unknowns)
        slopes = np.column_stack([_slope(explained, predicted, unknowns, k) for k in range(9)])
        unknowns += np.linalg.lstsq(slopes, (found - predicted).ravel(), rcond=None)[0]
    error = (found - explained(unknowns)).ravel()
    design = np.column_stack([slopes[:, 8], both])  # the smooth residual can be all that the homography can
    solution = np.linalg.lstsq(design, error, rcond=None)[0]
    side = float(unknowns[8] + solution[0]) * side_m
    return Left((error - design @ solution).reshape(corners_px.shape), side, design.shape[1])


def _slope(explained: Callable[[Array], Array], predicted: Array, unknowns: Array, k: int) -> Array:
    step = np.zeros(9)
    step[k] = STEP * max(1.0, abs(float(unknowns[k])))
    return ((explained(unknowns + step) - predicted) / step[k]).ravel()
