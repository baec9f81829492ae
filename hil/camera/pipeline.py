"""The imaging of a camera, from light to image: what ``flight.harness.renderer.Imaging`` describes,
in its order.

Optics and sensor work on light, 0..255 linear; gamma and everything after it on the image.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from flight.harness.renderer import Imaging
from hil.render.mosaic import as_yuyv
from path.arrays import Array, Image

Light = NDArray[np.float32]  # (h, w, 3) in the order B, G, R

BLUR_REACH = 3.3  # standard deviations
SLOWEST_MOTION_PX = 1e-6
FINE = 256.0  # steps of a grey level that the interpolation of the mosaic keeps
# an intra frame and two that follow: what comes out is a frame of a running stream
STREAM_FRAMES = 3
STREAM_STEP_PX = 4  # most that the view moves between frames of a stream, per axis
STREAM_RATE = 30


def is_plain(imaging: Imaging) -> bool:
    """Return whether an image is no more than blurred light with noise."""
    plain = Imaging(imaging.blur_sigma_px, imaging.read_sigma, imaging.shot_gain)
    return imaging == plain


def develop(
    light: Image,
    imaging: Imaging,
    rng: np.random.Generator,
) -> Image:
    """Image of ``light``, shape (3, h, w) in the order B, G, R.

    Raises:
        ValueError: H.264 of an odd width or height.
    """
    seen = through_optics(np.ascontiguousarray(np.moveaxis(light, 0, -1), np.float32), imaging)
    if imaging.h264_crf is not None:
        return _last_of_stream(seen, imaging, imaging.h264_crf, rng)
    image = process(expose(seen, imaging, rng), imaging)
    return image if imaging.jpeg_quality is None else jpeg(image, imaging.jpeg_quality)


def through_optics(light: Light, imaging: Imaging) -> Light:
    """Blur of the lens and of the motion during the exposure."""
    kernel = blur_kernel(imaging.blur_sigma_px, imaging.motion_px)
    return light if kernel.size == 1 else _filtered(light, kernel)


def blur_kernel(sigma_px: float, motion_px: tuple[float, float]) -> Array:
    """A Gaussian drawn out along a line of length and direction ``motion_px``, (k, k), sum 1."""
    length = float(np.hypot(*motion_px))
    if sigma_px < 0.1 and length < SLOWEST_MOTION_PX:
        return np.ones((1, 1))
    sigma = max(sigma_px, 0.3)  # a line alone cannot be sampled at pixels
    reach = int(np.ceil(BLUR_REACH * sigma + 0.5 * length))
    offsets = np.arange(-reach, reach + 1)
    steps = max(1, int(np.ceil(8.0 * length)))
    kernel = np.zeros((len(offsets), len(offsets)))
    for part in (np.arange(steps) + 0.5) / steps - 0.5:
        u = offsets - part * motion_px[0]
        v = offsets - part * motion_px[1]
        kernel += np.exp(-0.5 * (v / sigma) ** 2)[:, None] * np.exp(-0.5 * (u / sigma) ** 2)
    return kernel / kernel.sum()


def _filtered(light: Light, kernel: Array) -> Light:
    """The kernel is symmetric about its centre. A Gaussian without motion is separable, and faster
    so.
    """
    column = kernel.sum(axis=1)
    row = kernel.sum(axis=0)
    if np.allclose(np.outer(column, row), kernel, atol=1e-12):
        filtered = cv2.sepFilter2D(light, cv2.CV_32F, row, column, borderType=cv2.BORDER_REPLICATE)
    else:
        filtered = cv2.filter2D(light, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, np.float32)


def expose(
    seen: Light,
    imaging: Imaging,
    rng: np.random.Generator,
) -> Light:
    """Light as the sensor measures it, with noise, 0..255; through a mosaic when there is one."""
    lit = seen * np.float32(imaging.exposure)
    if not imaging.mosaic:
        return _measured(lit, imaging, rng)
    return _interpolated(_measured(_mosaic(lit), imaging, rng))


def _measured(
    lit: Light,
    imaging: Imaging,
    rng: np.random.Generator,
) -> Light:
    variance = np.float32(imaging.read_sigma**2) + np.float32(imaging.shot_gain) * lit
    noisy = lit + np.sqrt(variance) * rng.standard_normal(lit.shape, np.float32)
    return np.clip(noisy, np.float32(0.0), np.float32(255.0))


def _mosaic(lit: Light) -> Light:
    """One colour a pixel: R G / G B from the top left corner, shape (h, w)."""
    raw = lit[..., 1].copy()
    raw[::2, ::2] = lit[::2, ::2, 2]
    raw[1::2, 1::2] = lit[1::2, 1::2, 0]
    return raw


def _interpolated(raw: Light) -> Light:
    """Colours again, interpolated along edges; a border of one pixel is copied from within."""
    fine = np.round(raw * np.float32(FINE)).astype(np.uint16)
    # OpenCV names the pattern by its second row
    color = cv2.demosaicing(fine, cv2.COLOR_BayerBG2BGR_EA)
    return np.asarray(color, np.float32) / np.float32(FINE)


def process(measured: Light, imaging: Imaging) -> Image:
    """Gamma, sharpening, 8 bit and YUYV, of 0..255."""
    image = measured
    if imaging.gamma != 1.0:
        image = np.float32(255.0) * cv2.pow(image / np.float32(255.0), 1.0 / imaging.gamma)
    if imaging.yuyv:
        plain = (image + np.float32(0.5)).astype(np.uint8)
        return as_yuyv(plain, imaging.sharpen, imaging.sharpen_sigma_px)
    if imaging.sharpen == 0.0:
        return (image + np.float32(0.5)).astype(np.uint8)
    blurred = cv2.GaussianBlur(
        image,
        (0, 0),
        imaging.sharpen_sigma_px,
        borderType=cv2.BORDER_REPLICATE,
    )
    sharp = cv2.addWeighted(
        image,
        1.0 + imaging.sharpen,
        blurred,
        -imaging.sharpen,
        0.0,
        dtype=cv2.CV_8U,
    )
    return np.asarray(sharp, np.uint8)


def jpeg(image: Image, quality: int) -> Image:
    """Compressed and decoded (colour at half the resolution, OpenCV's default)."""
    done, packed = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality))
    if not done:
        raise ValueError("an image could not be compressed as JPEG")
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)


