"""The geometry of a D415: where its depth camera is and how it looks, given the colour camera's
calibration.

Depth is measured in an infrared camera 15 mm beside the colour camera and turned against it by a
fraction of a degree, as the factory calibrations that people publish show. Its images are
rectified: no distortion.
"""

from __future__ import annotations

import numpy as np

from path.camera.model import CameraModel
from path.geometry.rotation import exp
from path.geometry.transforms import Pose

DEPTH_FOCAL = 910.0 / 720.0  # of the image's height
# of the principal point from the image's centre, at a height of 720 px
CENTRE_OFFSET_PX = (-3.4, 1.7)
T_COLOR_DEPTH = Pose(exp(np.radians([0.05, -0.04, 0.30])), np.array([0.0150, -0.0012, 0.0003]))


def depth_camera(width: int, height: int) -> CameraModel:
    """Intrinsics of the depth stream at a size."""
    focal = DEPTH_FOCAL * height
    scale = height / 720.0
    cx, cy = (
        0.5 * (size - 1) + scale * off
        for size, off in zip((width, height), CENTRE_OFFSET_PX, strict=True)
    )
    return CameraModel(width, height, focal, focal, cx, cy)
