"""A process that only computes, in the background: it takes the cores that nobody else wants.

Used by the workers of the tests (``tests/scheduling.py``) while flights in real time have the machine, and
beside whatever else has limits in seconds. Niceness alone does not do it. Linux gives each session equal
shares of a core (autogroup), and a flight's programs are sessions of their own: the session that computes
has to be the nice one. Inside a session, and where sessions are not grouped, SCHED_IDLE is given way to at
once.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path

NICER = 15
"""Than the run itself. Two such processes together take a fifteenth of a core from one that is busy."""
A_LITTLE_NICER = 5
"""Two such sessions get a third of a core each from a neighbour that keeps all busy."""
MOST = 19
BEGAN = os.getpriority(os.PRIO_PROCESS, 0)
POSSIBLE = sys.platform == "linux"
"""Whether what waits for its turn is never in the way of a flight."""
_SESSION = Path("/proc/self/autogroup")
_TRIES, _EVERY_S = 5, 0.11  # the kernel takes one such wish of an ordinary user in 0.1 s


def go(nice: int = NICER) -> None:
    """Give way to everybody from now on, in a session of its own, which is so nice."""
    _be_nice(min(MOST, BEGAN + NICER))
    if POSSIBLE:
        with contextlib.suppress(PermissionError):  # it leads a session already
            os.setsid()
        _ask_for(nice)
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def come_back() -> None:
    """Be as urgent as the run itself again.

    Nobody but root may: anybody else's process stays in the background of its session.
    """
    if POSSIBLE and os.sched_getscheduler(0) == os.SCHED_IDLE:
        _ask_for(0)
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    _be_nice(BEGAN)


def _be_nice(wanted: int) -> None:
    if os.getpriority(os.PRIO_PROCESS, 0) != wanted:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, wanted)


def _ask_for(nice: int) -> None:
    """Ask for less of a core for the session of this process, or for as much as others have."""
    for _ in range(_TRIES):
        try:
            if not _SESSION.read_text("ascii").endswith(f"nice {nice}\n"):
                _SESSION.write_text(str(nice), "ascii")
        except BlockingIOError:
            time.sleep(_EVERY_S)
        except OSError:  # sessions are not grouped
            return
        else:
            return
