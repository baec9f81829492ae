"""Bytes that a thread of its own writes: whoever flies never waits for a disk, a pipe or a terminal.

``write(2)`` returns at once as a rule, and after seconds when a file system commits its journal,
holds back whoever writes too much, or is frozen, and when nobody reads a pipe or a terminal is held
(Ctrl-S). A loop that wrote by itself would send no setpoint meanwhile. Used by logs and by what
programs in flight say on stdout.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

CLOSE_S = 30.0
"""How long what waits is waited for at the end: drones have landed by then."""
SETTLE_S = 3.0


def write_whole(write: Callable[[memoryview], int], data: bytes) -> None:
    """Write all of it: a full disk or pipe takes a part before it takes nothing."""
    left = memoryview(data)
    while left:
        left = left[write(left) :]


class WrittenBehind:
    """Writes in the order of ``put``, with a thread of its own. What does not fit is lost, and
    counted.

    Args:
        write: writes all it is given, however long that takes; it may raise.
        most_bytes: that wait to be written.
        name: of the thread.
    """

    def __init__(
        self,
        write: Callable[[bytes], object],
        most_bytes: int,
        name: str,
    ) -> None:
        self.lost = 0
        """How many of what was put found no room."""
        self.error: Exception | None = None
        """What writing ended in; nothing is written after it."""
        self._write = write
        self._most_bytes = most_bytes
        # Each is written by one thread only: their difference needs no lock.
        self._put_bytes = 0
        self._done_bytes = 0
        self._queue: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        return self._put_bytes - self._done_bytes

    def put(self, data: bytes, *, always: bool = False) -> bool:
        """Have something written soon. Return whether there was room for it.

        Args:
            always: room or not, for the little without which the rest cannot be read.
        """
        if not always and self.waiting_bytes + len(data) > self._most_bytes:
            self.lost += 1
            return False
        self._put_bytes += len(data)
        self._queue.put(data)
        return True

    def settle(self, limit_s: float = SETTLE_S) -> bool:
        """Wait until all that was put so far is written. Return False when that takes longer."""
        end_s = time.monotonic() + limit_s
        while self.waiting_bytes and time.monotonic() < end_s:
            time.sleep(0.001)
        return not self.waiting_bytes

    def close(self, limit_s: float = CLOSE_S) -> bool:
        """Wait until all is written. Return False when that takes longer, or failed."""
        self._queue.put(None)
        # What failed is not waited for: it may be the program in flight that finds out.
        if self.error is None:
            self._thread.join(limit_s)
        return self.error is None and not self._thread.is_alive()

    def _run(self) -> None:
        while (data := self._queue.get()) is not None:
            if self.error is None:
                try:
                    self._write(data)
                except Exception as error:  # whatever it was, the flight goes on
                    self.error = error
            self._done_bytes += len(data)
