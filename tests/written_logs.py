"""A log that is read while it is written: what was put into it is on the disk a little later."""

from __future__ import annotations

from drivers.log.mcap_log import McapLog


def until_written(log: McapLog) -> None:
    """Wait until everything that was logged is in the file."""
    for _ in range(20):
        if log._file is None or log._file.settle():
            return
    raise AssertionError("the disk takes nothing")
