"""Every frame of a camera in a file of its own beside the log: ``NAME.frames.mcap``;
``drivers.log.video`` reads it.

    /video   foxglove.CompressedVideo, H.264 (Annex B, no B frames, a key frame every KEY_FRAMES)
    /depth   foxglove.RawImage, 16UC1 in millimetres, as the camera gave it

A thread of lower priority encodes and writes; a program that flies puts frames into its queue,
which drops, and never waits. Each frame is a chunk of its own, on its way to the disk when the next
one is encoded: a killed program loses what was in the queue. In virtual time nobody waits for
anything, and frames are encoded at once.
"""

from __future__ import annotations

import importlib
import os
import queue
import threading
import time
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from drivers.interfaces import Frame
from drivers.log.index import ABOUT, OFFSET, ChunkedFile, built, message_record
from path.arrays import Image
from path.values import frozen

VIDEO = "/video"
DEPTH = "/depth"
VIDEO_SCHEMA = "foxglove.CompressedVideo"
DEPTH_SCHEMA = "foxglove.RawImage"
SUFFIX = ".frames"
QUEUED = 12  # frames that wait; 1.5 MB each at 640 x 480
KEY_FRAMES = 30
# of x264, constant rate factor: 0 loses nothing of what 4:2:0 leaves, 23 is usual for films
QUALITY = "18"
NICE = 10
CLOSE_S = 3.0
_OPTIONS = {
    "preset": "ultrafast",
    "tune": "zerolatency",
    "crf": QUALITY,
    "g": str(KEY_FRAMES),
    "bf": "0",
}
_MICROSECONDS = Fraction(1, 1_000_000)


@frozen
class RecordingCounts:
    """``taken``: frames that were asked for; ``dropped`` of them were not recorded. ``spent_ns``:
    of a processor.
    """

    taken: int
    dropped: int
    bytes: int
    spent_ns: int


class FrameRecorder:
    """The frames of one program. Never raises: what goes wrong is kept in ``failed``, and the
    flight goes on.
    """

    def __init__(
        self,
        log: Path,
        name: str,
        utc_minus_stamp_ns: int,
        *,
        waits: bool = False,
    ) -> None:
        """``log``: the program's log, whose neighbour this is. ``waits``: each frame is encoded at
        once, here.
        """
        self.failed: str | None = None
        self._path = frames_of(log)
        self._utc_ns = utc_minus_stamp_ns
        self._writer = _FrameFile(self._path, name, utc_minus_stamp_ns)
        self._taken = self._dropped = self._spent_ns = 0
        self._stopped = False
        self._queue: queue.Queue[Frame | None] = queue.Queue(QUEUED)
        self._thread: threading.Thread | None = None
        if not waits:
            self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
            self._thread.start()

    @property
    def counts(self) -> RecordingCounts:
        return RecordingCounts(self._taken, self._dropped, self._writer.bytes, self._spent_ns)

    def take(self, frame: Frame) -> None:
        """Record a frame, or drop it. Its arrays may be written over afterwards."""
        self._taken += 1
        if self.failed is not None or self._stopped:
            self._dropped += 1
        elif self._thread is None:
            self._record(frame)
        elif self._queue.full():
            self._dropped += 1
        else:
            depth_mm = None if frame.depth_mm is None else frame.depth_mm.copy()
            with suppress(queue.Full):  # there is one who puts
                self._queue.put_nowait(
                    Frame(frame.stamp_ns, frame.frame_id, frame.color.copy(), depth_mm)
                )

    def close(self) -> None:
        """Record what waits, for a bounded time, and close. Closing twice does nothing."""
        if self._stopped:
            return
        self._stopped = True
        if self._thread is None:
            self._end()
            return
        try:
            self._queue.put(None, timeout=CLOSE_S)
        except queue.Full:
            self.failed = self.failed or f"{self._path}: frames could not be written in time"
            return
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self.failed = self.failed or f"{self._path}: frames could not be written in time"

    def _run(self) -> None:
        with suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (frame := self._queue.get()) is not None:
            if self.failed is None:
                self._record(frame)
            else:
                self._dropped += 1
        self._end()

    def _record(self, frame: Frame) -> None:
        began_ns = time.thread_time_ns()
        try:
            self._writer.write(frame)
        # whatever was wrong with this frame or the disk: the flight goes on
        except Exception as error:
            self.failed = (
                f"frames not recorded: {getattr(error, 'strerror', None) or error}: {self._path}"
            )
        self._spent_ns += time.thread_time_ns() - began_ns

    def _end(self) -> None:
        try:
            self._writer.close()
        except OSError as error:
            self.failed = (
                self.failed or f"frames not recorded: {error.strerror or error}: {self._path}"
            )


