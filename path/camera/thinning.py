"""A camera that makes its images smaller by leaving out pixels: where those that it keeps are.

A sensor of 1280x800 pixels that is to give 640x480 keeps three of five rows and columns where it
does not compute. The pixels of such an image are not evenly spaced: of every three, one lies where
it should, and two are off by a fifth of a pixel. A camera's model is of the evenly spaced image,
and so is everything that is projected with it.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from path.arrays import Array
from path.bounds import Bounds
from path.values import frozen

Indices = NDArray[np.int64]

ROUNDING = 1e-9


@frozen
class Thinning:
    """``kept`` of every ``of`` rows and columns of the sensor are in the image: those nearest to
    the image's pixels.

    Attributes:
        begins: where the pattern begins, (column, row) of the image.

    Raises:
        ValueError: naming the field that cannot be right.
    """

    kept: Annotated[int, Bounds(1, 64, "pixels")]
    of: Annotated[int, Bounds(2, 256, "pixels")]
    begins: Annotated[tuple[int, int], Bounds(0, 63, "px")] = (0, 0)

    def __post_init__(self) -> None:
        if not 0 < self.kept < self.of:
            raise ValueError(f"kept: {self.kept} of {self.of} pixels leave none out")
        if not all(0 <= begin < self.kept for begin in self.begins):
            raise ValueError(
                f"begins: {self.begins} are not both within the {self.kept} pixels of the pattern"
            )

    def sensor_pixels(self, count: int, axis: int) -> Indices:
        """Columns (axis 0) or rows of the sensor that the image's first ``count`` are; the first is
        0.
        """
        return self._lines(np.arange(count), axis) - self._lines(np.zeros(1), axis)[0]

    def sensor_place(self, place_px: float, axis: int) -> float:
        """The place on the sensor of a place in the evenly spaced image."""
        from_begin = (place_px + 0.5 - self.begins[axis]) * self.of / self.kept
        return float(from_begin - 0.5 - self._lines(np.zeros(1), axis)[0])

    def places(self, pixels: Array | Indices, axis: int) -> Array:
        """The places of pixels (columns or rows by their whole numbers, any shape) in the evenly
        spaced image.
        """
        return (self._lines(pixels, axis) + 0.5) * self.kept / self.of + self.begins[axis] - 0.5

    def offsets_px(self, axis: int) -> Array:
        """By how much each of ``kept`` pixels lies off its place in the image, (kept,) px."""
        pixels = np.arange(self.kept)
        return self.places(pixels, axis) - pixels

    def even(self, points: Array) -> Array:
        """Places (..., 2) between the pixels of the image, in the evenly spaced one."""
        low = np.floor(points)
        share = points - low
        columns, rows = (
            (1.0 - share[..., axis]) * self.places(low[..., axis], axis)
            + share[..., axis] * self.places(low[..., axis] + 1.0, axis)
            for axis in (0, 1)
        )
        return np.stack((columns, rows), axis=-1)

    def _lines(self, pixels: Array | Indices, axis: int) -> Indices:
        from_begin = (pixels - self.begins[axis] + 0.5) * self.of / self.kept
        return np.floor(from_begin + ROUNDING).astype(np.int64)
