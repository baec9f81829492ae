"""OpenCV's trackers of one box, which have no common types: wrapped here. In contrib 4.x and 5.x alike."""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from path.observations import Box

TrackerKind = Literal["csrt", "kcf", "mosse"]


class BoxTracker:
    """Follows what is in a box from image to image."""

    def __init__(self, kind: TrackerKind, image: NDArray[np.uint8], box: Box) -> None:
        """``box`` must have some part in the image; it is cut to it."""
        legacy: Any = cv2.legacy
        create: dict[str, Any] = {
            "csrt": cv2.TrackerCSRT_create,  # pyright: ignore[reportAttributeAccessIssue]
            "kcf": cv2.TrackerKCF_create,  # pyright: ignore[reportAttributeAccessIssue]
            "mosse": legacy.TrackerMOSSE_create,
        }
        self._tracker: Any = create[kind]()
        height, width = image.shape[:2]
        x0, y0 = max(0, round(box.x)), max(0, round(box.y))
        x1, y1 = min(width, round(box.x + box.w)), min(height, round(box.y + box.h))
        self._whole = (x0, y0, max(x1 - x0, 2), max(y1 - y0, 2))
        # a tracker has whole pixels; what the rounding moved is put back
        self._rest = (box.x - x0, box.y - y0, box.w / self._whole[2], box.h / self._whole[3])
        self._tracker.init(image, self._whole)

    def update(self, image: NDArray[np.uint8]) -> Box | None:
        """Returns the object's box in the next image; None when it was lost."""
        try:
            found, box = self._tracker.update(image)
        except cv2.error:  # an image that it cannot have come to from the last one
            return None
        if not found:
            return None
        x, y, w, h = (float(side) for side in box)
        dx, dy, sw, sh = self._rest
        return Box(x + dx, y + dy, w * sw, h * sh) if w > 0.0 and h > 0.0 else None
