"""A camera that makes its images smaller by leaving out pixels, found on straight edges of a board.

A sensor of 1280x800 pixels that is to give 640x480 keeps three of five rows and columns where it does not compute. The
pixels of such an image are not evenly spaced: of every three, one lies where it should, and two are off by a fifth of a
pixel towards each other or away. Edges are drawn with steps; corners are off by as much as their few pixels are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

MOST_KEPT, MOST_OF = 5, 3  # a period of the image; times as many of the sensor
STEEP_PX = 1.3  # from an edge: where the light tells a pixel's place
LEAST_OFF_PX = 0.04  # rms of the places of an image that is thinned out
MOST_LEFT = 0.5  # of what the pixels are off, share that a thinning may leave unexplained
FEWEST_PIXELS = 500

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class EdgePixels(Protocol):
    """Pixels beside one straight edge: distances from it, white side positive, and places (n, 2) in the image.

    ``levels``: grey; ``black``, ``white``: at both sides. ``normal``: (2,) towards the white side, in the image.
    """

    @property
    def across_px(self) -> Array: ...
    @property
    def pixels(self) -> Indices: ...
    @property
    def levels(self) -> Array: ...
    @property
    def black(self) -> float: ...
    @property
    def white(self) -> float: ...
    @property
    def normal(self) -> Array: ...


@dataclass(frozen=True, slots=True)
class Thinning:
    """``kept`` of every ``of`` rows and columns of the sensor are in the image: those nearest to the image's pixels.

    Attributes:
        begins: where the pattern begins, (column, row) of the image.
    """

    kept: int
    of: int
    begins: tuple[int, int]

    def sensor_pixels(self, count: int, axis: int) -> Indices:
        """Columns (axis 0) or rows of the sensor that the image's first ``count`` are; the first is 0."""
        return self._lines(count, axis) - self._lines(1, axis)[0]

    def sensor_place(self, place_px: float, axis: int) -> float:
        """Where a place of the evenly spaced image is on the sensor."""
        from_begin = (place_px + 0.5 - self.begins[axis]) * self.of / self.kept
        return float(from_begin - 0.5 - self._lines(1, axis)[0])

    def offsets_px(self, axis: int) -> Array:
        """By how much each of ``kept`` pixels lies off its place in the image, (kept,) px."""
        middles = (self._lines(self.kept, axis) + 0.5) * self.kept / self.of
        return middles - (np.arange(self.kept) - self.begins[axis] + 0.5)

    def _lines(self, count: int, axis: int) -> Indices:
        return np.floor((np.arange(count) - self.begins[axis] + 0.5) * self.of / self.kept + 1e-9).astype(np.int64)


def measure_thinning(edges: Sequence[EdgePixels], places: Array, edge: Array) -> Thinning | None:
    """The thinning out that the pixels beside edges show; None for an image whose pixels are evenly spaced.

    Args:
        places, edge: the mean edge: distances in px, and the share of white there.
    """
    for kept in range(2, MOST_KEPT + 1):
        offsets = pixel_offsets(edges, places, edge, kept)
        if offsets is None or float(np.sqrt(np.mean(offsets**2))) < LEAST_OFF_PX:
            continue
        ratios = (of for of in range(kept + 1, MOST_OF * kept) if math.gcd(of, kept) == 1)
        tried = [Thinning(kept, of, (column, row)) for of in ratios for column in range(kept) for row in range(kept)]
        left = [_left(thinning, offsets) for thinning in tried]
        if min(left) <= MOST_LEFT * float((offsets**2).sum()):
            return tried[int(np.argmin(left))]
    return None


def pixel_offsets(edges: Sequence[EdgePixels], places: Array, edge: Array, period: int) -> Array | None:
    """By how much pixels lie off their places, by column and row modulo ``period``: (2, period) px, of mean 0.

    The light at a pixel beside an edge tells where the pixel is. What all pixels of one edge have in common is the
    edge's own place.
    """
    there = ~np.isnan(edge)
    slope = np.gradient(edge[there], places[there])
    normal, pulls, count = np.zeros((2 * period, 2 * period)), np.zeros(2 * period), 0
    for one in edges:
        near = np.abs(one.across_px) < STEEP_PX
        across, pixels = one.across_px[near], one.pixels[near]
        steep = np.interp(across, places[there], slope)
        left = (one.levels[near] - one.black) / (one.white - one.black) - np.interp(across, places[there], edge[there])
        design = np.zeros((len(across), 2 * period))
        for axis in (0, 1):
            design[np.arange(len(across)), axis * period + pixels[:, axis] % period] = steep * one.normal[axis]
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


def evened(image: NDArray[np.uint8], thinning: Thinning) -> NDArray[np.uint8]:
    """The image at evenly spaced pixels: what lies between those there are, by cubic splines along rows and columns."""
    levels = image.astype(np.float64)
    for axis in (0, 1):
        places = np.arange(image.shape[1 - axis])
        there = places + np.resize(thinning.offsets_px(axis), len(places))
        levels = np.asarray(CubicSpline(there, levels, axis=1 - axis)(places), np.float64)
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)
