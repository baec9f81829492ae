"""A world in real time with vehicles on the wire and nothing else: no cameras, links or monitors."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NoReturn, Protocol

from hil.world.world import Fleet

STEP_S = 0.005


class Pumped(Protocol):
    """A vehicle that takes and sends what is due at the world's time."""

    def pump(self, now_s: float, /) -> None: ...


def run_alone(world: Fleet, vehicles: Sequence[Pumped]) -> NoReturn:
    """Step the world at the clock's pace, until Ctrl-C."""
    start_s = time.monotonic()
    steps = 0
    while True:
        now_s = time.monotonic() - start_s
        world.advance(max(now_s, world.time_s))
        for vehicle in vehicles:
            vehicle.pump(world.time_s)
        steps = max(steps + 1, int(now_s / STEP_S))
        time.sleep(max(0.0, start_s + steps * STEP_S - time.monotonic()))
