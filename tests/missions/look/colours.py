"""Colours as people see them: contrast, and what is left of a difference to the colour-blind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TEN_TIMES_SEEN = 23.0  # in CIELAB a difference of 2.3 is just seen
RGB = NDArray[np.float64]
SEEN_BY = {
    "protan": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)),
    "deutan": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)),
    "tritan": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)),
}  # fmt: skip
"""Machado, Oliveira and Fernandes 2009, severity 1: linear RGB as the colour-blind see it."""


def linear(code: bytes) -> RGB:
    share = np.frombuffer(code, np.uint8) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def contrast(one: RGB, other: RGB) -> float:
    """WCAG 2.2's."""
    weights = np.array([0.2126, 0.7152, 0.0722])
    light = sorted((float(weights @ one), float(weights @ other)))
    return (light[1] + 0.05) / (light[0] + 0.05)


def lab(rgb: RGB) -> RGB:
    """CIELAB, D65: there a difference of 2.3 is just seen."""
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    share = np.clip(to_xyz @ rgb, 0.0, None) / np.array([0.9505, 1.0, 1.089])
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def difference(one: RGB, other: RGB, who: str) -> float:
    """Return how far apart two colours are to somebody who is colour-blind, in CIELAB."""
    as_seen = np.array(SEEN_BY[who])
    first, second = (np.clip(as_seen @ each, 0.0, 1.0) for each in (one, other))
    return float(np.linalg.norm(lab(first) - lab(second)))
