"""The imaging of a colour sensor behind a mosaic, delivered as YUYV: blur, mosaic, noise,
sharpening, half the colour.

It does what ``hil.camera.pipeline`` does for such an ``Imaging``, in a seventh of the time, which
is what a flight has for it: between its steps there are 8 bits.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from flight.harness.renderer import Imaging
from hil.render.sensor import POOL_MARGIN, POOL_UNIT, blur_row, blur_taps
from hil.render.shutter import LONGEST_PX, blurred_px
from path.arrays import Image
from path.compiled import kernel

F = np.float32
# BT.601, for each of two pixels
U_OF = F(56.0 / 255.0 / (1.0 - 0.114))
V_OF = F(56.0 / 255.0 / (1.0 - 0.299))
LIMITED = F(219.0 / 255.0)  # brightness is 16 to 235
SCRATCH_PLANES = 7  # blue, green, red, brightness, that blurred, and YUYV in two


def is_quick(imaging: Imaging) -> bool:
    """Return whether ``MosaicSensor`` does all that an imaging asks for."""
    same = Imaging(
        imaging.blur_sigma_px, imaging.read_sigma, imaging.shot_gain, mosaic=True, sharpen=imaging.sharpen,
        sharpen_sigma_px=imaging.sharpen_sigma_px, yuyv=True,
    )  # fmt: skip
    return imaging == same


class MosaicSensor:
    """One camera's sensor. It keeps scratch buffers: use it from one thread at a time."""

    def __init__(self, imaging: Imaging, height: int, width: int, pool: NDArray[np.int8]) -> None:
        """``pool``: of unit noise, as ``noise_pool`` makes it. Raises ValueError for an imaging
        that is not quick.
        """
        if not is_quick(imaging):
            raise ValueError(f"imaging: {imaging!r} takes more than this sensor does")
        self._imaging = imaging
        self._pool = pool
        most = blur_taps(blurred_px(imaging.blur_sigma_px, LONGEST_PX)).size
        self._rows = np.empty((3, width + 2 * most), np.float32)
        self._raw = np.empty((height, width), np.uint8)
        self._scratch = np.empty((SCRATCH_PLANES, height, width), np.uint8)

    def image(self, light: Image, key: int, smear_px: tuple[float, float] = (0.0, 0.0)) -> Image:
        """The image (h, w, 3), BGR, of light (3, h, w) in the order B, G, R.

        Args:
            key: selects its noise.
            smear_px: motion during the exposure, at most ``LONGEST_PX``: it widens the blur along
                each axis.
        """
        own = self._imaging
        taps, down = (blur_taps(blurred_px(own.blur_sigma_px, length)) for length in smear_px)
        row, column = ((key >> shift) % POOL_MARGIN for shift in (16, 24))
        mosaic(
            light,
            taps,
            down,
            own.read_sigma,
            own.shot_gain,
            self._pool,
            row,
            column,
            self._rows,
            self._raw,
        )
        # OpenCV names the pattern by its second row
        color = cv2.demosaicing(self._raw, cv2.COLOR_BayerBG2BGR_EA)
        return as_yuyv(
            np.asarray(color, np.uint8), own.sharpen, own.sharpen_sigma_px, self._scratch
        )


@kernel
def mosaic(light, taps, down, read_sigma, shot_gain, pool, offset_row, offset_column, rows, raw):
    """Blurred light with noise, one colour a pixel: R G / G B from the top left corner, into
    ``raw`` (h, w).

    taps, down: as in ``blur_row``. rows: float32 scratch (3, w + 2 reach or more).
    """
    height, width = raw.shape
    read2 = F(read_sigma * read_sigma / POOL_UNIT**2)
    gain = F(shot_gain / POOL_UNIT**2)
    padded = rows[0, : width + 2 * (taps.size - 1)]
    even = rows[1, :width]
    odd = rows[2, :width]
    top = F(255.0)
    for r in range(height):
        first = 2 if r % 2 == 0 else 1
        blur_row(light[first], r, taps, down, padded, even)
        blur_row(light[first - 1], r, taps, down, padded, odd)
        for c in range(width):
            even[c] = odd[c] if c & 1 else even[c]
        noise = pool[offset_row + r, offset_column : offset_column + width]
        out = raw[r]
        for c in range(width):
            level = even[c] + np.sqrt(read2 + gain * even[c]) * F(noise[c])
            out[c] = np.uint8(np.int32(min(max(level, F(0.0)), top) + F(0.5)))


