"""The detections in an image that depth has cut: which pieces are one thing, and which are only
what was left.

A colour detector judges shapes, and a cut changes them: it may see two things in what remains of
one, or one in the rim that remains of what is elsewhere. Depth tells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.perception.depth_mask import step_limit_m
from path.observations import Box, Detection, around, common_area
from path.values import frozen

# of the smaller box lies in the other: pieces of one thing, when they are equally far away
SAME_LAP = 0.2
OWN_SHARE = 0.25  # of a box is at a depth that is asked for: what it shows is there
# shorter over longer side, and a detector's score: less is a rim
THINNEST = 1 / 3
RAREST_SCORE = 0.12
EVERY_PX = 3  # so many pixels of a box's depth are looked at


@frozen
class DepthSlice:
    """Depths between two limits.

    Attributes:
        depth_mm: (h, w), registered to the image, 0 where there is none.
        limits_m: nearest and farthest.
        sigma_at_1m_m: noise of a pixel's depth at 1 m.
    """

    depth_mm: NDArray[np.uint16]
    limits_m: tuple[float, float]
    sigma_at_1m_m: float

    def inside(self, box: Box) -> float | None:
        """Median depth (m) of what of a box is between the limits; None when little of it is."""
        x0 = max(0, round(box.x))
        y0 = max(0, round(box.y))
        x1 = max(x0, round(box.x + box.w))
        y1 = max(y0, round(box.y + box.h))
        patch = self.depth_mm[y0:y1:EVERY_PX, x0:x1:EVERY_PX]
        near_m, far_m = self.limits_m
        own = patch[(patch >= 1000.0 * near_m) & (patch <= 1000.0 * far_m)]
        return float(np.median(own)) / 1000.0 if own.size > OWN_SHARE * patch.size else None

    def united(self, pieces: Sequence[Detection]) -> list[Detection]:
        """Pieces whose boxes overlap, and between whose depths there is no step, as one; it scores
        as its best.
        """
        rest = list(pieces)
        found = list[Detection]()
        while rest:
            whole = rest.pop(0)
            while parts := [each for each in rest if self._is_one(whole.box, each.box)]:
                rest = [each for each in rest if each not in parts]
                whole = Detection(
                    around([whole.box, *(each.box for each in parts)]),
                    max(whole.score, parts[0].score),
                )
            found.append(whole)
        return found

    def is_thing(self, piece: Detection) -> bool:
        """Return whether a piece of odd shape is more than a rim, and itself between the limits."""
        narrow, wide = sorted((piece.box.w, piece.box.h))
        return (
            narrow >= THINNEST * wide
            and piece.score >= RAREST_SCORE
            and self.inside(piece.box) is not None
        )

    def _is_one(self, a: Box, b: Box) -> bool:
        if common_area(a, b) < SAME_LAP * min(a.area, b.area):
            return False
        depth_a = self.inside(a)
        depth_b = self.inside(b)
        if depth_a is None or depth_b is None:
            return True
        return abs(depth_a - depth_b) <= step_limit_m(min(depth_a, depth_b), self.sigma_at_1m_m)
