"""People to track: boxes in patterned clothes, orange above the waist.

They wear the same kind of shirt and cap, as people of one team do, and differ in height, build,
shades and in single cells of their patterns. The patterns have corners that feature matchers can
hold on to.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from hil.render.scene import GAP_M, PATTERN, Color, Face, Model, box, model_of
from path.arrays import Array, Image
from path.values import frozen

HEIGHT_M = 1.75
SEED = 20240611  # the clothes are the same in every world
VARIANTS = 8  # so many people are not quite alike
INDIVIDUAL = 0.08  # share of a pattern's cells that is a person's own

# both of the hue that is tracked
SHIRT: tuple[Color, Color] = ((24.0, 118.0, 245.0), (12.0, 66.0, 158.0))
LOGO: tuple[Color, Color] = ((226.0, 224.0, 220.0), (92.0, 60.0, 44.0))
TROUSERS: tuple[Color, Color] = ((150.0, 122.0, 108.0), (112.0, 98.0, 92.0))
CAP: tuple[Color, Color] = ((216.0, 214.0, 210.0), (132.0, 84.0, 62.0))
SKIN: Color = (148.0, 168.0, 204.0)
SHOES: tuple[Color, Color] = ((96.0, 94.0, 94.0), (170.0, 170.0, 172.0))


@frozen
class _Part:
    """A box: centre and size (x forward, y left, z up) in m. A pattern has cells of ``cell_m``,
    ``share`` the first.
    """

    center: tuple[float, float, float]
    size: tuple[float, float, float]
    colors: tuple[Color, Color]
    cell_m: float = 0.0
    share: float = 0.5


def _sides(part: _Part, swing_m: float = 0.0) -> tuple[_Part, _Part]:
    """The part on the left, swung forward, and its mirror image, swung back."""
    x, y, z = part.center
    return replace(part, center=(x + swing_m, y, z)), replace(part, center=(x - swing_m, -y, z))


PARTS: tuple[_Part, ...] = (
    *_sides(_Part((0.04, 0.10, 0.046), (0.28, 0.10, 0.090), SHOES, 0.045, 0.7)),
    *_sides(_Part((0.0, 0.10, 0.497), (0.16, 0.155, 0.808), TROUSERS, 0.055, 0.6)),
    _Part((0.0, 0.0, 1.180), (0.31, 0.42, 0.550), SHIRT, 0.045, 0.6),
    *_sides(_Part((0.0, 0.275, 1.172), (0.14, 0.120, 0.550), SHIRT, 0.045, 0.6), 0.11),
    *_sides(_Part((0.0, 0.275, 0.805), (0.10, 0.085, 0.180), (SKIN, SKIN)), 0.12),
    _Part((0.0, 0.0, 1.490), (0.12, 0.120, 0.066), (SKIN, SKIN)),
    _Part((0.01, 0.0, 1.606), (0.19, 0.160, 0.160), (SKIN, (90.0, 110.0, 148.0)), 0.040, 0.8),
    _Part((0.0, 0.0, 1.719), (0.22, 0.190, 0.062), CAP, 0.031, 0.5),
    _Part((0.165, 0.0, 1.696), (0.10, 0.170, 0.014), CAP, 0.034, 0.5),
    _Part((0.158, 0.0, 1.250), (0.002, 0.200, 0.200), LOGO, 0.025, 0.5),
    _Part((-0.158, 0.0, 1.230), (0.002, 0.240, 0.240), LOGO, 0.030, 0.5),
)

# left, right; of arms the sleeves, then the hands
SHOE_PARTS = (0, 1)
LEG_PARTS = (2, 3)
ARM_PARTS = (5, 6, 7, 8)
SWUNG_M = {5: 0.11, 6: -0.11, 7: 0.12, 8: -0.12}  # how far forward these are


@cache
def person(variant: int) -> Model:
    """A standing person: x forward, z up, origin on the ground between the feet. Variants are not
    quite alike.
    """
    own = _own(variant)
    scale = _build(own)
    faces: list[Face] = []
    for number, part in enumerate(PARTS):
        shade = own.uniform(0.92, 1.06)
        center = np.array(part.center) * scale
        size = np.array(part.size) * scale
        size -= 2.0 * GAP_M * (scale - 1.0).clip(0.0)  # growing, neighbours keep their distance
        first, second = (_shaded(color, shade) for color in part.colors)
        sides = box(center, size.tolist(), first)
        if part.cell_m > 0.0:
            common = np.random.default_rng([SEED, 0, number])
            sides = list(_patterned(sides, second, part, common, own))
        faces += sides
    return model_of(faces)


def build(variant: int) -> Array:
    """Return how much deeper (x), wider (y) and taller (z) a person is than ``PARTS``."""
    return _build(_own(variant))


def _own(variant: int) -> np.random.Generator:
    return np.random.default_rng([SEED, 1, variant])


def _build(own: np.random.Generator) -> Array:
    tall, wide, deep = own.uniform((0.96, 0.93, 0.95), (1.04, 1.07, 1.05))
    return np.array([deep, wide, tall])


def _shaded(color: Color, shade: float) -> Color:
    return color[0] * shade, color[1] * shade, color[2] * shade


def _patterned(
    sides: Iterable[Face],
    second: Color,
    part: _Part,
    common: np.random.Generator,
    own: np.random.Generator,
) -> Iterable[Face]:
    """Sides of a box with patterns: the cells of the kind, and a few of the person's own."""
    nominal = box(part.center, part.size, second)
    # counts of cells do not depend on the build
    for side, planned in zip(sides, nominal, strict=True):
        shape = tuple(
            max(1, round(float(np.linalg.norm(edge)) / part.cell_m))
            for edge in (planned.e2, planned.e1)
        )
        cells = common.random(shape) < part.share
        cells ^= own.random(shape) < INDIVIDUAL
        shades: Image = cells.astype(np.uint8) * np.uint8(255)
        yield side._replace(kind=PATTERN, second=second, shades=shades)
