"""The filter of new frames: stamps and ids increase, whatever the camera gives."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol, TypeVar

from drivers.interfaces import CameraError

REMEDY = "see whether the camera is stuck or its clock was set back"


class Stamped(Protocol):
    @property
    def stamp_ns(self) -> int: ...

    @property
    def frame_id(self) -> int: ...


T = TypeVar("T", bound=Stamped)


class Freshness:
    """Remembers the newest frame given on. ``dropped`` counts those that were no newer."""

    def __init__(self, max_old_frames: int) -> None:
        self._max_old = max_old_frames
        self._stamp_ns: int | None = None
        self._frame_id = 0
        self.dropped = 0

    async def next(self, read: Callable[[float], Awaitable[T]], timeout_s: float) -> T:
        """The next frame of ``read(timeout_s)`` that is newer than all before it.

        Raises:
            CameraError: as ``read`` does, or when only old frames came: ``max_old_frames`` in a row
                or all the time.
        """
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + timeout_s
        old = 0
        while True:
            frame = await read(max(deadline_s - loop.time(), 0.0))
            if self._stamp_ns is None or (
                frame.stamp_ns > self._stamp_ns and frame.frame_id > self._frame_id
            ):
                self._stamp_ns = frame.stamp_ns
                self._frame_id = frame.frame_id
                return frame
            old += 1
            self.dropped += 1
            behind = f"{(frame.stamp_ns - self._stamp_ns) / 1e9:+.3f} s, {frame.frame_id - self._frame_id:+d} frames"
            if old >= self._max_old:
                raise CameraError(
                    f"{old} frames in a row are no newer than the one before them ({behind})",
                    REMEDY,
                )
            if loop.time() >= deadline_s:
                raise CameraError(
                    f"no new frame for {timeout_s:g} s, only {old} old or repeated ones ({behind})",
                    REMEDY,
                )
