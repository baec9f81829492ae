"""Pixels that a camera leaves out, told by straight edges of a board, and its calibration with
them.

Edges are drawn with steps where pixels are not evenly spaced, and corners are off by as much as
their few pixels are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from path.arrays import Array, Image
from path.calibration.board import Board, BoardView, find_board
from path.calibration.edges import PLACES, SeenEdge, edges_between, mean_edge
from path.camera.thinning import Thinning

# a period of the image; times as many of the sensor
MOST_KEPT = 5
MOST_OF = 3
STEEP_PX = 1.3  # from an edge: where the light tells a pixel's place
LEAST_OFF_PX = 0.04  # rms of the places of an image that is thinned out
MOST_LEFT = 0.5  # of what the pixels are off, share that a thinning may leave unexplained
FEWEST_PIXELS = 500


def seen_evenly(
    images: Sequence[Image],
    views: Sequence[BoardView],
    board: Board,
) -> tuple[list[BoardView], Thinning] | None:
    """The views with their corners in the evenly spaced image, and how the camera leaves out
    pixels; None: it does not.

    ``images``: of which the views are.
    """
    edges = [
        edge
        for grey, view in zip(images, views, strict=True)
        for edge in edges_between(grey, view, board)
    ]
    thinning = measure_thinning(edges) if edges else None
    if thinning is None:
        return None
    again = [find_board(grey, board, thinning) for grey in images]
    return [old if new is None else new for old, new in zip(views, again, strict=True)], thinning


def measure_thinning(edges: Sequence[SeenEdge]) -> Thinning | None:
    """The thinning out that the pixels beside edges show; None for an image whose pixels are evenly
    spaced.
    """
    edge = mean_edge(edges)
    for kept in range(2, MOST_KEPT + 1):
        offsets = pixel_offsets(edges, edge, kept)
        if offsets is None or float(np.sqrt(np.mean(offsets**2))) < LEAST_OFF_PX:
            continue
        ratios = (of for of in range(kept + 1, MOST_OF * kept) if math.gcd(of, kept) == 1)
        tried = [
            Thinning(kept, of, (column, row))
            for of in ratios
            for column in range(kept)
            for row in range(kept)
        ]
        left = [_left(thinning, offsets) for thinning in tried]
        if min(left) <= MOST_LEFT * float((offsets**2).sum()):
            return tried[int(np.argmin(left))]
    return None


def pixel_offsets(
    edges: Sequence[SeenEdge],
    edge: Array,
    period: int,
) -> Array | None:
    """By how much pixels lie off their places, by column and row modulo ``period``: (2, period) px,
    of mean 0.

    The light at a pixel beside an edge tells where the pixel is. What all pixels of one edge have
    in common is the edge's own place.

    Args:
        edge: the mean edge, at ``path.calibration.edges.PLACES``.
    """
    there = ~np.isnan(edge)
    if np.count_nonzero(there) < 2:
        return None  # too few pixels for a mean edge
    slope = np.gradient(edge[there], PLACES[there])
    normal = np.zeros((2 * period, 2 * period))
    pulls = np.zeros(2 * period)
    count = 0
    for one in edges:
        near = np.abs(one.across_px) < STEEP_PX
        across = one.across_px[near]
        pixels = one.pixels[near]
        steep = np.interp(across, PLACES[there], slope)
        left = (one.levels[near] - one.black) / (one.white - one.black) - np.interp(
            across,
            PLACES[there],
            edge[there],
        )
        design = np.zeros((len(across), 2 * period))
        for axis in (0, 1):
            design[np.arange(len(across)), axis * period + pixels[:, axis] % period] = (
                steep * one.normal[axis]
            )
        along = steep / max(float(np.linalg.norm(steep)), 1e-9)
        design -= np.outer(along, along @ design)
        left = left - along * float(along @ left)
        normal += design.T @ design
        pulls += design.T @ left
        count += len(across)
    if count < FEWEST_PIXELS:
        return None
    offsets = (np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ pulls).reshape(2, period)
    return offsets - offsets.mean(axis=1, keepdims=True)


def _left(thinning: Thinning, offsets: Array) -> float:
    off = np.stack([thinning.offsets_px(axis) for axis in (0, 1)])
    return float(((off - off.mean(axis=1, keepdims=True) - offsets) ** 2).sum())
