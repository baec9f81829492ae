"""Camera frames from the world process to a role process: a ring of slots in shared memory and a socket that wakes.

The writer never waits for a reader. Each slot says which frame it holds and whether that is whole, so that a
reader that was overtaken notices and takes a newer frame; it never sees a torn one. The segment is a plain mapped
file, not ``multiprocessing.shared_memory``, whose tracker process unlinks a segment when any one side ends. The writer
holds a lock on the file for as long as it lives: that is how a reader knows at once that the world is gone, and how
what a killed writer left behind is told from what is in use.
"""

from __future__ import annotations

import asyncio
import fcntl
import mmap
import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import CameraError, Clock, Frame
from drivers.rig import PartContext
from hil.shared_segment import (
    MAGIC,
    Layout,
    Segment,
    bind,
    folder,
    map_segment,
    remove_abandoned,
    segment_path,
    socket_path,
    writer_lives,
)
from path.camera import CameraModel
from path.messages import Role

__all__ = ["RUN_VARIABLE", "SharedCamera", "SharedCameraConfig", "SharedCameraWriter", "folder"]

_OPEN_POLL_S = 0.02
RUN_VARIABLE = "PATH_HANDOFF_RUN"
"""Environment variable with the name of the run, set by whoever starts the world and the roles."""


class SharedCameraWriter:
    """The world's end: publishes frames of one role's camera. One writer a name; a context manager."""

    def __init__(self, run: str, role: Role, model: CameraModel, *, depth: bool = True, slots: int = 4) -> None:
        if slots < 4:
            raise ValueError(f"slots: {slots} is below 4, so that a slow reader would be overtaken at once")
        self._path = segment_path(run, role)
        self._layout = Layout(model.width, model.height, depth, slots)
        self._sequence = 0
        self._segment: Segment | None = None
        self._handle = -1
        self._socket: socket.socket | None = None

    def __enter__(self) -> Self:
        remove_abandoned()
        if writer_lives(self._path):
            raise CameraError(f"{self._path} is already being written", "use another run name, or end the other run")
        # Made and locked under another name: nobody can take the finished one for abandoned.
        new = self._path.with_name(f"{self._path.name}.{os.getpid()}.new")
        self._handle = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        fcntl.flock(self._handle, fcntl.LOCK_EX)
        os.ftruncate(self._handle, self._layout.total_bytes)
        memory = mmap.mmap(self._handle, self._layout.total_bytes)
        self._segment = Segment(memory, self._layout)
        layout = self._layout
        self._segment.header[:6] = (MAGIC, layout.width, layout.height, int(layout.depth), layout.slots, 0)
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

    def write(self, stamp_ns: int, color: NDArray[np.uint8], depth_mm: NDArray[np.uint16] | None) -> None:
        """Publish one frame and wake the reader.

        Args:
            stamp_ns: mid-exposure, CLOCK_MONOTONIC (``time.monotonic_ns``), which all processes share.
            color: (h, w, 3) uint8 BGR.
            depth_mm: (h, w) uint16, present exactly when the writer was made with depth.
        """
        segment = self._segment
        assert segment is not None, "write before entering the context"
        self._sequence += 1
        slot = self._sequence % self._layout.slots
        header, depth = segment.slot_headers[slot], segment.depths[slot]
        header[:] = (2 * self._sequence - 1, stamp_ns)
        np.copyto(segment.colors[slot], color, casting="no")
        if depth is not None and depth_mm is not None:
            np.copyto(depth, depth_mm, casting="no")
        header[0] = 2 * self._sequence
        segment.header[Segment.NEWEST] = self._sequence
        assert self._socket is not None
        # No reader yet, or one whose queue is full and that will wake anyway: either is no concern of the world's.
        with suppress(OSError):
            self._socket.sendto(b"\0", str(socket_path(self._path)))


@dataclass(frozen=True, slots=True)
class SharedCameraConfig:
    """
    Attributes:
        rate_hz: frames a second that the world's process is asked for.
        run: names the run whose world writes the frames; by default the one in $PATH_HANDOFF_RUN.
        open_timeout_s: how long to wait for the world.
    """

    rate_hz: float = 30.0
    run: str = ""
    open_timeout_s: float = 10.0


