"""The clock of a real role: the computer's own, which never steps."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.rig.parts import NoOptions, PartContext


class SystemClock:
    """CLOCK_MONOTONIC: the same for all processes of one computer, and unrelated to the other
    drone's.
    """

    Config = NoOptions

    def __init__(self, config: NoOptions, context: PartContext) -> None:
        del config, context

    def now_ns(self) -> int:
        return time.monotonic_ns()


def wall_offset_ns(now_ns: Callable[[], int]) -> int:
    """The computer's wall clock (since 1970) minus another clock.

    Both are read together; a reading during which the process was put aside is repeated.
    """
    best_gap = 1 << 62
    best = 0
    for _ in range(3):
        before = now_ns()
        wall_ns = time.time_ns()
        after = now_ns()
        if after - before < best_gap:
            best_gap = after - before
            best = wall_ns - (before + after) // 2
        if best_gap < 20_000:
            break
    return best


def stopwatch_ns() -> int:
    """Return the time of the finest clock there is, from an arbitrary zero, for measuring how long
    something takes.
    """
    return time.perf_counter_ns()


def busy_ns() -> int:
    """Return how long this thread has run on a core, from an arbitrary zero: other programs' turns
    are not in it.
    """
    return time.thread_time_ns()
