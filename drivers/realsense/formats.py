"""Colour as a RealSense camera may give it or a recording may hold it, and how it becomes BGR."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from path.arrays import Image

COLOR_FORMATS = ("bgr8", "rgb8", "bgra8", "rgba8", "yuyv", "uyvy")
"""What is taken, the first that is there. librealsense's viewer records RGB, PATH BGR."""
YUV = {"yuyv": cv2.COLOR_YUV2BGR_YUY2, "uyvy": cv2.COLOR_YUV2BGR_UYVY}


def bgr_of(data: Any, name: str) -> Image:
    """Return colour (h, w, 3) BGR; a view of ``data`` where nothing has to be computed.

    Args:
        data: as ``frame.get_data()`` gives it. ``name``: of its format, one of ``COLOR_FORMATS``.
    """
    pixels = np.asanyarray(data)
    if name == "bgr8":
        return pixels
    if name == "bgra8":
        return pixels[..., :3]
    if name in ("rgb8", "rgba8"):
        return pixels[..., 2::-1]
    halves = pixels.view(np.uint8).reshape(*pixels.shape[:2], 2)
    return np.asarray(cv2.cvtColor(halves, YUV[name]), np.uint8)
