"""How late this process is, and how much of that is the computer's doing: for whoever must send in
time.

The kernel counts for how long each thread was ready to run and had no core
(``/proc/self/task/*/schedstat``), and what a virtual machine's host took from a core
(``/proc/stat``). Neither grows while a thread computes, sleeps, or waits for anything else, so that
a program cannot excuse itself; how long it stood for a disk is found apart (``disk_waits``). Where a
system does not count, nothing was taken.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from drivers.disk_waits import DiskWaits

LOOK_S = 0.04
LEAST_S = 0.01  # what is told: below it a setpoint is not late
LIST_EVERY = 25  # looks: threads hardly come and go in flight
TASKS = Path("/proc/self/task")
STAT = Path("/proc/stat")


class CoreWaits:
    """The time that this process's threads, and all that runs, were ready and had no core. Close
    it.

    Args:
        own: number of the thread whose wait is told apart; by default the calling one.
        tasks, stat: what the kernel tells of this process's threads, and of the cores.
    """

    def __init__(
        self,
        own: int | None = None,
        tasks: Path = TASKS,
        stat: Path = STAT,
    ) -> None:
        self._own = str(threading.get_native_id() if own is None else own)
        self._tasks = tasks
        self._files: dict[str, int] = {}
        self._waited_ns: dict[str, int] = {}
        self._stat = _opened(stat)
        self._tick_ns = round(1e9 / os.sysconf("SC_CLK_TCK"))
        self._stolen_ns: list[int] = []
        self._looks = 0
        self.look()

    def look(self) -> dict[str, int]:
        """Since the last look, ns: ``waited_ns`` of the thread that is told apart, ``beside_ns``
        the most of any other thread, ``stolen_ns`` the most that a host took from one core."""
        if self._looks % LIST_EVERY == 0:
            self._list()
        self._looks += 1
        waits = self._waits_ns()
        own = waits.pop(self._own, 0)
        return {
            "waited_ns": own,
            "beside_ns": max(waits.values(), default=0),
            "stolen_ns": self._taken_ns(),
        }

    def close(self) -> None:
        for file in self._files.values():
            os.close(file)
        self._files.clear()
        if self._stat is not None:
            os.close(self._stat)
            self._stat = None

    def _list(self) -> None:
        """Threads that came are looked at from now on; those that ended are found when they are
        read.
        """
        try:
            names = [each.name for each in self._tasks.iterdir()]
        except OSError:
            return
        for name in names:
            file = None if name in self._files else _opened(self._tasks / name / "schedstat")
            if file is not None:
                self._files[name] = file

    def _waits_ns(self) -> dict[str, int]:
        grown: dict[str, int] = {}
        for name, file in list(self._files.items()):
            try:
                total_ns = int(os.pread(file, 128, 0).split()[1])
            except (OSError, ValueError, IndexError):
                os.close(self._files.pop(name))
                continue
            grown[name] = total_ns - self._waited_ns.get(name, total_ns)
            self._waited_ns[name] = total_ns
        return grown

    def _taken_ns(self) -> int:
        before = self._stolen_ns
        self._stolen_ns = self._stolen_of_cores_ns()
        grown = (now - then for now, then in zip(self._stolen_ns, before, strict=False))
        return max(grown, default=0)

    def _stolen_of_cores_ns(self) -> list[int]:
        if self._stat is None:
            return []
        lines = [line.split() for line in os.pread(self._stat, 8192, 0).splitlines()]
        cores = (
            words for words in lines if words and words[0].startswith(b"cpu") and words[0] != b"cpu"
        )
        return [int(words[8]) * self._tick_ns for words in cores if len(words) > 8]


def _opened(file: Path) -> int | None:
    with contextlib.suppress(OSError):
        return os.open(file, os.O_RDONLY)
    return None


async def watch_lateness(
    tell: Callable[[dict[str, Any]], None],
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
) -> None:
    """Tell how late this loop and its process were, whenever they were, until cancelled.

    A record has ``since_ns``, the time that it is of, ``loop_ns``, by how much the loop woke later
    than it had asked for, whatever the reason, what ``CoreWaits.look`` gives, and ``disk_ns``: it
    stood for a disk for so long.
    """
    loop = asyncio.get_running_loop()
    waits = CoreWaits()
    disk = DiskWaits()
    try:
        looked_s = loop.time()
        while True:
            await sleep(LOOK_S)
            since_s = loop.time() - looked_s
            looked_s = loop.time()
            late = waits.look()
            late_ns = round((since_s - LOOK_S) * 1e9)
            disk_ns = disk.look(late_ns - late["waited_ns"])
            if max(late_ns, sum(late.values())) > LEAST_S * 1e9:
                since_ns = round(since_s * 1e9)
                tell({"since_ns": since_ns, "loop_ns": late_ns, **late, "disk_ns": disk_ns})
    finally:
        waits.close()
        disk.close()
