"""What of an image is at some depth: things that touch in the image are not, where they are not equally far away."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

GREY = 110  # neither a colour nor dark: no detector takes it for something
MEDIAN_PX = 5  # single pixels of depth are noisy and have holes
HOLE_PX = 15  # smaller holes are those along edges


def without_elsewhere(
    image: NDArray[np.uint8], depth_mm: NDArray[np.uint16], near_m: float, far_m: float
) -> NDArray[np.uint8]:
    """The image, grey where it is known to show something nearer or farther.

    What has no depth stays, but for the edges of what is elsewhere: nothing is lost because depth is missing.

    Args:
        image: (h, w, 3) BGR.
        depth_mm: (h, w), registered to it, 0 where there is none.
    """
    smooth = cv2.medianBlur(depth_mm, MEDIAN_PX)
    near_mm, far_mm = (np.array([min(max(0.0, 1000.0 * each), 65535.0)]) for each in (near_m, far_m))
    nothing = np.zeros(1)
    unknown = cv2.morphologyEx(cv2.inRange(smooth, nothing, nothing), cv2.MORPH_OPEN, np.ones((HOLE_PX, HOLE_PX)))
    kept = cv2.bitwise_or(cv2.inRange(smooth, near_mm, far_mm), unknown)
    shown = np.full_like(image, GREY)
    cv2.copyTo(image, kept, shown)
    return shown
