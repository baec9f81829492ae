"""Straight edges of a print in an image: the light of the pixels beside them, by their distance.

Such edges are long, and their places are known to a tenth of a pixel. So thousands of pixels beside
them show one edge at every fraction of a pixel: how a camera draws it, and where its pixels are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from path.arrays import Array, Image, Whole
from path.calibration.board import Board, BoardView
from path.camera.thinning import Thinning
from path.values import frozen

ENDS = 0.22  # of an edge's length that is left out at each end: corners look otherwise
# from an edge: how far its pixels count; and from where on they show noise alone
REACH_PX = 3.4
FLAT_PX = 1.9
BIN_PX = 0.125
LEAST_PIXELS = 20
LEAST_CONTRAST = 25.0
PLACES = np.arange(-REACH_PX + 0.5 * BIN_PX, REACH_PX, BIN_PX)
"""Distances from an edge at which it is measured, px: the middles of bins."""


@frozen(eq=False)
class SeenEdge:
    """Pixels beside one straight edge of a print, in one image.

    Attributes:
        across_px, along: of each pixel: distance, white side positive; 0..1 from one end to the
            other.
        levels: grey, 0..255. ``black``, ``white``: at both sides.
        pixels: (n, 2) columns and rows. ``normal``: (2,) towards the white side, in the image.
    """

    across_px: Array
    along: Array
    levels: Array
    black: float
    white: float
    pixels: Whole
    normal: Array


def see_edge(
    grey: Image,
    ends_px: Array,
    thinning: Thinning | None = None,
) -> SeenEdge | None:
    """The edge between two places (2, 2) in an image; None where it is not seen well.

    ``thinning``: how the camera leaves out pixels; the ends are then in its evenly spaced image.
    """
    start, end = ends_px
    way = end - start
    length = float(np.hypot(*way))
    low = np.floor(ends_px.min(axis=0) - REACH_PX).astype(int)
    high = np.ceil(ends_px.max(axis=0) + REACH_PX).astype(int)
    if length < 1.0 or low.min() < 0 or high[0] >= grey.shape[1] or high[1] >= grey.shape[0]:
        return None
    v, u = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    at_u, at_v = (u, v) if thinning is None else (thinning.places(u, 0), thinning.places(v, 1))
    du = at_u - start[0]
    dv = at_v - start[1]
    along = (du * way[0] + dv * way[1]) / length**2
    across = (dv * way[0] - du * way[1]) / length
    near = (along > ENDS) & (along < 1.0 - ENDS) & (np.abs(across) < REACH_PX)
    across = across[near]
    along = along[near]
    levels = grey[v[near], u[near]].astype(float)
    normal = np.array([-way[1], way[0]]) / length
    left = levels[across < -FLAT_PX]
    right = levels[across > FLAT_PX]
    if min(len(left), len(right)) < LEAST_PIXELS:
        return None
    if np.median(left) > np.median(right):
        across, normal, left, right = -across, -normal, right, left
    black = float(np.median(left))
    white = float(np.median(right))
    if white - black < LEAST_CONTRAST:
        return None
    across = across - _offset(across, (levels - black) / (white - black))
    pixels = np.column_stack([u[near], v[near]]).astype(np.int64)
    return SeenEdge(across, along, levels, black, white, pixels, normal)


def edges_between(
    grey: Image,
    view: BoardView,
    board: Board,
) -> Iterator[SeenEdge]:
    """The edges of a board's squares between neighbouring corners that were found."""
    columns = board.columns - 1
    places = dict(zip(view.ids.tolist(), view.corners_px, strict=True))
    for corner, here in places.items():
        beside = (
            [corner + columns]
            if corner % columns == columns - 1
            else [corner + 1, corner + columns]
        )
        for other in beside:
            if other in places:
                edge = see_edge(grey, np.stack([here, places[other]]))
                if edge is not None:
                    yield edge


def mean_edge(edges: Sequence[SeenEdge]) -> Array:
    """The share of white at ``PLACES``; nan where too few pixels lie."""
    across = np.concatenate([edge.across_px for edge in edges])
    share = np.concatenate([(e.levels - e.black) / (e.white - e.black) for e in edges])
    bins = np.digitize(across, _bins(BIN_PX)) - 1
    own = [share[bins == k] for k in range(len(PLACES))]
    return np.array(
        [float(np.median(some)) if len(some) >= LEAST_PIXELS else math.nan for some in own]
    )


def _offset(across: Array, share: Array) -> float:
    """The place of the edge, from the share of it that is white: the curve is symmetric enough."""
    sums, counts = (np.histogram(across, _bins(0.5), weights=w)[0] for w in (share, None))
    there = counts > 0
    return float(np.clip(REACH_PX * (1.0 - 2.0 * np.mean(sums[there] / counts[there])), -1.0, 1.0))


def _bins(step_px: float) -> Array:
    return np.arange(-REACH_PX, REACH_PX + 0.5 * step_px, step_px)