def as_yuyv(color: Image, sharpen: float, sigma_px: float, scratch: Image | None = None) -> Image:
    """A picture (h, w, 3), BGR, as it comes through YUYV, its brightness sharpened before.

    scratch: (SCRATCH_PLANES, h, w), written over. To have new memory for each picture takes as long
    as half the steps.

    Raises:
        ValueError: an odd width.
    """
    height, width = color.shape[:2]
    if width % 2:
        raise ValueError(f"yuyv: an image of {width} px is odd in width")
    planes = np.empty((SCRATCH_PLANES, height, width), np.uint8) if scratch is None else scratch
    blue, green, red, grey, blurred = planes[:5]
    cv2.split(color, (blue, green, red))
    cv2.cvtColor(color, cv2.COLOR_BGR2GRAY, grey)
    if sharpen > 0.0:
        size = _blur_size(sigma_px)
        cv2.GaussianBlur(grey, (size, size), sigma_px, blurred, borderType=cv2.BORDER_REPLICATE)
    else:
        blurred = grey
    packed = planes[5:7].reshape(-1).view(np.uint16).reshape(height, width)
    rows = np.empty((2, width + 2), np.float32)
    pack(grey, blurred, blue, red, sharpen, rows, packed)
    return np.asarray(
        cv2.cvtColor(packed.view(np.uint8).reshape(height, width, 2), cv2.COLOR_YUV2BGR_YUY2),
        np.uint8,
    )


@cache
def _blur_size(sigma_px: float) -> int:
    """The smallest kernel that blurs 8 bits as the one that OpenCV takes by itself: its outer
    weights may all be 0.
    """
    line = np.zeros((1, 129), np.uint8)
    line[0, 64] = 255  # shows each weight, of 256
    whole = cv2.GaussianBlur(line, (0, 0), sigma_px)
    for size in range(3, 129, 2):
        if np.array_equal(cv2.GaussianBlur(line, (size, size), sigma_px), whole):
            return size
    return 0


@kernel
def pack(grey, blurred, blue, red, sharpen, rows, packed):
    """YUYV, two bytes in a uint16 (h, w), BT.601 in its limited range, of grey + sharpen (grey -
    blurred).

    U and V are those of two pixels each. rows: float32 scratch (2, w + 2).
    """
    share = F(sharpen)
    half = F(16.5)
    top = F(255.0)
    middle = F(128.5)
    width = grey.shape[1]
    u = rows[0, :width]
    v = rows[1, 1 : 1 + width]
    u_after = rows[0, 1 : 1 + width]
    v_before = rows[1, :width]
    rows[0, width], rows[1, 0] = F(0.0), F(0.0)
    for r in range(grey.shape[0]):
        own = grey[r]
        soft = blurred[r]
        blues = blue[r]
        reds = red[r]
        out = packed[r]
        for c in range(width):
            u[c] = U_OF * (F(blues[c]) - F(own[c]))
            v[c] = V_OF * (F(reds[c]) - F(own[c]))
        for c in range(width):
            level = F(own[c]) + share * (F(own[c]) - F(soft[c]))
            level = LIMITED * min(max(level, F(0.0)), top) + half
            tint = middle + (v[c] + v_before[c] if c & 1 else u[c] + u_after[c])
            out[c] = np.uint16(np.int32(level)) | (np.uint16(np.int32(tint)) << np.uint16(8))
