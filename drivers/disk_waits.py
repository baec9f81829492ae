"""How long a thread stood in the kernel for a disk: what makes a loop late without a core being
taken from it, and without its own doing.

Linux does not count this unless it is booted for it (``delayacct``), but it tells what a thread is
doing now: one that reads, writes, opens, or needs a page of its program that is not in memory is in
state D, "disk sleep", until the disk has answered; one that sleeps, or waits for a socket or
another thread, is in state S. Another thread looks, a few times while a setpoint is due. It cannot
look while the first one needs a page, since that keeps the interpreter's lock: then the kernel's
count of such pages, and of how long this computer's programs stood for their disks
(``/proc/pressure/io``), tell as much.
"""

from __future__ import annotations

import os
import resource
import threading
import time
from pathlib import Path

LOOK_S = 0.02
TASKS = Path("/proc/self/task")
PRESSURE = Path("/proc/pressure/io")
_DISK_SLEEP = b"D"
# of resource, where the system counts by thread
_THREAD = getattr(resource, "RUSAGE_THREAD", None)


class DiskWaits:
    """Made, and asked, by the thread whose waits are told. Close it."""

    def __init__(self, tasks: Path = TASKS, pressure: Path = PRESSURE) -> None:
        self._state = _opened(tasks / str(threading.get_native_id()) / "stat")
        self._pressure = _opened(pressure)
        self._stood_ns = 0  # written by the thread that looks
        self._told_ns = 0
        self._pages = _pages_read()
        self._pressed_ns = self._pressed()
        self._used_ns = time.thread_time_ns()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        if self._state is not None:
            self._thread = threading.Thread(target=self._watch, name="disk-waits", daemon=True)
            self._thread.start()

    def look(self, late_ns: int) -> int:
        """Return for how long of ``late_ns`` this thread stood for a disk since the last look, ns.

        Args:
            late_ns: how late it is, less what it waited for a core.
        """
        stood_ns = self._stood_ns - self._told_ns
        self._told_ns += stood_ns
        used_ns = time.thread_time_ns()
        pages = _pages_read()
        pressed_ns = self._pressed()
        if pages > self._pages:
            idle_ns = late_ns - (used_ns - self._used_ns)
            stood_ns = max(stood_ns, min(idle_ns, pressed_ns - self._pressed_ns))
        self._used_ns = used_ns
        self._pages = pages
        self._pressed_ns = pressed_ns
        return max(0, min(stood_ns, late_ns))

    def close(self) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
        for file in (self._state, self._pressure):
            if file is not None:
                os.close(file)
        self._state = self._pressure = None

    def _watch(self) -> None:
        assert self._state is not None
        looked_ns = time.monotonic_ns()
        while not self._ending.wait(LOOK_S):
            state = os.pread(self._state, 512, 0).rpartition(b")")[2][1:2]
            now_ns = time.monotonic_ns()
            if state == _DISK_SLEEP:
                # What this thread itself missed says nothing of the other one.
                self._stood_ns += min(now_ns - looked_ns, round(2e9 * LOOK_S))
            looked_ns = now_ns

    def _pressed(self) -> int:
        """For how long some program of this computer stood for its disk, ns."""
        if self._pressure is None:
            return 0
        some = os.pread(self._pressure, 512, 0).partition(b"\n")[0]
        return int(some.rpartition(b"total=")[2] or 0) * 1000


def _pages_read() -> int:
    """How many pages of this thread's program had to be read from a disk."""
    return 0 if _THREAD is None else resource.getrusage(_THREAD).ru_majflt


def _opened(file: Path) -> int | None:
    try:
        return os.open(file, os.O_RDONLY)
    except OSError:
        return None
