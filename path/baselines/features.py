"""Local features of an image, whoever finds them, and how those around boxes are looked for.

A person some metres away is a hundred pixels wide or less: features are looked for in enlarged
windows around the boxes, at full resolution, not in the whole image made small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from path.arrays import Image, Singles
from path.observations import Box, Region
from path.values import frozen

Distance = Literal["hamming", "cosine"]


@frozen(eq=False)
class Keypoints:
    """Local features of an image, n of them.

    Attributes:
        points_px: (n, 2) float32.
        descriptors: (n, bytes) uint8 of bits, compared by Hamming distance, or (n, d) float32 of
            unit length, compared by their cosine.
        scores: (n,) float32, larger is better.
    """

    points_px: Singles
    descriptors: NDArray[Any]
    scores: Singles

    def __len__(self) -> int:
        return len(self.points_px)

    def pick(self, which: NDArray[Any]) -> Keypoints:
        """Return the keypoints of a mask or of indices."""
        return Keypoints(self.points_px[which], self.descriptors[which], self.scores[which])


NOTHING = Keypoints(
    np.zeros((0, 2), np.float32),
    np.zeros((0, 0), np.uint8),
    np.zeros(0, np.float32),
)


class Features(Protocol):
    """Finds and describes local features.

    ``side_px``: side of the square images it takes; None when it takes any.
    """

    @property
    def distance(self) -> Distance: ...

    @property
    def side_px(self) -> int | None: ...

    def extract(self, image: Image) -> Keypoints:
        """Features of a uint8 BGR image (h, w, 3)."""
        ...


@frozen
class FeatureSearch:
    """The surroundings of a box in which features are searched for, and their scale.

    Attributes:
        zoom: enlargement of the image before.
        context: how much of the surroundings belongs to the box, on each side, as a share of the
            box's longer side.
    """

    zoom: float = 2.0
    context: float = 0.0


def look(
    features: Features,
    image: Image,
    boxes: Sequence[Box],
    settings: FeatureSearch,
) -> list[Keypoints]:
    """The features in each box and its surroundings, in pixels of the image. A box outside the
    image has none.
    """
    return look_each(features, image, boxes, [settings])[settings]


def look_each(
    features: Features,
    image: Image,
    boxes: Sequence[Box],
    settings: Sequence[FeatureSearch],
) -> dict[FeatureSearch, list[Keypoints]]:
    """The same in several ways. A network sees the windows of one zoom once, wide enough for all of
    that zoom.
    """
    height, width = image.shape[:2]
    found: dict[FeatureSearch, list[Keypoints]] = {}
    for zoom in dict.fromkeys(each.zoom for each in settings):
        alike = sorted(
            {each for each in settings if each.zoom == zoom}, key=lambda each: -each.context
        )
        for group in [[each] for each in alike] if features.side_px is None else [alike]:
            areas = {
                each: [_grown(box, each.context).clipped(width, height) for box in boxes]
                for each in group
            }
            windows = [area for area in areas[group[0]] if area is not None]
            if features.side_px is not None:
                windows = cover(
                    windows,
                    min(features.side_px / zoom, float(max(width, height))),
                    width,
                    height,
                )
            seen = [_in_window(features, image, window, zoom) for window in windows]
            for each in group:
                found[each] = [_of_area(area, windows, seen) for area in areas[each]]
    return found


def _of_area(
    area: Region | None,
    windows: Sequence[Region],
    seen: Sequence[Keypoints],
) -> Keypoints:
    home = None if area is None else _home(area, windows)
    if area is not None and home is not None:
        return inside(seen[home], area)
    return seen[0].pick(np.zeros(0, np.int64)) if seen else NOTHING


def inside(keypoints: Keypoints, area: Region) -> Keypoints:
    """Return the keypoints within an area."""
    u = keypoints.points_px[:, 0]
    v = keypoints.points_px[:, 1]
    return keypoints.pick((u >= area.x0) & (u < area.x1) & (v >= area.y0) & (v < area.y1))


def cover(
    areas: Sequence[Region],
    side: float,
    width: int,
    height: int,
) -> list[Region]:
    """Squares inside a ``width`` x ``height`` image so that each area is wholly in one of them.

    Areas that fit into one square of ``side`` share it, from left to right; one that is larger gets
    a larger square (cut off at the image where the image is smaller than that).
    """
    groups: list[Region] = []
    for area in sorted(areas, key=lambda a: (a.x0 + a.x1, a.y0 + a.y1)):
        for i, group in enumerate(groups):
            union = _union(group, area)
            if max(union.x1 - union.x0, union.y1 - union.y0) <= side:
                groups[i] = union
                break
        else:
            groups.append(area)
    return [_square(group, side, width, height) for group in groups]


def _square(
    area: Region,
    side: float,
    width: int,
    height: int,
) -> Region:
    """A square around the middle of an area, moved into the image."""
    side = max(side, area.x1 - area.x0, area.y1 - area.y0)
    x0 = min(max(0.5 * (area.x0 + area.x1 - side), 0.0), max(0.0, width - side))
    y0 = min(max(0.5 * (area.y0 + area.y1 - side), 0.0), max(0.0, height - side))
    return Region(x0, y0, min(x0 + side, float(width)), min(y0 + side, float(height)))


def _union(a: Region, b: Region) -> Region:
    return Region(min(a.x0, b.x0), min(a.y0, b.y0), max(a.x1, b.x1), max(a.y1, b.y1))


def _home(area: Region, windows: Sequence[Region]) -> int | None:
    """The window that holds an area, with some rounding."""
    for i, window in enumerate(windows):
        if (
            window.x0 <= area.x0 + 1.0
            and window.y0 <= area.y0 + 1.0
            and window.x1 >= area.x1 - 1.0
            and window.y1 >= area.y1 - 1.0
        ):
            return i
    return None


def _grown(box: Box, context: float) -> Region:
    reach = context * max(box.w, box.h)
    return Region(box.x - reach, box.y - reach, box.x + box.w + reach, box.y + box.h + reach)


def _in_window(
    features: Features,
    image: Image,
    window: Region,
    zoom: float,
) -> Keypoints:
    """Features of an enlarged window, in pixels of the image."""
    u0 = int(window.x0)
    v0 = int(window.y0)
    cut = image[v0 : int(np.ceil(window.y1)), u0 : int(np.ceil(window.x1))]
    if features.side_px is not None:  # what is larger than it takes is enlarged less
        zoom = min(zoom, features.side_px / max(cut.shape[:2]))
    size = max(1, round(cut.shape[1] * zoom)), max(1, round(cut.shape[0] * zoom))
    how = cv2.INTER_CUBIC if zoom > 1.0 else cv2.INTER_AREA
    enlarged = cut if size == cut.shape[1::-1] else cv2.resize(cut, size, interpolation=how)
    found = features.extract(np.ascontiguousarray(enlarged, dtype=np.uint8))
    scale = np.array([cut.shape[1] / size[0], cut.shape[0] / size[1]], np.float32)
    points = (
        (found.points_px + np.float32(0.5)) * scale
        - np.float32(0.5)
        + np.array([u0, v0], np.float32)
    )
    return Keypoints(points, found.descriptors, found.scores)
