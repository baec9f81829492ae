"""The ground's texture: periodic, with its mip levels."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

GROUND_BITS = 9
GROUND_SIZE = 1 << GROUND_BITS  # texels per side of the finest level
GROUND_LEVELS = 8  # 512 .. 4
GROUND_PERIOD_M = 2.048  # side of one tile: 4 mm texels
GROUND_SEED = 20240517  # the ground is the same in every world


@cache
def ground_pyramid() -> NDArray[np.int32]:
    """All mip levels of the ground, finest first, as one flat read-only array of four-tap words.

    A word holds the texel and its right, lower and lower-right neighbours (periodic) from the low byte up, so that a
    bilinear lookup is one gather.
    """
    level = _ground_tile()
    words: list[NDArray[np.int32]] = []
    for _ in range(GROUND_LEVELS):
        texels = np.round(level).astype(np.uint8)
        right, below = np.roll(texels, -1, axis=1), np.roll(texels, -1, axis=0)
        packed = np.stack((texels, right, below, np.roll(right, -1, axis=0)), axis=-1)
        words.append(packed.view("<i4").ravel())
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
    pyramid = np.concatenate(words)
    pyramid.setflags(write=False)
    return pyramid


def _ground_tile() -> NDArray[np.float64]:
    """Grey levels 0..255, shape (GROUND_SIZE, GROUND_SIZE): soil with a falling spectrum, strewn with pebbles."""
    rng = np.random.default_rng(GROUND_SEED)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(GROUND_SIZE), np.fft.rfftfreq(GROUND_SIZE), indexing="ij"))
    falling = 1.0 / np.maximum(frequency, 2.0 / GROUND_SIZE) ** 0.9
    spectrum = np.fft.rfft2(rng.standard_normal((GROUND_SIZE, GROUND_SIZE))) * falling
    soil = np.fft.irfft2(spectrum, s=(GROUND_SIZE, GROUND_SIZE))
    tile = 120.0 + 34.0 * soil / soil.std()
    for _ in range(700):
        row, column = rng.integers(0, GROUND_SIZE, 2)
        radius, shade = int(rng.integers(1, 5)), float(rng.uniform(-60.0, 75.0))
        offsets = np.arange(-radius, radius + 1)
        inside = offsets[:, None] ** 2 + offsets[None, :] ** 2 <= radius * radius
        rows, columns = np.ix_((row + offsets) % GROUND_SIZE, (column + offsets) % GROUND_SIZE)
        tile[rows, columns] += np.where(inside, shade, 0.0)
    return np.clip(tile, 0.0, 255.0)
