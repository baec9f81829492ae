"""Arrays by what they hold. Their shapes are said where they are used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]
Image = NDArray[np.uint8]
"""(h, w) grey, or (h, w, 3) in the order B, G, R."""
Depths = NDArray[np.uint16]
"""(h, w), in mm or a device's own unit; 0 where none was measured."""
