"""The part of an image that is at some depth.

Things that touch in the image are separate where they are not equally far away.
"""

from __future__ import annotations

from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from path.arrays import Depths, Singles
from path.observations import Region

GREY = 110  # neither a colour nor dark: no detector takes it for something
HALF = 2  # worked out at half the resolution, where small squares reach far
MEDIAN_PX = 5  # single pixels of depth are noisy and have holes; taken twice
HOLE_PX = 7  # smaller holes are those along edges
SPECK_PX = 3  # smaller islands are noise
# over so few pixels one thing's surface does not change so much
STEP_PX = 3
STEP_M = 0.22
STEP_SIGMAS = 1.0
FAINT = 0.6  # of that: a step's end
CUT_PX = 3  # more than a detector sees over
REACH = 0.25  # of the image's width: what is larger than twice that is not looked for

Number = TypeVar("Number", float, Singles)
Image = NDArray[Any]  # OpenCV's own annotation is wider


def step_limit_m(depth_m: Number, sigma_at_1m_m: float) -> Number:
    """Return by how much (m) depth changes from one thing to another behind it, at least."""
    return STEP_M + STEP_SIGMAS * sigma_at_1m_m * depth_m * depth_m


def without_elsewhere(
    image: NDArray[np.uint8],
    depth_mm: Depths,
    limits_m: tuple[float, float],
    sigma_at_1m_m: float,
    region: Region | None = None,
) -> NDArray[np.uint8]:
    """The image, grey where it is known to show something nearer or farther, and along steps of
    what is between.

    What has no depth stays, cut from what is between, but for the edges of what is elsewhere:
    nothing is lost because depth is missing.

    Args:
        image: (h, w, 3) BGR.
        depth_mm: (h, w), registered to it, 0 where there is none.
        limits_m: between which depths things are to be seen.
        sigma_at_1m_m: noise of a pixel's depth at 1 m; it grows with the square of the depth.
        region: where their middles are to be; far around it all is grey.
    """
    height, width = depth_mm.shape
    reach = REACH * width
    asked = Region(0.0, 0.0, width, height) if region is None else region
    window = Region(asked.x0 - reach, asked.y0 - reach, asked.x1 + reach, asked.y1 + reach).clipped(
        width, height
    )
    shown = np.full_like(image, GREY)
    if window is None:
        return shown
    rows = slice(int(window.y0), int(window.y1) + 1)
    columns = slice(int(window.x0), int(window.x1) + 1)
    kept = _kept(depth_mm[rows, columns], limits_m, sigma_at_1m_m)
    cv2.copyTo(image[rows, columns], kept, shown[rows, columns])
    return shown


def _kept(
    depth_mm: Depths,
    limits_m: tuple[float, float],
    sigma_at_1m_m: float,
) -> Image:
    """Mask (h, w) of what is shown."""
    smooth = cv2.medianBlur(
        cv2.medianBlur(np.ascontiguousarray(depth_mm[::HALF, ::HALF]), MEDIAN_PX), MEDIAN_PX
    )
    near_mm, far_mm = (np.array([min(max(0.0, 1000.0 * each), 65535.0)]) for each in limits_m)
    nothing = np.zeros(1)
    inside = cv2.inRange(smooth, near_mm, far_mm)
    unknown = cv2.morphologyEx(
        cv2.inRange(smooth, nothing, nothing),
        cv2.MORPH_OPEN,
        _square(HOLE_PX),
    )
    kept = cv2.morphologyEx(cv2.bitwise_or(inside, unknown), cv2.MORPH_OPEN, _square(SPECK_PX))
    kept[_steps(smooth, inside, sigma_at_1m_m) > 0] = 0
    border = cv2.bitwise_and(
        cv2.dilate(unknown, _square(CUT_PX)), cv2.dilate(inside, _square(2 * CUT_PX + 1))
    )
    # nearly all of it on the side that has no depth: the other keeps its outline
    kept[border > 0] = 0
    return cv2.resize(kept, depth_mm.shape[::-1], interpolation=cv2.INTER_NEAREST)


def _steps(
    smooth: Image,
    inside: Image,
    sigma_at_1m_m: float,
) -> Image:
    """Mask of lines along the steps between things that are both inside."""
    highest = cv2.dilate(np.where(inside > 0, smooth, np.uint16(0)), _square(STEP_PX)).astype(
        np.float32
    )
    lowest = cv2.erode(np.where(inside > 0, smooth, np.uint16(65535)), _square(STEP_PX)).astype(
        np.float32
    )
    share = (highest - lowest) / (
        np.float32(1000.0) * step_limit_m(lowest / np.float32(1000.0), sigma_at_1m_m)
    )
    found: tuple[int, Image] = cv2.connectedComponents((share > FAINT).astype(np.uint8))
    count, labels = found
    is_step = np.zeros(count, np.uint8)
    is_step[labels[share > 1.0]] = 1  # a faint one only where it goes on from one that is clear
    return cv2.dilate(is_step[labels], _square(CUT_PX))


def _square(side: int) -> NDArray[np.uint8]:
    return np.ones((side, side), np.uint8)
