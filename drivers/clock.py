"""The clock of a real role: the computer's own, which never steps."""

from __future__ import annotations

import time
from dataclasses import dataclass

from drivers.rig import PartContext


@dataclass(frozen=True, slots=True)
class SystemClockConfig:
    """Nothing to set."""


class SystemClock:
    """CLOCK_MONOTONIC: the same for all processes of one computer, and unrelated to the other drone's."""

    Config = SystemClockConfig

    def __init__(self, config: SystemClockConfig, context: PartContext) -> None:
        del config, context

    def now_ns(self) -> int:
        return time.monotonic_ns()


def stopwatch_ns() -> int:
    """For measuring how long something takes: the finest clock there is, from an arbitrary zero."""
    return time.perf_counter_ns()


def busy_ns() -> int:
    """How long this thread has run on a core, from an arbitrary zero: other programs' turns are not in it."""
    return time.thread_time_ns()
