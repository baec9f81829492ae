"""Clocks and a log that stand in for a drone's own, in any room's tests."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Any


class WallClock:
    """The computer's own monotonic clock."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


@dataclass(frozen=True)
class LoopClock:
    """The running event loop's time; ``offset_s`` is added."""

    offset_s: float = 0.0

    def now_ns(self) -> int:
        return round((asyncio.get_running_loop().time() + self.offset_s) * 1e9)


class NoLog:
    """A log that nobody reads."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...
