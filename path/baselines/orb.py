"""ORB: the hand-crafted baseline of the paper."""

from __future__ import annotations

import cv2
import numpy as np

from path.baselines.features import Distance, Image, Keypoints
from path.values import frozen


@frozen
class OrbConfig:
    """
    Attributes:
        features: at most this many in one image.
        levels, scale_factor: of the pyramid.
        fast_threshold: grey levels by which a ring of pixels must differ from its middle; low,
            because clothes have little contrast.
        patch_px: side of the described patch; the image's border of about half of that has no
            features.
    """

    features: int = 800
    levels: int = 8
    scale_factor: float = 1.2
    fast_threshold: int = 5
    patch_px: int = 31


class Orb:
    """Implements ``path.baselines.features.Features``."""

    distance: Distance = "hamming"
    side_px: int | None = None

    def __init__(self, config: OrbConfig | None = None) -> None:
        used = config or OrbConfig()
        self._orb = cv2.ORB.create(
            nfeatures=used.features,
            scaleFactor=used.scale_factor,
            nlevels=used.levels,
            edgeThreshold=used.patch_px // 2 + 1,
            patchSize=used.patch_px,
            fastThreshold=used.fast_threshold,
        )

    def extract(self, image: Image) -> Keypoints:
        """Features of a uint8 image, BGR (h, w, 3) or grey (h, w)."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        found, descriptors = self._orb.detectAndCompute(grey, None)
        if not found:
            return Keypoints(
                np.zeros((0, 2), np.float32),
                np.zeros((0, 32), np.uint8),
                np.zeros(0, np.float32),
            )
        points = np.array([point.pt for point in found], np.float32)
        return Keypoints(
            points,
            descriptors,
            np.array([point.response for point in found], np.float32),
        )
