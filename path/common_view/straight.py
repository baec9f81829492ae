"""Pictures as a lens without distortion would take them."""

from __future__ import annotations

import cv2
import numpy as np

from path.arrays import Depths, Image, Singles
from path.camera.model import CameraModel


class Straightened:
    """Takes the distortion out of one camera's pictures.

    Attributes:
        camera: the lens that they then have.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = lens = straight(camera)
        self._places: tuple[Singles, Singles] | None = None
        if any(camera.distortion):
            v, u = np.mgrid[0 : lens.height, 0 : lens.width].astype(np.float64)
            rays = np.stack([(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, np.ones_like(u)], -1)
            pixels = camera.project(rays.reshape(-1, 3)).astype(np.float32)
            self._places = (pixels[:, 0].reshape(u.shape), pixels[:, 1].reshape(u.shape))

    def pictures(self, color: Image, depth: Depths) -> tuple[Image, Depths]:
        """Return a colour picture, and depth that is registered to it."""
        if self._places is None:
            return color, depth
        flat = np.asarray(cv2.remap(color, *self._places, cv2.INTER_LINEAR), np.uint8)
        # Between a near and a far surface there is none.
        far = np.asarray(cv2.remap(depth, *self._places, cv2.INTER_NEAREST), np.uint16)
        return flat, far


def straight(camera: CameraModel) -> CameraModel:
    """Return a camera's lens without its distortion."""
    return CameraModel(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
