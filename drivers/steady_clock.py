"""A drone's clock that goes on evenly when somebody sets it: a time daemon, a person, a virtual
machine that moved.

Every age, lease and wait of a drone is told by its one clock. A step of that clock would make
telemetry look old that is not, so that even the way down would be refused; it would move the end of
a lease, and answers that came after a command would seem to have come before it. So the step is
taken off again, and what it was is kept for whoever ends the flight by it (``flight.pilot``): parts
that read another clock are not aligned with this one any more.
"""

from __future__ import annotations

import asyncio
import threading
import time

from drivers.interfaces import Clock

STEP_NS = 20_000_000
"""A clock that goes ahead or falls back by more between two readings was set; drifting is slower by
far.
"""
_LOOKS = 3


class SteadyClock:
    """A clock that is compared with the running loop's own time at every reading. It may be read in
    any thread.

    Attributes:
        set_by_ns: what the clock was set by since it was first read, all steps together.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ahead_ns: int | None = None
        self._lock = threading.Lock()
        self.set_by_ns = 0

    @classmethod
    def of(cls, clock: Clock) -> SteadyClock:
        """Return the clock itself where it is steady already."""
        return clock if isinstance(clock, SteadyClock) else cls(clock)

    def now_ns(self) -> int:
        """Return the clock's time, without what it was set by."""
        read_ns = self._clock.now_ns()
        ahead_ns = read_ns - _loop_ns()
        if self._is_step(ahead_ns):
            return self._look_again()
        self._ahead_ns = ahead_ns
        return read_ns - self.set_by_ns

    def _is_step(self, ahead_ns: int) -> bool:
        return self._ahead_ns is not None and abs(ahead_ns - self._ahead_ns) > STEP_NS

    def _look_again(self) -> int:
        """Believe in a step only when several looks show it: a program may have been put aside
        between two readings.
        """
        with self._lock:
            looks = 0
            while True:
                read_ns = self._clock.now_ns()
                ahead_ns = read_ns - _loop_ns()
                looks += 1
                if looks == _LOOKS or not self._is_step(ahead_ns):
                    break
            if self._ahead_ns is not None and self._is_step(ahead_ns):
                self.set_by_ns += ahead_ns - self._ahead_ns
            self._ahead_ns = ahead_ns
            return read_ns - self.set_by_ns


def _loop_ns() -> int:
    """Return the running loop's time; elsewhere, as in the threads of drivers, that of real
    loops.
    """
    try:
        now_s = asyncio.get_running_loop().time()
    except RuntimeError:
        now_s = time.monotonic()
    return round(now_s * 1e9)