def _last_of_stream(
    seen: Light,
    imaging: Imaging,
    crf: int,
    rng: np.random.Generator,
) -> Image:
    """The last frame of a short stream in which the view moves evenly by a few pixels a frame, to
    its place.
    """
    step = rng.integers(-STREAM_STEP_PX, STREAM_STEP_PX, 2, endpoint=True)
    frames: list[Image] = []
    for ahead in range(STREAM_FRAMES - 1, -1, -1):
        moved = np.roll(seen, tuple(ahead * step), axis=(0, 1)) if ahead else seen
        frames.append(process(expose(moved, imaging, rng), imaging))
    return h264(frames, crf)[-1]


def h264(frames: list[Image], crf: int) -> list[Image]:
    """Frames of a stream, encoded as a small device does, without looking ahead, and decoded.

    Raises:
        ValueError: an odd width or height.
    """
    import av  # noqa: PLC0415 (loads a large library; few trials need it)

    height, width = frames[0].shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"h264_crf: an image of {width} x {height} px has an odd side")
    encoder: Any = av.CodecContext.create("libx264", "w")
    encoder.width = width
    encoder.height = height
    encoder.pix_fmt = "yuv420p"
    encoder.time_base = Fraction(1, STREAM_RATE)
    encoder.thread_count = 1  # the same bytes on every machine
    encoder.options = {"crf": str(crf), "preset": "veryfast", "tune": "zerolatency", "threads": "1"}
    decoder: Any = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    packets: list[Any] = []
    for number, image in enumerate(frames):
        frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuv420p")
        frame.pts = number
        packets += encoder.encode(frame)
    packets += encoder.encode(None)
    decoded = [frame for packet in packets for frame in decoder.decode(packet)]
    decoded += decoder.decode(None)
    return [np.asarray(frame.to_ndarray(format="bgr24"), np.uint8) for frame in decoded]
