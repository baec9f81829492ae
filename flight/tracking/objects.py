"""The objects a detector shows in an image, nearest first to where one is expected; what the border
cuts of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from path.camera.model import CameraModel
from path.observations import Box, Detection, around, common_area
from path.target.pieces import whole_of
from path.values import value

Pixel = tuple[float, float]
Sides = tuple[float, float]

MIN_SCORE = 0.3
# of a box that the image's border cuts, which detectors score low: it is an object, not its box
CUT_SCORE = 0.1
LARGER = 1.3  # than the object's own box was: there is more in it
_BORDER_PX = 1.5


@value
class ImageObject:
    """An object in an image. ``cut``: by the border; ``pixel`` is where its middle must be, and may
    be outside.

    ``more``: what is left of the cut box is larger than the expected object is, which is not alone
    in it.
    """

    box: Box
    pixel: Pixel
    off_px: float  # from where the tracked one is expected
    cut: bool
    more: bool = False


def by_distance(
    found: Sequence[Detection], expected: Pixel, camera: CameraModel, size_m: Sides | None, usual_m: Sides | None,
    z_m: float,
) -> list[ImageObject]:  # fmt: skip
    """The objects of ``found``, the nearest to the expected pixel first and in one piece.

    Args:
        size_m: width and height of the expected one's box where it is, when it was last seen whole;
            ``usual_m``: over the last frames.
        z_m: its depth.
    """
    objects: list[ImageObject] = []
    side_px, usual_px = (
        None if sides_m is None else (sides_m[0] * camera.fx / z_m, sides_m[1] * camera.fy / z_m)
        for sides_m in (size_m, usual_m)
    )
    for detection in found:
        box = detection.box
        cut = is_cut(box, camera)
        if detection.score < (CUT_SCORE if cut else MIN_SCORE):
            continue
        pixel = _middle(box, camera, size_m, z_m) if cut and size_m is not None else box.center
        more = cut and side_px is not None and is_larger(box, side_px)
        objects.append(ImageObject(box, pixel, math.dist(pixel, expected), cut, more))
    objects.sort(key=lambda each: each.off_px)
    if len(objects) < 2 or side_px is None:
        return objects
    return _joined(objects, expected, side_px, side_px if usual_px is None else usual_px)


def is_larger(box: Box, side_px: Sides) -> bool:
    """True when a box is so much larger than the expected object's that it has more in it."""
    return max(box.w / side_px[0], box.h / side_px[1]) > LARGER


def _joined(
    ranked: list[ImageObject],
    expected: Pixel,
    side_px: Sides,
    usual_px: Sides,
) -> list[ImageObject]:
    """The objects with the first one in one piece: detectors at times show one object as two boxes,
    for a frame.

    What is of the first one besides its box is no other object.
    """
    first, *others = ranked
    if first.cut:
        return ranked
    for other in others:
        both = None if other.cut else whole_of(first.box, other.box, side_px)
        if both is not None:
            whole = ImageObject(both, both.center, math.dist(both.center, expected), cut=False)
            return [whole, *(each for each in others if each is not other)]
    return [
        first,
        *(each for each in others if each.cut or not _is_of(each.box, first.box, usual_px)),
    ]


def _is_of(
    box: Box,
    whole: Box,
    side_px: Sides,
) -> bool:
    """True for a box around a part of an object: it overlaps the whole's, and both are no larger
    than the object.
    """
    part = min(box.w / side_px[0], box.h / side_px[1]) * LARGER < 1.0
    return part and common_area(box, whole) > 0.0 and not is_larger(around((box, whole)), side_px)


def is_cut(box: Box, camera: CameraModel) -> bool:
    """True when the image's border cuts a box, or may: then it is not the whole object's."""
    return any(cut_sides(box.x, box.w, camera.width)) or any(cut_sides(box.y, box.h, camera.height))


def cut_sides(
    low: float,
    side: float,
    size: int,
) -> tuple[bool, bool]:
    """Return whether the border cuts a box's side where it begins, and where it ends, in an image
    of that size.
    """
    return low < _BORDER_PX - 0.5, low + side > size - 0.5 - _BORDER_PX


def _middle(
    box: Box,
    camera: CameraModel,
    size_m: tuple[float, float],
    z_m: float,
) -> Pixel:
    """The middle of an object that the border cuts, from its size when it was whole."""
    half_u = 0.5 * size_m[0] * camera.fx / z_m
    half_v = 0.5 * size_m[1] * camera.fy / z_m
    return (
        _whole_middle(box.x, box.w, half_u, camera.width),
        _whole_middle(box.y, box.h, half_v, camera.height),
    )


def _whole_middle(
    low: float,
    side: float,
    half: float,
    size: int,
) -> float:
    high, (cut_low, cut_high) = low + side, cut_sides(low, side, size)
    if cut_low:
        return min(high - half, 0.5 * (low + high))
    if cut_high:
        return max(low + half, 0.5 * (low + high))
    return 0.5 * (low + high)
