"""Video files through PyAV (FFmpeg), which has no types: wrapped here."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from drivers.recordings.h264 import pictures
from path.arrays import Image

VIDEO_SUFFIXES = (
    ".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".h264", ".264", ".h265", ".265", ".hevc", ".ts", ".mpg",
    ".mjpeg", ".mjpg",
)  # fmt: skip
BARE = ("h264", "hevc", "mjpeg", "mpegvideo", "m4v", "obu")
"""FFmpeg's names of streams without a container: they have no stamps, and whatever rate it says is
a guess.
"""
# a slice that ends early or late is torn
STRICT = "explode+aggressive+compliant+careful+bitstream+buffer"
NS = 1_000_000_000
Pixels = Callable[[], Image]


class VideoError(Exception):
    """A video file cannot be opened, or is damaged."""


class RateMissing(VideoError):
    """A bare stream, and nobody says how many pictures a second it has."""


@dataclass(slots=True)
class Damage:
    """What of a video gave no frame: ``lost`` pictures are missing, ``torn`` ones lean on those or
    are damaged.
    """

    lost: int = 0
    torn: int = 0

    @property
    def text(self) -> str:
        """One line; "" when nothing is."""
        if not self.lost and not self.torn:
            return ""
        return (
            f"{self.lost} pictures are missing and {self.torn} are torn: they are no frames, "
            "and time goes on over them"
        )


def video_frames(
    file: Path,
    rate_hz: float | None,
    damage: Damage,
) -> Iterator[tuple[int, Pixels]]:
    """Presentation stamp (ns from the first frame) and pixels, BGR (h, w, 3) when called, of each
    frame in order.

    A picture that leans on a lost or damaged one is none: until the next one that leans on nothing
    there is no frame.

    Args:
        rate_hz: of a bare stream, which has no stamps. ``damage``: is counted anew.

    Raises:
        RateMissing: a bare stream without a rate.
        VideoError: where reading fails.
    """
    av: Any = importlib.import_module("av")  # loads a large library
    damage.lost = damage.torn = 0
    try:
        with av.open(str(file)) as container:
            if not container.streams.video:
                raise VideoError("there is no video stream in it")
            stream = container.streams.video[0]
            bare = str(container.format.name)
            if bare in BARE and rate_hz is None:
                raise RateMissing(
                    f"it is a bare stream ({bare}), which does not say how many pictures a second it has"
                )
            if bare == "h264":
                yield from _bare_h264(av, file, rate_hz or 0.0, damage)
                return
            stream.thread_type = "AUTO"
            rate = Fraction(rate_hz) if bare in BARE and rate_hz else None
            yield from _stamped(container.decode(stream), stream, rate, damage)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise VideoError(
            f"it cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error


def _stamped(
    frames: Iterator[Any],
    stream: Any,
    given: Fraction | None,
    damage: Damage,
) -> Iterator[tuple[int, Pixels]]:
    rate: Fraction = given or stream.average_rate or stream.guessed_rate or Fraction(30)
    first: int | None = None
    whole = True
    for number, frame in enumerate(frames):
        whole = not frame.is_corrupt and (whole or frame.key_frame)
        if not whole:
            damage.torn += 1
            continue
        if given is not None or frame.pts is None or frame.time_base is None:
            stamp_ns = round(NS * number / rate)
        else:
            stamp_ns = int(NS * frame.pts * frame.time_base)
        first = stamp_ns if first is None else first
        yield stamp_ns - first, _pixels_of(frame)


def _bare_h264(
    av: Any,
    file: Path,
    rate_hz: float,
    damage: Damage,
) -> Iterator[tuple[int, Pixels]]:
    """Decode picture by picture: each has its place in time, and what leans on a lost one is left
    out.
    """
    codec = av.CodecContext.create("h264", "r")
    codec.thread_type = "NONE"
    codec.options = {"err_detect": STRICT}  # else it conceals, and does not always say so
    believed: dict[int, bool] = {}
    whole, first = False, None
    begun = 0  # the place from which on pictures are whole; what is shown before leans on lost ones
    given = 0

    def whole_ones(packet: Any) -> Iterator[tuple[int, Any]]:
        nonlocal whole, given
        try:
            frames = codec.decode(packet)
        except av.FFmpegError:
            whole = False
            return
        for frame in frames:
            leans_back = frame.pts < begun
            if frame.is_corrupt and not leans_back:
                whole = False
            if frame.is_corrupt or leans_back or not believed.get(frame.pts, False):
                continue
            given += 1
            yield frame.pts, frame

    seen = pictures(file.read_bytes())
    for taken, picture in enumerate(seen, 1):
        damage.lost += picture.gap
        before = whole
        whole = not picture.is_cut and (picture.fresh or (whole and not picture.gap))
        if whole and not before:
            begun = picture.place
        believed[picture.place] = whole
        packet = av.Packet(picture.data)
        packet.pts = picture.place
        for place, frame in whole_ones(packet):
            first = place if first is None else first
            damage.torn = taken - given
            yield round(NS * (place - first) / rate_hz), _pixels_of(frame)
    for place, frame in whole_ones(None):
        first = place if first is None else first
        yield round(NS * (place - first) / rate_hz), _pixels_of(frame)
    damage.torn = len(seen) - given


def _pixels_of(frame: Any) -> Pixels:
    return lambda: np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
