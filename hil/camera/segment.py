"""The shared memory and the socket under ``hil.camera.shared``: where they are, who lives, and what
they hold.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import socket
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

from drivers.interfaces import CameraError
from path.arrays import Depths, Image, Whole
from path.messages import Role
from path.values import frozen

MAGIC = 0x5041_5448_4652_0003  # "PATHFR", version 3
PREFIX = "path-camera-"
HEADER_BYTES = 4096
SLOT_HEADER_BYTES = 64


def folder() -> Path:
    """Return the folder of segments: in memory where the system has a file system for it."""
    memory = Path("/dev/shm")
    return memory if memory.is_dir() and os.access(memory, os.W_OK) else Path(tempfile.gettempdir())


def segment_path(run: str, role: Role) -> Path:
    return folder() / f"{PREFIX}{run}-{role.value}"


def remove_abandoned() -> list[Path]:
    """Remove segments and sockets whose writer is dead (it was killed before it could); returns
    what was removed.
    """
    removed: list[Path] = []
    for path in folder().glob(f"{PREFIX}*"):
        if path.suffix in (".sock", ".new") or writer_lives(path):
            continue
        for leftover in (path, socket_path(path)):
            with suppress(FileNotFoundError):
                leftover.unlink()
                removed.append(leftover)
    return removed


def socket_path(segment: Path) -> Path:
    return segment.with_name(segment.name + ".sock")


def writer_lives(segment: Path) -> bool:
    try:
        handle = os.open(segment, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    else:
        return False
    finally:
        os.close(handle)


@frozen
class Layout:
    """The places of things in a segment of ``slots`` frames; sizes are (width, height) in px.

    ``fps``: what is aimed at.
    """

    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    fps: int
    slots: int

    @property
    def color_bytes(self) -> int:
        return self.color_size[0] * self.color_size[1] * 3

    @property
    def depth_bytes(self) -> int:
        return self.depth_size[0] * self.depth_size[1] * 2

    @property
    def depth_start(self) -> int:
        return -(-(SLOT_HEADER_BYTES + self.color_bytes) // 64) * 64

    @property
    def slot_bytes(self) -> int:
        return -(-(self.depth_start + self.depth_bytes) // 4096) * 4096

    @property
    def total_bytes(self) -> int:
        return HEADER_BYTES + self.slots * self.slot_bytes

    def words(self) -> tuple[int, ...]:
        """The numbers in the segment's header, after the magic number."""
        return *self.color_size, *self.depth_size, self.fps, self.slots


class FrameSegment:
    """NumPy views into a mapped segment.

    ``header``: magic, colour width and height, depth width and height, fps, slots, newest sequence
    number (0: none). ``slot_headers[i]``: 2 n - 1 while frame n is being written and 2 n once it is
    whole, stamp in ns of CLOCK_MONOTONIC.
    """

    NEWEST = 7

    def __init__(self, memory: mmap.mmap, layout: Layout) -> None:
        self.layout = layout
        self._memory = memory
        self.header = np.frombuffer(memory, np.int64, 8)
        self.slot_headers: list[Whole] = []
        self.colors: list[Image] = []
        self.depths: list[Depths] = []
        for i in range(layout.slots):
            start = HEADER_BYTES + i * layout.slot_bytes
            self.slot_headers.append(np.frombuffer(memory, np.int64, 2, start))
            color = np.frombuffer(memory, np.uint8, layout.color_bytes, start + SLOT_HEADER_BYTES)
            depth = np.frombuffer(
                memory,
                np.uint16,
                layout.depth_bytes // 2,
                start + layout.depth_start,
            )
            self.colors.append(color.reshape(*reversed(layout.color_size), 3))
            self.depths.append(depth.reshape(*reversed(layout.depth_size)))

    def close(self) -> None:
        """Drop the views, then the mapping; while somebody holds a frame's pixels, it stays for as
        long as these do.
        """
        self.header = np.zeros(0, np.int64)
        self.slot_headers = []
        self.colors = []
        self.depths = []
        with suppress(BufferError):
            self._memory.close()


def map_segment(path: Path) -> FrameSegment | None:
    """Map a segment that a living writer publishes; None when there is none."""
    if not writer_lives(path):
        return None
    try:
        handle = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        memory = mmap.mmap(handle, 0, prot=mmap.PROT_READ)
    finally:
        os.close(handle)
    magic, width, height, depth_width, depth_height, fps, slots = np.frombuffer(
        memory,
        np.int64,
        7,
    ).tolist()
    if magic != MAGIC:
        memory.close()
        raise CameraError(
            f"{path} holds no camera frames of this version", "remove it and start again"
        )
    return FrameSegment(memory, Layout((width, height), (depth_width, depth_height), fps, slots))


def bind(path: Path) -> socket.socket:
    """A datagram socket at ``path``; one left behind by a killed reader is replaced, a live one
    refused.
    """
    waker = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    waker.setblocking(False)
    try:
        waker.bind(str(path))
    except OSError as error:
        if error.errno != errno.EADDRINUSE or _answers(path):
            waker.close()
            raise CameraError(
                f"{path.name} already has a reader", "end the other process of this role"
            ) from error
        path.unlink(missing_ok=True)
        waker.bind(str(path))
    return waker


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True
