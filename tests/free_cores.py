"""Whether this computer's cores are free, and waiting until they are: before a flight in real time
is flown again.

A neighbour that is busy for minutes would make each repetition as late as the first. ``python -m
tests.free_cores`` waits as the tests do.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

CORES = 2
"""A flight's processes need these."""
FREE_SHARE = 0.8
"""The cores are free when each of so many busy threads was given this much of one."""
IN_A_ROW = 3
"""Free for a moment is not free: so many looks have to agree."""
WAIT_S = 300.0
LOOK_S, BETWEEN_S = 0.5, 1.0


@dataclass(slots=True)
class Patience:
    """How long all waits of one process may take together, s."""

    left_s: float


PATIENCE = Patience(300.0)
"""A neighbour that stays would else be waited for again before each test that it disturbs."""
_BLOCK = bytes(1 << 18)  # hashed without the interpreter's lock


def least_share(look_s: float = LOOK_S, threads: int = CORES) -> float:
    """Return the least part of a core that any of so many busy threads was given meanwhile."""
    shares: list[float] = []

    def be_busy() -> None:
        begun_s, used_s = time.monotonic(), time.thread_time()
        while time.monotonic() - begun_s < look_s:
            hashlib.sha256(_BLOCK)
        shares.append((time.thread_time() - used_s) / (time.monotonic() - begun_s))

    busy = [threading.Thread(target=be_busy) for _ in range(threads)]
    for thread in busy:
        thread.start()
    for thread in busy:
        thread.join()
    return min(shares)


def wait_until_free(
    limit_s: float = WAIT_S,
    look: Callable[[], float] = least_share,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
    patience: Patience = PATIENCE,
) -> bool:
    """Return True when the cores are free, False when they were not within ``limit_s``, or when
    there is no patience left.
    """
    begun_s = clock()
    limit_s = min(limit_s, patience.left_s)
    free = 0
    try:
        while True:
            free = free + 1 if look() >= FREE_SHARE else 0
            if free == IN_A_ROW:
                return True
            if clock() - begun_s >= limit_s:
                return False
            sleep(BETWEEN_S)
    finally:
        patience.left_s -= clock() - begun_s


if __name__ == "__main__":
    print(
        "the cores are free"
        if wait_until_free()
        else f"the cores were not free within {WAIT_S:g} s"
    )
