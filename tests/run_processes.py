"""The processes of a run, as a test that started it sees them from outside."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path


def processes_of(name: str) -> list[str]:
    """Command lines of processes that name a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if name in command:
            found.append(command)
    return found


def left_of(name: str, within_s: float = 30.0) -> list[str]:
    """Those that are still there after a while, in which one that was ended may be on its way
    out.
    """
    end_s = time.monotonic() + within_s
    while (found := processes_of(name)) and time.monotonic() < end_s:
        time.sleep(0.05)
    return found


def says(process: subprocess.Popen[str], wanted: str, seen: list[str], within_s: float) -> bool:
    """Read what it says, into ``seen``, up to a line with ``wanted`` in it. Return False when it
    ended before that.
    """
    assert process.stdout is not None
    end_s = time.monotonic() + within_s
    for line in process.stdout:
        seen.append(line)
        if wanted in line:
            return True
        assert time.monotonic() < end_s, "".join(seen)
    return False
