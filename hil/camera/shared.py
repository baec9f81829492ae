"""Camera frames from the world process to a role process: a ring of slots in shared memory and a
socket that wakes.

The writer never waits for a reader. Each slot says which frame it holds and whether that is whole,
so that a reader that was overtaken notices and takes a newer frame; it never sees a torn one. The
segment is a plain mapped file, not ``multiprocessing.shared_memory``, whose tracker process unlinks
a segment when any one side ends. The writer holds a lock on the file for as long as it lives: that
is how a reader knows at once that the world is gone, and how what a killed writer left behind is
told from what is in use.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import socket
import time
from contextlib import suppress
from typing import Self

import numpy as np

from drivers.interfaces import CameraError
from hil.camera.segment import (
    MAGIC,
    FrameSegment,
    Layout,
    bind,
    folder,
    map_segment,
    remove_abandoned,
    segment_path,
    socket_path,
    writer_lives,
)
from path.arrays import Depths, Image
from path.messages import Role
from path.values import frozen

__all__ = ["RUN_VARIABLE", "SharedCameraReader", "SharedCameraWriter", "SharedFrame", "folder"]

_OPEN_POLL_S = 0.02
RUN_VARIABLE = "PATH_HANDOFF_RUN"
"""Environment variable with the name of the run, set by whoever starts the world and the roles."""


class SharedCameraWriter:
    """The world's end: publishes frames of one role's camera. One writer a name; a context
    manager.
    """

    def __init__(
        self,
        run: str,
        role: Role,
        color_size: tuple[int, int],
        depth_size: tuple[int, int],
        fps: int,
        *,
        slots: int = 4,
    ) -> None:
        if slots < 4:
            raise ValueError(
                f"slots: {slots} is below 4, so that a slow reader would be overtaken at once"
            )
        self._path = segment_path(run, role)
        self._layout = Layout(color_size, depth_size, fps, slots)
        self._sequence = 0
        self._segment: FrameSegment | None = None
        self._handle = -1
        self._socket: socket.socket | None = None

    def __enter__(self) -> Self:
        remove_abandoned()
        if writer_lives(self._path):
            raise CameraError(
                f"{self._path} is already being written",
                "use another run name, or end the other run",
            )
        # Made and locked under another name: nobody can take the finished one for abandoned.
        new = self._path.with_name(f"{self._path.name}.{os.getpid()}.new")
        self._handle = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        fcntl.flock(self._handle, fcntl.LOCK_EX)
        os.ftruncate(self._handle, self._layout.total_bytes)
        memory = mmap.mmap(self._handle, self._layout.total_bytes)
        self._segment = FrameSegment(memory, self._layout)
        self._segment.header[:8] = (MAGIC, *self._layout.words(), 0)
        new.replace(self._path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        return self

    def __exit__(self, *_: object) -> None:
        if self._segment is None:
            return
        assert self._socket is not None
        for path in (self._path, socket_path(self._path)):
            with suppress(FileNotFoundError):
                path.unlink()
        self._socket.close()
        self._segment.close()
        self._segment = None
        os.close(self._handle)

    def write(
        self,
        stamp_ns: int,
        color: Image,
        depth_mm: Depths,
    ) -> None:
        """Publish one frame and wake the reader.

        Args:
            stamp_ns: mid-exposure, CLOCK_MONOTONIC (``time.monotonic_ns``), which all processes
                share.
            color: (h, w, 3) uint8 BGR.
            depth_mm: (h, w) uint16 of the depth camera, which is another one.
        """
        segment = self._segment
        assert segment is not None, "write before entering the context"
        self._sequence += 1
        slot = self._sequence % self._layout.slots
        header = segment.slot_headers[slot]
        header[:] = (2 * self._sequence - 1, stamp_ns)
        np.copyto(segment.colors[slot], color, casting="no")
        np.copyto(segment.depths[slot], depth_mm, casting="no")
        header[0] = 2 * self._sequence
        segment.header[FrameSegment.NEWEST] = self._sequence
        assert self._socket is not None
        # No reader yet, or one whose queue is full and that will wake anyway: either is no concern
        # of the world's.
        with suppress(OSError):
            self._socket.sendto(b"\0", str(socket_path(self._path)))


@frozen
class SharedFrame:
    """One frame where it lies, in memory that the writer will use again: see
    ``SharedCameraReader.is_whole``.
    """

    number: int
    stamp_ns: int
    color: Image
    depth_mm: Depths


class SharedCameraReader:
    """The role's end, for one thread; a context manager. ``skipped`` counts frames replaced before
    they were read.
    """

    def __init__(
        self,
        run: str,
        role: Role,
        open_timeout_s: float,
    ) -> None:
        self._path = segment_path(run, role)
        self._open_timeout_s = open_timeout_s
        self._segment: FrameSegment | None = None
        self._socket: socket.socket | None = None
        self._given = 0
        self.skipped = 0

    def __enter__(self) -> Self:
        """Raise CameraError when no world publishes in time, or another process reads already."""
        self._segment = self._attach()
        try:
            self._socket = bind(socket_path(self._path))
        except CameraError:
            self._segment.close()
            self._segment = None
            raise
        # What was written before this reader came is old: start with the next frame.
        self._given = int(self._segment.header[FrameSegment.NEWEST])
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            with suppress(FileNotFoundError):
                socket_path(self._path).unlink()
        if self._segment is not None:
            self._segment.close()
            self._segment = None

    @property
    def layout(self) -> Layout:
        assert self._segment is not None, "asked before entering the context"
        return self._segment.layout

    @property
    def writer_lives(self) -> bool:
        return writer_lives(self._path)

    def next(self, timeout_s: float) -> SharedFrame | None:
        """The newest frame not yet given, waiting for one at most so long; None when none came."""
        deadline_s = time.monotonic() + timeout_s
        while (frame := self._newest()) is None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return None
            self._wait(left_s)
        return frame

    def is_whole(self, frame: SharedFrame) -> bool:
        """Ask when it was copied: False when the writer came back to its slot meanwhile, and a
        newer one is there.

        On CPUs that reorder loads this look at the lock word is no proof by itself; the ring is:
        the writer comes back to a slot only after three other frames.
        """
        segment = self._segment
        assert segment is not None
        return int(segment.slot_headers[frame.number % segment.layout.slots][0]) == 2 * frame.number

    def _attach(self) -> FrameSegment:
        deadline_s = time.monotonic() + self._open_timeout_s
        while (segment := map_segment(self._path)) is None:
            if time.monotonic() > deadline_s:
                raise CameraError(
                    f"no camera frames are published as {self._path} after {self._open_timeout_s:g} s",
                    "start the world first; see its log if it stopped",
                )
            time.sleep(_OPEN_POLL_S)
        return segment

    def _newest(self) -> SharedFrame | None:
        segment = self._segment
        assert segment is not None, "read before entering the context"
        newest = int(segment.header[FrameSegment.NEWEST])
        if newest <= self._given:
            return None
        self.skipped += newest - self._given - 1
        self._given = newest
        slot = newest % segment.layout.slots
        return SharedFrame(
            newest,
            int(segment.slot_headers[slot][1]),
            segment.colors[slot],
            segment.depths[slot],
        )

    def _wait(self, timeout_s: float) -> None:
        """Wait until the writer says that there is something new; what else it said before is of
        the same.
        """
        assert self._socket is not None
        self._socket.settimeout(timeout_s)
        with suppress(TimeoutError):
            self._socket.recv(16)
        self._socket.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                self._socket.recv(16)
