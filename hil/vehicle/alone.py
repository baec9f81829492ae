"""A world in real time with vehicles on the wire and nothing else: no cameras, links or monitors."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NoReturn

from hil.world.world import Fleet

STEP_S = 0.005


def run_alone(world: Fleet, pumps: Sequence[Callable[[float], None]]) -> NoReturn:
    """Step the world at the clock's pace, until Ctrl-C.

    Args:
        pumps: what takes and sends for a vehicle whatever is due at the world's time.
    """
    start_s = time.monotonic()
    steps = 0
    while True:
        now_s = time.monotonic() - start_s
        world.advance(max(now_s, world.time_s))
        for pump in pumps:
            pump(world.time_s)
        steps = max(steps + 1, int(now_s / STEP_S))
        time.sleep(max(0.0, start_s + steps * STEP_S - time.monotonic()))
