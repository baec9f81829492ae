"""Reads the frames that ``drivers.log.frames`` has written."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Metadata

from drivers.interfaces import Frame
from drivers.log.frames import DEPTH_SCHEMA, VIDEO_SCHEMA
from drivers.log.index import MAGIC, OFFSET
from drivers.log.protobuf import fields
from drivers.log.scan import messages
from path.arrays import Depths, Image


def recorded_frames(file: Path, count: int | None = None) -> Iterator[Frame]:
    """The frames of such a file in order, numbered from 0, up to where it ends; ``count`` of them
    at the most.

    Stamps are of the program's clock. Raises OSError, and ValueError for what holds no such frames.
    """
    decoder = VideoDecoder()
    number = 0
    offset_ns = 0
    waiting = None
    with file.open("rb") as opened:
        if opened.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{file} is not an MCAP file")
        for found in messages(opened):
            if isinstance(found, Metadata):
                offset_ns = int(found.metadata.get(OFFSET, offset_ns))
            elif found.channel.schema.name == VIDEO_SCHEMA:
                if waiting is not None:
                    yield waiting
                    waiting = None
                if count is not None and number >= count:
                    return
                color = decoder.decode(video_data(found.data))
                waiting = Frame(found.utc_ns - offset_ns, number, color, None)
                number += 1
            elif found.channel.schema.name == DEPTH_SCHEMA and waiting is not None:
                yield Frame(waiting.stamp_ns, waiting.frame_id, waiting.color, depth_of(found.data))
                waiting = None
    if waiting is not None:
        yield waiting


class VideoDecoder:
    """H.264, one picture for each message."""

    def __init__(self) -> None:
        self._av: Any = importlib.import_module("av")
        self._codec: Any = self._av.CodecContext.create("h264", "r")
        self._codec.thread_count = 1
        self._codec.flags |= self._av.codec.context.Flags.low_delay

    def decode(self, data: bytes) -> Image:
        """The pixels, BGR (h, w, 3). Raises ValueError for what is no picture."""
        import cv2  # noqa: PLC0415

        try:
            (frame,) = self._codec.decode(self._av.Packet(data))
        except (self._av.FFmpegError, ValueError) as error:
            raise ValueError(f"a frame that is none: {error}") from error
        return np.asarray(
            cv2.cvtColor(frame.to_ndarray(format="yuv420p"), cv2.COLOR_YUV2BGR_I420), np.uint8
        )


def video_data(message: bytes) -> bytes:
    """The bytes of the stream in a CompressedVideo."""
    return next(
        (value for number, value in fields(message) if number == 3 and isinstance(value, bytes)),
        b"",
    )


def depth_of(message: bytes) -> Depths:
    """The depth, mm, of a RawImage as it was recorded. Raises ValueError for another one."""
    values = dict(fields(message))
    width, height, encoding, data = (values.get(number) for number in (2, 3, 4, 6))
    if encoding != b"16UC1" or not isinstance(data, bytes) or not isinstance(width, int):
        raise ValueError("a depth image that is not 16UC1")
    return np.frombuffer(data, "<u2").reshape(-1, width) if height else np.zeros((0, 0), np.uint16)
