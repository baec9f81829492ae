"""Features of two images matched, and matches verified: do they move together as one surface
does?
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from path.arrays import Depths, Flags, Image, Singles
from path.baselines.features import Distance, Keypoints
from path.values import frozen

Model = Literal["similarity", "affine", "homography", "epipolar"]
Pairs = NDArray[np.int64]

MIN_PAIRS: dict[Model, int] = {"similarity": 2, "affine": 3, "homography": 4, "epipolar": 8}
CONFIDENCE = 0.995
ITERATIONS = 1000


@frozen
class MatchConfig:
    """
    Attributes:
        ratio: the best match's distance must be below this share of the second best's (Lowe); 1
            takes every one.
        min_cosine: of descriptors compared by their cosine; below it is no match.
        max_hamming: of descriptors of bits; above it is no match.
        model: what the matches of one surface have in common.
        reach_px: how far from the model a match may be, in pixels of the second image.
    """

    ratio: float = 0.85
    min_cosine: float = -1.0
    max_hamming: int = 80
    model: Model = "affine"
    reach_px: float = 4.0


@frozen(eq=False)
class Nearest:
    """The nearest neighbours in ``b`` of ``a``'s n features; empty when either has none.

    Attributes:
        rows: (n,) indices into ``a``.
        best: (n,) indices into ``b``.
        mutual: (n,) whether it is also the other way round.
        apart, second: (n,) distance of that one and of the next best, inf when there is none.
    """

    rows: NDArray[np.int64]
    best: NDArray[np.int64]
    mutual: Flags
    apart: Singles
    second: Singles


def nearest(
    a: Keypoints,
    b: Keypoints,
    distance: Distance,
) -> Nearest:
    """The part of matching that does not depend on thresholds."""
    if len(a) == 0 or len(b) == 0:
        none = np.zeros(0, np.int64)
        nothing = np.zeros(0, np.float32)
        return Nearest(none, none, np.zeros(0, np.bool_), nothing, nothing)
    if distance == "cosine":
        apart = np.sqrt(np.maximum(0.0, 2.0 - 2.0 * (a.descriptors @ b.descriptors.T)))
    else:
        apart = hamming(a.descriptors, b.descriptors).astype(np.float32)
    rows = np.arange(len(a))
    best = apart.argmin(axis=1)
    mutual = apart.argmin(axis=0)[best] == rows
    first = apart[rows, best]
    apart[rows, best] = np.inf
    return Nearest(rows, best, mutual, first, apart.min(axis=1))


def accepted(
    found: Nearest,
    distance: Distance,
    config: MatchConfig,
) -> Pairs:
    """Pairs (m, 2) of indices into ``a`` and ``b``: each the other's best match, and much better
    than the second best.

    The ratio is that of bits that differ, or of the angles' chords for descriptors of unit length.
    """
    cosine = distance == "cosine"
    limit = float(np.sqrt(2.0 - 2.0 * config.min_cosine)) if cosine else float(config.max_hamming)
    good = found.mutual & (found.apart <= limit)
    if config.ratio < 1.0:
        good &= found.apart < config.ratio * found.second
    return np.column_stack((found.rows[good], found.best[good]))


def hamming(a: Image, b: Image) -> Depths:
    """Number of bits that differ, (n, m), of (n, bytes) and (m, bytes)."""
    words_a = a.view(np.uint64)
    words_b = b.view(np.uint64)
    total = np.zeros((len(a), len(b)), np.uint16)
    for word in range(words_a.shape[1]):
        total += np.bitwise_count(words_a[:, word, None] ^ words_b[None, :, word])
    return total


def verify(
    a: Keypoints,
    b: Keypoints,
    pairs: Pairs,
    config: MatchConfig,
    seed: int = 0,
) -> Flags:
    """Return which pairs (m,) are inliers of the model that most of them agree with; none when
    there are too few.
    """
    nothing = np.zeros(len(pairs), np.bool_)
    if len(pairs) < MIN_PAIRS[config.model]:
        return nothing
    cv2.setRNGSeed(seed & 0x7FFFFFFF)
    mask = _inliers(a.points_px[pairs[:, 0]], b.points_px[pairs[:, 1]], config)
    return nothing if mask is None or len(mask) != len(pairs) else mask.ravel() != 0


def _inliers(
    a: Singles,
    b: Singles,
    config: MatchConfig,
) -> NDArray[Any] | None:
    reach = config.reach_px
    if config.model == "similarity":
        return cv2.estimateAffinePartial2D(a, b, None, cv2.RANSAC, reach, ITERATIONS, CONFIDENCE)[1]
    if config.model == "affine":
        return cv2.estimateAffine2D(a, b, None, cv2.RANSAC, reach, ITERATIONS, CONFIDENCE)[1]
    if config.model == "homography":
        return cv2.findHomography(a, b, cv2.USAC_MAGSAC, reach, None, ITERATIONS, CONFIDENCE)[1]
    return cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, reach, CONFIDENCE, ITERATIONS)[1]
