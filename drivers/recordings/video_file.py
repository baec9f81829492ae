"""Video files through PyAV (FFmpeg), which has no types: wrapped here."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".h264", ".264", ".h265", ".ts", ".mpg", ".mjpeg")
NS = 1_000_000_000


class VideoError(Exception):
    """A video file cannot be opened, or is damaged."""


def video_frames(file: Path) -> Iterator[tuple[int, Callable[[], NDArray[np.uint8]]]]:
    """Presentation stamp (ns from the first frame) and pixels, BGR (h, w, 3) when called, of each frame in order.

    Frames without a stamp, as in a bare H.264 stream, get that of the stream's mean rate.

    Raises:
        VideoError: where reading fails.
    """
    av: Any = importlib.import_module("av")  # loads a large library
    try:
        with av.open(str(file)) as container:
            if not container.streams.video:
                raise VideoError("there is no video stream in it")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            yield from _stamped(container.decode(stream), stream)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise VideoError(f"it cannot be read: {getattr(error, 'strerror', None) or error}") from error


def _stamped(frames: Iterator[Any], stream: Any) -> Iterator[tuple[int, Callable[[], NDArray[np.uint8]]]]:
    rate: Fraction = stream.average_rate or stream.guessed_rate or Fraction(30)
    first = 0
    for number, frame in enumerate(frames):
        if frame.pts is None or frame.time_base is None:
            stamp_ns = round(NS * number / rate)
        else:
            stamp_ns = int(NS * frame.pts * frame.time_base)
        first = stamp_ns if number == 0 else first
        yield stamp_ns - first, lambda frame=frame: np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
