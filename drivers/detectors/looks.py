"""Where a network looks, and how much enlarged, so that what is looked for has a size at which the
network is good.

A network of one input size finds objects that are some tens of its pixels long, and misses the very
same ones when they are smaller: of 167 people of 20 to 110 px in photographs from drones YOLOX-nano
found 33 % where they were 30 px in its input, 69 % at 64 px and 72 % at 128 px (docs/detectors.md).
So a part of the image is cut out and enlarged until an object of the expected size is that large.
What does not fit into the input is cut into tiles that overlap by such an object.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from path.observations import Region
from path.values import frozen

ROOM = 1.2  # times the longer side of an object: how far tiles overlap
REGION_SIDES = 3.0  # times an object's longer side: how large a region is around it, as a rule
COARSER = 0.85  # times the enlargement, while there are more tiles than a frame may have
Window = tuple[int, int, int, int]


@frozen
class Input:
    """A network's input in px, how large an object should be in it, and how much an image may be
    enlarged for that.

    ``most``: windows of one image.
    """

    width: int
    height: int
    sizes_px: tuple[float, ...]
    most_zoom: float
    most: int


def windows(region: Region | None, width: int, height: int, own: Input) -> list[Window]:
    """Return the parts of an image to look at, each ``x0 y0 x1 y1``; none where the region is
    outside of it.

    Of a region there are at most ``own.most``: rather less enlarged than more. Of a whole image
    there may be more, to be looked at in turns.
    """
    whole = (0, 0, width, height)
    if region is None:
        return [whole]
    if region.clipped(width, height) is None:
        return []
    everywhere = (
        region.x0 <= 0.0 and region.y0 <= 0.0 and region.x1 >= width and region.y1 >= height
    )
    unsaid = region.side_px <= 0.0
    if everywhere and unsaid:
        return [whole]
    side_px = region.side_px or min(region.x1 - region.x0, region.y1 - region.y0) / REGION_SIDES
    area = _reached(region, 0.5 * ROOM * side_px, width, height)
    least = min(own.width / width, own.height / height)
    most = max(1, (own.most - unsaid) // len(own.sizes_px))
    # what is larger than its region makes one think is seen whole in the whole image alone
    found: list[Window] = [whole] if unsaid else []
    for size_px in own.sizes_px:
        scale = max(least, min(size_px / side_px, own.most_zoom))
        tiles = list(_tiles(area, scale, side_px, (width, height), own))
        while not everywhere and len(tiles) > most and scale > least:
            scale = max(least, COARSER * scale)
            tiles = list(_tiles(area, scale, side_px, (width, height), own))
        found += [tile for tile in tiles if tile not in found]
    return found


def _reached(region: Region, reach_px: float, width: int, height: int) -> Window:
    """Return a region with room around it for objects whose middle alone is inside."""
    return (
        int(max(region.x0 - reach_px, 0.0)),
        int(max(region.y0 - reach_px, 0.0)),
        math.ceil(min(region.x1 + reach_px, float(width))),
        math.ceil(min(region.y1 + reach_px, float(height))),
    )


def _tiles(
    area: Window,
    scale: float,
    side_px: float,
    image: tuple[int, int],
    own: Input,
) -> Iterator[Window]:
    """Yield windows that fill the input at a scale and cover an area together."""
    x0, y0, x1, y1 = area
    across = _spans(x0, x1, image[0], own.width / scale, ROOM * side_px)
    down = _spans(y0, y1, image[1], own.height / scale, ROOM * side_px)
    for top, bottom in down:
        for left, right in across:
            yield left, top, right, bottom


def _spans(
    begin: int,
    end: int,
    image: int,
    length: float,
    overlap: float,
) -> Sequence[tuple[int, int]]:
    """Return pieces of an axis, each so long or as long as the image, that cover begin to end."""
    if length >= image:
        return [(0, image)]
    count = 1 + max(0, math.ceil((end - begin - length) / max(length - overlap, 0.25 * length)))
    covered = max(end - begin, length)
    first = min(max(0.5 * (begin + end - covered), 0.0), image - covered)
    apart = (covered - length) / max(1, count - 1)
    starts = [round(first + apart * k) for k in range(count)]
    return [(start, min(image, start + math.ceil(length))) for start in starts]
