"""Processes that a worker of the tests leaves behind when it dies: nobody else would end them, and
one that is busy takes a core from all that comes.

A program that a test starts inherits the worker's environment, and is known by it.
"""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path


def end_left_behind(worker: str, run: str, processes: Path = Path("/proc")) -> list[int]:
    """End all processes of one worker of one run of tests, and return their numbers.

    Args:
        worker, run: as in $PYTEST_XDIST_WORKER and $PYTEST_XDIST_TESTRUNUID.
        processes: Linux's folder of processes; where it is not there, nobody is ended.
    """
    wanted = {f"PYTEST_XDIST_WORKER={worker}".encode(), f"PYTEST_XDIST_TESTRUNUID={run}".encode()}
    ended: list[int] = []
    for environment in processes.glob("[0-9]*/environ"):
        # it may have ended meanwhile, or be somebody else's
        with suppress(OSError):
            if wanted <= set(environment.read_bytes().split(b"\0")):
                process = int(environment.parent.name)
                os.kill(process, signal.SIGKILL)
                ended.append(process)
    return ended
