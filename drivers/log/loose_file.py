"""A log in flight: message by message, each written by a thread that does nothing else."""

from __future__ import annotations

import errno
from functools import partial
from io import FileIO
from pathlib import Path

from mcap.records import DataEnd, Footer

from drivers.log.index import MAGIC, built, index_log
from drivers.written_behind import CLOSE_S, WrittenBehind, write_whole

MOST_WAITING_BYTES = 1 << 25
"""For the disk: minutes of a flight."""


class LooseFile:
    """Each message is on its way to the disk soon after ``message`` has returned.

    Raises OSError, also for what was to be written before.
    """

    def __init__(self, path: Path, most_waiting_bytes: int = MOST_WAITING_BYTES) -> None:
        self._path = path
        self._raw = FileIO(path, "wb")
        self._behind = WrittenBehind(
            partial(write_whole, self._raw.write),
            most_waiting_bytes,
            "log",
        )
        self._behind.put(MAGIC)

    @property
    def lost(self) -> int:
        """How many messages found no room, as the disk took none."""
        return self._behind.lost

    def say(self, opcode: int, record: bytes) -> None:
        del opcode
        self._put(record, always=True)

    def message(
        self,
        channel: int,
        utc_ns: int,
        record: bytes,
    ) -> None:
        del channel, utc_ns
        self._put(record, always=False)

    def settle(self) -> bool:
        """Wait, for a bounded time, until the disk has all of it. Return whether it has."""
        settled = self._behind.settle()
        if self._behind.error is not None:
            raise self._behind.error
        return settled

    def close(self) -> None:
        """Put what was written into chunks. It waits for the disk, for a bounded time."""
        self._behind.put(built(DataEnd(0)) + built(Footer(0, 0, 0)) + MAGIC, always=True)
        done = self._behind.close()
        if done or self._behind.error is not None:
            self._raw.close()
        if self._behind.error is not None:
            raise self._behind.error
        if not done:
            raise OSError(errno.ETIMEDOUT, f"the disk took nothing for {CLOSE_S:.0f} s")
        index_log(self._path)

    def _put(self, record: bytes, always: bool) -> None:
        if self._behind.error is not None:
            raise self._behind.error
        self._behind.put(record, always=always)
