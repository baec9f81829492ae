"""The printed pattern of a marker, from OpenCV's dictionaries."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from path.marker.layout import DICTIONARIES


@cache
def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """The predefined dictionary of a layout. Shared: do not change it."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@cache
def cells(dictionary: str, marker_id: int) -> NDArray[np.float64]:
    """Cells of a marker, 0 black and 1 white, shape (bits + 2, bits + 2), black frame included, row
    0 at the top.

    Shared: do not change it.
    """
    side = DICTIONARIES[dictionary][0] + 2
    image = cv2.aruco.generateImageMarker(dictionary_of(dictionary), marker_id, side, borderBits=1)
    return np.ascontiguousarray(image > 127, dtype=np.float64)
