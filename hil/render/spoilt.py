"""Light that comes to the sensor otherwise than the scene sends it: an exposure that is not the usual
one, and a smudge on the lens.
"""

from __future__ import annotations

import cv2
import numpy as np

from path.arrays import Image

KEEPS = 0.25  # of the picture behind a smudge: the rest is blurred over it
GLARE = 12.0  # grey levels that a smudge adds: light from elsewhere


def spoil(light: Image, times: float, smudge: float, seed: int) -> None:
    """Change light, (3, h, w), in place.

    Args:
        times: what the exposure takes in.
        smudge: share of the image's height that a smudge is wide; where it is, is of the seed.
    """
    if times != 1.0:
        np.copyto(light, np.clip(light * np.float32(times), 0.0, 255.0), casting="unsafe")
    if smudge <= 0.0:
        return
    _, height, width = light.shape
    radius = max(2, round(0.5 * smudge * height))
    across, down = np.random.default_rng([seed, 0x736D64]).uniform(0.3, 0.7, 2)
    left = max(0, round(across * width) - radius)
    top = max(0, round(down * height) - radius)
    part = light[:, top : top + 2 * radius, left : left + 2 * radius]
    y, x = np.ogrid[-1.0 : 1.0 : part.shape[1] * 1j, -1.0 : 1.0 : part.shape[2] * 1j]
    lost = (1.0 - KEEPS) * np.clip(1.5 - 1.5 * np.hypot(x, y), 0.0, 1.0).astype(np.float32)
    for plane in part:
        veiled = cv2.GaussianBlur(plane.astype(np.float32), (0, 0), 0.3 * radius) + GLARE
        np.copyto(plane, np.clip(plane + lost * (veiled - plane), 0.0, 255.0), casting="unsafe")
