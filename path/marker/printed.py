"""A quadrilateral held against the print that it should show: cell by cell, border and all.

A search looks at the middles of cells, forgives some, and takes its corners from outlines. So a
corner that something covers comes out where the cover ends, a marker on a plate that is as dark as
its frame gets the plate's outline, and sheets of other markers or the fur of an animal pass for
one. ``look`` says how much of the print is there, ``aligned`` puts the corners where all of it
together has them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from path.marker.kernels import Array

# a cell
LOOK_SAMPLES = 4
ALIGN_SAMPLES = 6
MARGIN = 2  # cells around the print that are brought along for aligning
FRAME_CUT = 0.34  # of a cell: outside of it the frame's edge may be the plate's, or covered
PASSES = 30
ENOUGH = 1e-3
MIN_CORRELATION = 0.6
# light of a border that is there; a plate of another grey begins too near below it
MIN_BORDER = 0.92
CLEARLY = 0.2  # of the contrast, from the middle grey level


class Look(NamedTuple):
    """What of a print is seen.

    Attributes:
        likeness: correlation of black frame and code with the print.
        wrong: share of their cells that are on the wrong side of the middle grey level.
        bits: cells of the code that are clearly so, however small and dim the image is.
        border: light on the cells around the frame: 0 as dark as the print's black, 1 as light as
            its white.
    """

    likeness: float
    wrong: float
    bits: int
    border: float


def look(grey: NDArray[np.uint8], quad: Array, pattern: Array) -> Look:
    """Compare an image with a print.

    Args:
        grey: uint8, (height, width).
        quad: the corners of the black frame, (4, 2) in pixels of ``grey``.
        pattern: cells of the print with a border of white ones, 0 black and 1 white.
    """
    s = LOOK_SAMPLES
    n = len(pattern)
    patch = _flattened(grey, quad, s, n - 2, 1)
    inner = patch[s:-s, s:-s]
    a = inner - inner.mean()
    b = _blurred(pattern.tobytes(), n)
    likeness = float((a * b).sum() / (np.sqrt((a * a).sum() * (b * b).sum()) + 1e-9))
    # edges of cells are blurred: only their middles are looked at
    shades = patch.reshape(n, s, n, s)[:, 1:-1, :, 1:-1].mean(axis=(1, 3))
    code = shades[1:-1, 1:-1]
    print_ = pattern[1:-1, 1:-1] > 0.5
    white = float(code[print_].mean())
    black = float(code[~print_].mean())
    above = (code - 0.5 * (white + black)) / max(white - black, 1e-9)
    off = np.where(print_, -above, above)
    wrong = float(np.mean(off > 0.0))
    bits = int(np.sum(off[1:-1, 1:-1] > CLEARLY))
    around = np.concatenate([shades[0, 1:-1], shades[-1, 1:-1], shades[1:-1, 0], shades[1:-1, -1]])
    border = (float(around.mean()) - black) / max(white - black, 1e-9)
    return Look(likeness, wrong, bits, border)


def aligned(grey: NDArray[np.uint8], quad: Array, pattern: Array) -> Array | None:
    """Return the corners where the inside of the print correlates best; None where nothing like it
    is near.

    Outside of the frame's middle nothing counts: neither a border that is missing nor a corner that
    is taken for the plate's. Good to some tenths of a pixel from corners that are off by a cell.
    Args as for ``look``.
    """
    s = ALIGN_SAMPLES
    n = len(pattern) - 2
    flat = np.asarray(_flattened(grey, quad, s, n, MARGIN), np.float32)
    wanted, cut = _inside(pattern.tobytes(), n)
    place = np.eye(3, dtype=np.float32)
    place[:2, 2] = s * MARGIN + cut
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, PASSES, ENOUGH)
    try:
        found: Any = cv2.findTransformECC(
            wanted,
            flat,
            place,
            cv2.MOTION_HOMOGRAPHY,
            criteria,
            None,  # type: ignore[call-overload]
            3,
        )
    except cv2.error:  # it does not converge
        return None
    likeness, place = found
    to_image = _homography(quad, s, n, MARGIN) @ place.astype(np.float64)
    square = s * n * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) - 0.5 - cut
    seen = np.column_stack([square, np.ones(4)]) @ to_image.T
    if not (likeness >= MIN_CORRELATION and np.all(np.isfinite(seen)) and np.all(seen[:, 2] > 0.0)):
        return None
    return np.ascontiguousarray(seen[:, :2] / seen[:, 2:])


def _homography(quad: Array, samples: int, cells: int, margin: int) -> Array:
    """From the print's plane, so many samples a cell and a margin of cells around, to the image."""
    low = samples * margin - 0.5
    high = samples * (margin + cells) - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    return np.asarray(cv2.getPerspectiveTransform(square, quad.astype(np.float32)), np.float64)


def _flattened(
    grey: NDArray[np.uint8], quad: Array, samples: int, cells: int, margin: int
) -> NDArray[np.float64]:
    """The image in the print's plane."""
    side = samples * (cells + 2 * margin)
    H = _homography(quad, samples, cells, margin)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(
        grey, H, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)


@lru_cache(maxsize=256)
def _blurred(pattern: bytes, n: int) -> NDArray[np.float64]:
    """The print without its border as ``look`` samples it, blurred a little, its mean taken off. Do
    not change it.
    """
    cells = np.frombuffer(pattern).reshape(n, n)[1:-1, 1:-1]
    seen = cv2.blur(np.kron(cells, np.ones((LOOK_SAMPLES, LOOK_SAMPLES))), (3, 3))
    return np.asarray(seen - seen.mean(), np.float64)


@lru_cache(maxsize=256)
def _inside(pattern: bytes, n: int) -> tuple[NDArray[np.float32], int]:
    """What ``aligned`` looks for, and how many samples of the frame it leaves out. Do not change
    it.
    """
    s = ALIGN_SAMPLES
    cut = round(FRAME_CUT * s)
    cells = np.frombuffer(pattern).reshape(n + 2, n + 2)
    seen = cv2.GaussianBlur(np.kron(255.0 * cells, np.ones((s, s))), (0, 0), 0.2 * s)
    inside = seen[s + cut : -s - cut, s + cut : -s - cut]
    return np.ascontiguousarray(inside, np.float32), cut