class SharedCamera:
    """The role's end; implements ``drivers.interfaces.Camera``. Needs an event loop in real time.

    ``skipped`` counts frames that were published but replaced by a newer one before they were read.
    """

    Config = SharedCameraConfig

    def __init__(self, config: SharedCameraConfig, context: PartContext) -> None:
        run = config.run or os.environ.get(RUN_VARIABLE, "")
        if not run:
            raise CameraError(
                "no run is named whose camera frames to read",
                f"start through `path-handoff handoff`, or set `run` in the rig or ${RUN_VARIABLE}",
            )
        self._path = segment_path(run, context.role)
        self._model = context.camera
        self._clock: Clock = context.clock
        self._open_timeout_s = config.open_timeout_s
        self._segment: Segment | None = None
        self._socket: socket.socket | None = None
        self._wake = asyncio.Event()
        self._given = 0
        self.skipped = 0

    @property
    def model(self) -> CameraModel:
        return self._model

    async def __aenter__(self) -> Self:
        self._segment = await self._attach()
        try:
            self._check_size(self._segment.layout)
            self._socket = bind(socket_path(self._path))
        except CameraError:
            self._segment.close()
            self._segment = None
            raise
        asyncio.get_running_loop().add_reader(self._socket, self._on_wake)
        # What was written before this reader came is old: start with the next frame.
        self._given = int(self._segment.header[Segment.NEWEST])
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None
            with suppress(FileNotFoundError):
                socket_path(self._path).unlink()
        if self._segment is not None:
            self._segment.close()
            self._segment = None

    async def read(self, timeout_s: float) -> Frame:
        """The newest frame not yet given.

        Raises:
            CameraError: none came within ``timeout_s``, or the world process is gone.
        """
        if (frame := self._newest()) is not None:
            return frame
        try:
            async with asyncio.timeout(timeout_s):
                while (frame := self._newest()) is None:
                    self._wake.clear()
                    await self._wake.wait()
        except TimeoutError:
            raise self._silent(timeout_s) from None
        return frame

    # --- inside ---

    async def _attach(self) -> Segment:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + self._open_timeout_s
        while (segment := map_segment(self._path)) is None:
            if loop.time() > deadline:
                raise CameraError(
                    f"no camera frames are published as {self._path} after {self._open_timeout_s:g} s",
                    "start the world first; see its log if it stopped",
                )
            await asyncio.sleep(_OPEN_POLL_S)
        return segment

    def _check_size(self, layout: Layout) -> None:
        if (layout.width, layout.height) != (self._model.width, self._model.height):
            raise CameraError(
                f"the calibration is for {self._model.width}x{self._model.height} px but {self._path.name} gives "
                f"{layout.width}x{layout.height} px",
                "use the calibration of this stream, or set the stream to the calibrated size",
            )

    def _on_wake(self) -> None:
        assert self._socket is not None
        with suppress(BlockingIOError):
            while True:
                self._socket.recv(16)
        self._wake.set()

    def _newest(self) -> Frame | None:
        """Copy the newest frame out of the ring; None when it was given already.

        On CPUs that reorder loads the second look at the lock word is no proof by itself; the ring is: the writer
        comes back to this slot only after three other frames.
        """
        segment = self._segment
        assert segment is not None, "read before entering the context"
        while (newest := int(segment.header[Segment.NEWEST])) > self._given:
            slot = newest % segment.layout.slots
            header, depth = segment.slot_headers[slot], segment.depths[slot]
            stamp_ns = int(header[1])
            color = segment.colors[slot].copy()
            depth_mm = depth.copy() if depth is not None else None
            if int(header[0]) == 2 * newest:  # else overtaken by a whole ring while copying: a newer one is complete
                self.skipped += newest - self._given - 1
                self._given = newest
                return Frame(_to_clock(self._clock, stamp_ns), newest, color, depth_mm)
        return None

    def _silent(self, timeout_s: float) -> CameraError:
        message = f"no frame from {self._path.name} for {timeout_s:g} s"
        if not writer_lives(self._path):
            return CameraError(f"{message}: the world process that writes it is gone", "see why it ended in its log")
        return CameraError(message, "see whether the world keeps real time, or the camera is frozen on purpose")


def _to_clock(clock: Clock, monotonic_ns: int, now_ns: Callable[[], int] = time.monotonic_ns) -> int:
    """A CLOCK_MONOTONIC stamp in the role's clock, by how long ago it was.

    Both clocks are read together; a reading during which the process was put aside is repeated.
    """
    best_gap, best = 1 << 62, 0
    for _ in range(3):
        before = now_ns()
        role_ns = clock.now_ns()
        after = now_ns()
        if after - before < best_gap:
            best_gap, best = after - before, role_ns - (before + after) // 2
        if best_gap < 50_000:
            break
    return monotonic_ns + best