class _FrameFile:
    """The file and its encoder, opened with the first frame. Raises OSError, ValueError and what
    FFmpeg raises.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        utc_minus_stamp_ns: int,
    ) -> None:
        self.bytes = 0
        self._path = path
        self._name = name
        self._utc_ns = utc_minus_stamp_ns
        self._frame_id = f"{name}/camera" if name else "camera"
        self._file: ChunkedFile | None = None
        self._encoder: Any = None
        self._count = 0
        self._first_ns = 0

    def write(self, frame: Frame) -> None:
        from drivers.log import foxglove_primitives as foxglove  # noqa: PLC0415 (whoever only reads does not need it)

        utc_ns = frame.stamp_ns + self._utc_ns
        height, width = frame.color.shape[:2]
        if self._file is None:
            self._open(width, height)
            self._first_ns = frame.stamp_ns
        video = self._encoded(frame.color, (frame.stamp_ns - self._first_ns) // 1000)
        self._message(1, utc_ns, foxglove.compressed_video(utc_ns, self._frame_id, video).encode())
        if frame.depth_mm is not None:
            self._message(
                2,
                utc_ns,
                foxglove.depth_image(utc_ns, self._frame_id, frame.depth_mm).encode(),
            )
        assert self._file is not None
        self.bytes += self._file.end_chunk()

    def close(self) -> None:
        file = self._file
        self._file = None
        if file is not None:
            file.close()

    def _open(self, width: int, height: int) -> None:
        from drivers.log import foxglove_primitives as foxglove  # noqa: PLC0415

        if width % 2 or height % 2:
            raise ValueError(f"{width}x{height} px: H.264 needs even numbers")
        codec: Any = importlib.import_module("av").CodecContext.create("libx264", "w")
        codec.width = width
        codec.height = height
        codec.pix_fmt = "yuv420p"
        codec.time_base = _MICROSECONDS
        codec.thread_count = 1
        codec.options = _OPTIONS
        self._encoder = codec
        file = self._file = ChunkedFile(self._path)
        file.say(Opcode.HEADER, built(Header("", "path")))
        about = {"name": self._name, OFFSET: str(self._utc_ns)}
        file.say(Opcode.METADATA, built(Metadata(name=ABOUT, metadata=about)))
        for number, (topic, schema) in enumerate(
            ((VIDEO, foxglove.VIDEO), (DEPTH, foxglove.RAW)), 1
        ):
            file.say(
                Opcode.SCHEMA, built(Schema(number, schema.data, schema.encoding, schema.name))
            )
            file.say(Opcode.CHANNEL, built(Channel(number, topic, "protobuf", {}, number)))

    def _encoded(self, color: Image, at_us: int) -> bytes:
        import cv2  # noqa: PLC0415

        av: Any = importlib.import_module("av")
        frame = av.VideoFrame.from_ndarray(
            cv2.cvtColor(color, cv2.COLOR_BGR2YUV_I420), format="yuv420p"
        )
        frame.pts = at_us
        frame.time_base = _MICROSECONDS
        return b"".join(bytes(packet) for packet in self._encoder.encode(frame))

    def _message(
        self,
        channel: int,
        utc_ns: int,
        data: bytes,
    ) -> None:
        assert self._file is not None
        self._count += 1
        self._file.message(channel, utc_ns, message_record(channel, self._count, utc_ns, data))


def frames_of(log: Path) -> Path:
    """The file of a log's frames."""
    return log.with_name(f"{log.stem}{SUFFIX}.mcap")


def is_frames(file: Path) -> bool:
    return file.stem.endswith(SUFFIX)
