"""The look of a marker's plate when the print and the light on it are not ideal.

A plate is drawn as a table of shades of its paper, fine enough that its texels are far below a
pixel. Truth does not change: the corners of a marker are where its edges were meant to be, whatever
ink and shadow do to them.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from flight.harness.renderer import Printing
from hil.render.scene import BLADE, INK, PAPER, PLATE_SCALE
from path.arrays import Array, Image

TEXELS = 1024  # about, along a side of the plate
SHADED = 0.45  # light in a shadow, as a share
PENUMBRA_M = 0.0006  # half the width of the edge of a hard shadow
SOFT_SIDES = 1.0  # width of a soft shadow's gradient, in sides of the marker
# chord; blurred edge; of a blade that moves
BLADE_M = 0.008
BLADE_EDGE_M = 0.001
BLADE_OPACITY = 0.55
OFF_CENTRE = 0.35  # shadows' edges and blades pass the centre within this part of the marker's side


def marker_print(
    cells: Array,
    side_m: float,
    printing: Printing,
    print_rng: np.random.Generator,
    rng: np.random.Generator,
) -> Image:
    """Shades of the plate of one marker, row 0 at its top.

    Args:
        cells: (n, n), 1 white, black frame included.
        side_m: of the marker.
        print_rng: of what stays with the print: its black.
        rng: of what moves: shadow and blade.

    Returns:
        (s, s), 255 is paper in full light.
    """
    n = len(cells)
    per_cell = 4 * round(TEXELS / (PLATE_SCALE * n) / 4)  # edges of cells are edges of texels
    border = round(0.5 * (PLATE_SCALE - 1.0) * n * per_cell)
    texel_m = side_m / (n * per_cell)
    shown = _shown(n, per_cell, printing.picture_px)
    white = np.pad(cells[np.ix_(shown, shown)], border, constant_values=1.0)
    black = np.full((n, n), INK[0] / PAPER[0])
    black += print_rng.normal(0.0, printing.black_spread / PAPER[0], (n, n))
    ink = np.pad(black.clip(0.0, 1.0)[np.ix_(shown, shown)], border, mode="edge")
    cover = _spread(white.astype(np.uint8), printing.ink_spread_m / texel_m)
    shade = 1.0 + cover * (ink - 1.0)
    shade *= _light(len(shade), texel_m, side_m, printing, rng)
    if printing.blade:
        shade += _blade(len(shade), texel_m, side_m, rng) * (BLADE[0] / PAPER[0] - shade)
    return np.round(255.0 * shade).astype(np.uint8)


def _shown(
    n: int,
    per_cell: int,
    picture_px: int,
) -> NDArray[np.intp]:
    """The cell (0 .. n - 1) that each texel of a row shows."""
    texels = np.arange(n * per_cell)
    if picture_px == 0:
        return texels // per_cell
    return np.asarray((texels * picture_px // (n * per_cell)) * n // picture_px, np.intp)


def _spread(white: Image, spread: float) -> Array:
    """Share of each texel that is black when black reaches ``spread`` texels beyond its edges.
    ``white``: 1, else 0.
    """
    distance = cv2.distanceTransform(white, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float64)
    # the nearest edge is half a texel nearer than its texel
    return np.clip(spread - distance + 1.0, 0.0, 1.0)


def _across(
    size: int,
    texel_m: float,
    side_m: float,
    rng: np.random.Generator,
) -> Array:
    """Distance in m, shape (size, size), from a line in a random direction that passes near the
    centre.
    """
    angle = rng.uniform(0.0, 2.0 * np.pi)
    offset = side_m * rng.uniform(-OFF_CENTRE, OFF_CENTRE)
    along = (np.arange(size) + 0.5 - 0.5 * size) * texel_m
    return np.cos(angle) * along[None, :] + np.sin(angle) * along[:, None] - offset


def _light(
    size: int,
    texel_m: float,
    side_m: float,
    printing: Printing,
    rng: np.random.Generator,
) -> Array | float:
    """Share of the light that reaches each texel: 1, falling smoothly to ``SHADED``."""
    if printing.shadow == "none":
        return 1.0
    half_m = PENUMBRA_M if printing.shadow == "hard" else 0.5 * SOFT_SIDES * side_m
    step = np.clip(0.5 + 0.5 * _across(size, texel_m, side_m, rng) / half_m, 0.0, 1.0)
    return 1.0 - (1.0 - SHADED) * step * step * (3.0 - 2.0 * step)


def _blade(
    size: int,
    texel_m: float,
    side_m: float,
    rng: np.random.Generator,
) -> Array:
    """Opacity of a blade across the plate."""
    beyond_m = np.abs(_across(size, texel_m, side_m, rng)) - 0.5 * BLADE_M
    return BLADE_OPACITY * np.clip(0.5 - 0.5 * beyond_m / BLADE_EDGE_M, 0.0, 1.0)
