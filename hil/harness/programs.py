"""The drones' programs in one process, in virtual time: begun, killed and started again.

A program that is killed ends without a word. It may be in the middle of writing its record down:
that is on the disk, and nothing of what it does on its way out reaches anything.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextvars import copy_context
from dataclasses import dataclass

from flight.harness.flights import RoleResult
from hil.harness.drone import Disk, DroneHarness
from hil.harness.stalls import PROGRAM, StallingLoop
from hil.monitors.watched_log import WatchedLog
from path.values import frozen


@frozen
class Started:
    """A program that has begun."""

    log: WatchedLog
    result: Awaitable[RoleResult]


@dataclass(slots=True)
class _Slot:
    """One drone's place for a program."""

    name: str
    harness: DroneHarness
    disk: Disk
    start: Callable[[], Started] | None = None
    log: WatchedLog | None = None
    task: asyncio.Future[RoleResult] | None = None
    restart: asyncio.Task[None] | None = None
    killed: bool = False
    again: bool = False


class Programs:
    """One program a drone at most, by the drone's name.

    Args:
        died: told of a drone whose program was killed.
        forgot: told of one whose program finds an older record than it had written, or none.

    Attributes:
        stop: tells all programs to land.
        interrupted: whether they were told; then nothing is started again.
    """

    def __init__(
        self, died: Callable[[str], None], forgot: Callable[[str], None] = lambda _: None
    ) -> None:
        self._died = died
        self._forgot = forgot
        self._slots: dict[str, _Slot] = {}
        self.stop = asyncio.Event()
        self.interrupted = False

    def add(self, name: str, harness: DroneHarness, disk: Disk) -> None:
        """A drone, which may have a program from now on."""
        self._slots[name] = _Slot(name, harness, disk)

    def begin(self, name: str, start: Callable[[], Started]) -> Awaitable[RoleResult | None]:
        """Start a drone's program now; its result in the end, None when it died. Raises what ended
        it otherwise.
        """
        slot = self._slots[name]
        slot.start = start
        slot.again = False
        self._start(slot)
        return _until_ended(slot)

    def kill(self, name: str, restart_s: float | None) -> None:
        """End a program without a word, and start it again after ``restart_s`` if that is not
        None.
        """
        slot = self._slots[name]
        if slot.task is None or slot.log is None or slot.task.done() or slot.killed:
            return
        harness = slot.harness
        slot.killed = harness.silent = True
        harness.hub.cut(harness.role)
        if harness.beats is not None:
            harness.beats.cut()
        slot.disk.writable = False
        slot.log.ended = True
        self._died(name)
        slot.task.cancel()
        loop = asyncio.get_running_loop()
        if isinstance(loop, StallingLoop):
            loop.wake(name)
        if restart_s is not None and not self.interrupted:
            slot.restart = asyncio.ensure_future(self._start_again(slot, slot.task, restart_s))

    def stall(self, name: str, for_s: float) -> None:
        """Has a program stand still. What its record is to be followed by waits too, if it is just
        written.
        """
        slot = self._slots[name]
        loop = asyncio.get_running_loop()
        if (
            slot.task is not None
            and not slot.task.done()
            and not slot.killed
            and isinstance(loop, StallingLoop)
        ):
            slot.disk.stands_until_s = loop.stand_still(name, for_s)

    def disk(self, name: str) -> Disk:
        return self._slots[name].disk

    def killed(self, name: str) -> bool:
        """Return whether its program is dead, and not started again yet."""
        return self._slots[name].killed

    def began_again(self, name: str) -> bool:
        """Return whether its program is not the first one."""
        return self._slots[name].again

    def interrupt(self) -> None:
        """Everybody lands."""
        self.interrupted = True
        self.stop.set()

    def close(self) -> None:
        """End the restarts: nothing is started again any more."""
        for slot in self._slots.values():
            if slot.restart is not None:
                slot.restart.cancel()

    def _start(self, slot: _Slot) -> None:
        assert slot.start is not None
        slot.killed = False
        slot.restart = None
        slot.disk.writable = True
        slot.harness.silent = slot.harness.lost
        started = slot.start()
        context = copy_context()
        context.run(PROGRAM.set, slot.name)
        slot.log, slot.task = started.log, context.run(asyncio.ensure_future, started.result)

    async def _start_again(
        self, slot: _Slot, dead: asyncio.Future[RoleResult], after_s: float
    ) -> None:
        """Start a program again with the old one's disk; its vehicle and the world have gone on."""
        await asyncio.sleep(after_s)
        await asyncio.wait([dead])
        slot.harness.hub.mend(slot.harness.role)
        slot.again = True
        if slot.disk.lose():
            self._forgot(slot.name)
        self._start(slot)


async def _until_ended(slot: _Slot) -> RoleResult | None:
    while True:
        assert slot.task is not None
        await asyncio.wait([slot.task])
        if not slot.killed:
            return slot.task.result()
        if slot.restart is None:
            return None
        await asyncio.wait([slot.restart])
        if slot.killed:
            return None
