"""A method of one's own for ``trial rivals``: the box whose colours are most like those of D1's."""

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.trials.rivals.own import Pair
from path.observations import Box

LEAST_ALIKE = 0.5  # of 1; below it the target is not there


class Hues:
    def choose(self, pair: Pair) -> Box | None:
        wanted = hues(pair.sender.color, pair.box1)
        alike = {
            box: cv2.compareHist(wanted, hues(pair.receiver.color, box), cv2.HISTCMP_CORREL)
            for box in pair.boxes2
        }
        best = max(alike, key=lambda box: alike[box], default=None)
        return best if best is not None and alike[best] >= LEAST_ALIKE else None


def hues(image: NDArray[np.uint8], box: Box) -> NDArray[np.float32]:
    x, y = max(0, round(box.x)), max(0, round(box.y))
    cut = image[y : y + round(box.h), x : x + round(box.w)]
    hsv = cv2.cvtColor(cut, cv2.COLOR_BGR2HSV)
    return cv2.calcHist([hsv], [0, 1], None, [30, 8], [0, 180, 0, 256]).astype(np.float32)
