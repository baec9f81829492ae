"""A log that is read while it is written: what was put into it is on the disk a little later."""

from __future__ import annotations

import time

from drivers.log.loose_file import LooseFile
from drivers.log.mcap_log import McapLog

LIMIT_S = 60.0


def until_written(log: McapLog) -> None:
    """Wait until everything that was logged is in the file."""
    file = log._file
    assert isinstance(file, LooseFile)
    end_s = time.monotonic() + LIMIT_S
    while file._behind.waiting_bytes:
        assert time.monotonic() < end_s
        time.sleep(0.001)
