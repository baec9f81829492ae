"""How evenly a test was run: what is measured in real time is the computer's own where it stood
still.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TypeVar

from tests.free_cores import wait_until_free

WAIT_S = 90.0  # for a neighbour to be done, before each repetition
_EVERY_S = 0.005
_T = TypeVar("_T")


@contextmanager
def pauses() -> Generator[list[float]]:
    """Yields the pauses of this process, s: one for each step of a thread that has nothing to
    do.
    """
    ending, found = threading.Event(), list[float]()

    def run() -> None:
        last_s = time.monotonic()
        while not ending.wait(_EVERY_S):
            now_s = time.monotonic()
            found.append(now_s - last_s)
            last_s = now_s

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield found
    finally:
        ending.set()
        thread.join()


def undisturbed(
    measure: Callable[[], _T],
    longest_s: float,
    tries: int = 4,
    wait: Callable[[], object] = lambda: wait_until_free(WAIT_S),
) -> _T:
    """Returns what is measured without a longer pause, or raises what is raised then.

    It is measured again when the cores are free, or after a while. Where there is a pause each time
    the last counts.
    """
    for _ in range(tries - 1):
        with pauses() as found:
            try:
                measured = measure()
            except Exception:
                if max(found, default=0.0) < longest_s:
                    raise
            else:
                if max(found, default=0.0) < longest_s:
                    return measured
        wait()
    return measure()
