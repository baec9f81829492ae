"""A detector of one's own: what is orange. A rig beside it names it ``orange.py:Orange``."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.rig.parts import PartContext
from path.observations import Box, Detection, Region


@dataclass(frozen=True)
class OrangeConfig:
    """The part of the hue circle that is orange (OpenCV's half degrees), and how few pixels are
    nothing.
    """

    least_hue: int = 5
    most_hue: int = 20
    least_px: int = 30


class Orange:
    """Made by the rig with its table and the part's context; ``detect`` is asked for every
    frame.
    """

    Config = OrangeConfig

    def __init__(self, config: OrangeConfig, context: PartContext) -> None:
        self._config = config

    def detect(self, image: NDArray[np.uint8], region: Region | None) -> list[Detection]:
        """image: (h, w, 3) uint8 BGR. region: where it is looked for (x0, y0, x1, y1 px), or None
        for everywhere.
        """
        config = self._config
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        orange = cv2.inRange(hsv, (config.least_hue, 120, 80), (config.most_hue, 255, 255))
        orange = cv2.dilate(orange, np.ones((3, 3), np.uint8))
        _, _, stats, _ = cv2.connectedComponentsWithStats(orange)
        boxes = [
            Box(x, y, w, h) for x, y, w, h, area in stats[1:].tolist() if area >= config.least_px
        ]
        if region is not None:
            boxes = [box for box in boxes if self._centre_in(box, region)]
        return [Detection(box, 0.9) for box in boxes]

    def _centre_in(self, box: Box, region: Region) -> bool:
        u, v = box.center
        return region.x0 <= u <= region.x1 and region.y0 <= v <= region.y1
