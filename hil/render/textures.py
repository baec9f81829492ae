"""The grounds' textures: periodic, with their mip levels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hil.render.looks import GroundKind
from path.arrays import Array

Shades = tuple[float, float]

GROUND_BITS = 9
GROUND_SIZE = 1 << GROUND_BITS  # texels per side of the finest level
GROUND_LEVELS = 8  # 512 .. 4
GROUND_PERIOD_M = 2.048  # side of one tile: 4 mm texels
GROUND_SEED = 20240517  # the ground is the same in every world


@cache
def ground_pyramid(kind: GroundKind = "soil") -> NDArray[np.int32]:
    """All mip levels of a ground, finest first, as one flat read-only array of four-tap words.

    A word holds the texel and its right, lower and lower-right neighbours (periodic) from the low
    byte up, so that a bilinear lookup is one gather.
    """
    level = _TILES[kind]()
    words: list[NDArray[np.int32]] = []
    for _ in range(GROUND_LEVELS):
        texels = np.round(level).astype(np.uint8)
        right = np.roll(texels, -1, axis=1)
        below = np.roll(texels, -1, axis=0)
        packed = np.stack((texels, right, below, np.roll(right, -1, axis=0)), axis=-1)
        words.append(packed.view("<i4").ravel())
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
    pyramid = np.concatenate(words)
    pyramid.setflags(write=False)
    return pyramid


def _ground_tile() -> Array:
    """Grey levels 0..255, shape (GROUND_SIZE, GROUND_SIZE): soil with a falling spectrum, strewn
    with pebbles.
    """
    rng = np.random.default_rng(GROUND_SEED)
    frequency = np.hypot(
        *np.meshgrid(np.fft.fftfreq(GROUND_SIZE), np.fft.rfftfreq(GROUND_SIZE), indexing="ij")
    )
    falling = 1.0 / np.maximum(frequency, 2.0 / GROUND_SIZE) ** 0.9
    spectrum = np.fft.rfft2(rng.standard_normal((GROUND_SIZE, GROUND_SIZE))) * falling
    soil = np.fft.irfft2(spectrum, s=(GROUND_SIZE, GROUND_SIZE))
    tile = 120.0 + 34.0 * soil / soil.std()
    _strew(tile, rng, 700, 4, (-60.0, 75.0))
    return np.clip(tile, 0.0, 255.0)


def _strew(
    tile: Array,
    rng: np.random.Generator,
    many: int,
    most: int,
    shades: Shades,
) -> None:
    """Pebbles of radii up to ``most`` texels."""
    for _ in range(many):
        row, column = rng.integers(0, GROUND_SIZE, 2)
        radius = int(rng.integers(1, most + 1))
        shade = float(rng.uniform(*shades))
        offsets = np.arange(-radius, radius + 1)
        inside = offsets[:, None] ** 2 + offsets[None, :] ** 2 <= radius * radius
        rows, columns = np.ix_((row + offsets) % GROUND_SIZE, (column + offsets) % GROUND_SIZE)
        tile[rows, columns] += np.where(inside, shade, 0.0)


def _noise(
    rng: np.random.Generator,
    fall: float,
    stretch: float = 1.0,
) -> Array:
    """Unit noise whose spectrum falls with this power; ``stretch``: longer in one direction."""
    rows, columns = np.meshgrid(
        np.fft.fftfreq(GROUND_SIZE) * stretch,
        np.fft.rfftfreq(GROUND_SIZE),
        indexing="ij",
    )
    falling = 1.0 / np.maximum(np.hypot(rows, columns), 2.0 / GROUND_SIZE) ** fall
    noise = np.fft.irfft2(
        np.fft.rfft2(rng.standard_normal((GROUND_SIZE, GROUND_SIZE))) * falling,
        s=(GROUND_SIZE, GROUND_SIZE),
    )
    return noise / noise.std()


def _grass() -> Array:
    """Tufts, and blades in two directions."""
    rng = np.random.default_rng([GROUND_SEED, 1])
    blades = _noise(rng, 0.45, 3.0) + _noise(rng, 0.45, 3.0).T
    return np.clip(118.0 + 26.0 * blades + 20.0 * _noise(rng, 1.3), 0.0, 255.0)


def _gravel() -> Array:
    """Stones beside stones."""
    rng = np.random.default_rng([GROUND_SEED, 2])
    tile = 105.0 + 22.0 * _noise(rng, 0.6)
    _strew(tile, rng, 6000, 5, (-45.0, 45.0))
    return np.clip(tile, 0.0, 255.0)


def _tarmac() -> Array:
    """Grain and patches."""
    rng = np.random.default_rng([GROUND_SEED, 3])
    tile = 110.0 + 20.0 * _noise(rng, 0.2) + 14.0 * _noise(rng, 1.4)
    _strew(tile, rng, 300, 2, (20.0, 90.0))
    return np.clip(tile, 0.0, 255.0)


def _concrete() -> Array:
    """Smooth and cloudy, with joints along the tile's border."""
    rng = np.random.default_rng([GROUND_SEED, 4])
    tile = 140.0 + 16.0 * _noise(rng, 1.6) + 4.0 * _noise(rng, 0.2)
    tile[:2], tile[:, :2] = 70.0, 70.0
    return np.clip(tile, 0.0, 255.0)


_TILES: Mapping[GroundKind, Callable[[], Array]] = {
    "soil": _ground_tile,
    "grass": _grass,
    "gravel": _gravel,
    "tarmac": _tarmac,
    "concrete": _concrete,
}
