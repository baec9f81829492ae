"""``python -m tests.pilots --seed 1 --flights 10000``: many short flights under a person's hands,
in all processes; with ``--handovers`` whole hand-overs under persons' hands.

Of what fails the shortest sequence that still does is printed, as a line for
``tests/pilots/test_flights.py`` or ``test_handovers.py``. What one flight is, and is not:
``tests/pilots/flight.py`` and ``handovers.py``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from random import Random
from typing import Any

from tests.pilots.acts import Act, drawn, simpler
from tests.pilots.flight import Flown, fly
from tests.pilots.handovers import Acts, drawn_acts, simpler_acts
from tests.pilots.handovers import fly as fly_whole

PIECE = 50  # flights in one piece of work
SHOWN = 20


def short(number: str) -> tuple[Act, ...]:
    """Return what the person does in a short flight, by the run's seed and the flight's number."""
    return drawn(Random(number))


def whole(number: str) -> Acts:
    """Return what persons do in a whole hand-over."""
    return drawn_acts(Random(number))


# what is drawn, how it is flown, and what is tried in its place where it fails
KINDS: dict[bool, tuple[Callable[[str], Any], Callable[[Any], Flown], Callable[[Any], Any]]] = {
    False: (short, fly, simpler),
    True: (whole, fly_whole, simpler_acts),
}


def smallest(acts: Any, handovers: bool) -> tuple[Any, Flown]:
    """Return the simplest sequence that still fails, and how."""
    _, flies, simplify = KINDS[handovers]
    flown = flies(acts)
    found = True
    while found:
        found = False
        for other in simplify(acts):
            tried = flies(other)
            if tried.wrong:
                acts, flown, found = other, tried, True
                break
    return acts, flown


def piece(seed: int, begin: int, end: int, handovers: bool) -> tuple[Counter[str], list[int]]:
    """Fly the flights of these numbers; count their ends, and return the numbers of those that
    fail.
    """
    draw, flies, _ = KINDS[handovers]
    ends: Counter[str] = Counter()
    failed: list[int] = []
    for number in range(begin, end):
        flown = flies(draw(f"{seed} {number}"))
        ends[flown.outcome] += 1
        ends["(crossed)"] += flown.crossed > 0
        if flown.wrong:
            failed.append(number)
    return ends, failed


def main(arguments: list[str] | None = None) -> int:
    """Fly, tell, and return 1 when something was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.pilots", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--handovers", action="store_true", help="whole hand-overs of two drones: 3 s each"
    )
    options = parser.parse_args(arguments)
    begun_s, ends, failed = time.monotonic(), Counter[str](), list[int]()
    last = options.first + options.flights
    begins = range(options.first, last, PIECE)
    with ProcessPoolExecutor(options.processes) as pool:
        pieces = [
            pool.submit(piece, options.seed, at, min(at + PIECE, last), options.handovers)
            for at in begins
        ]
        for done in pieces:
            more, wrong = done.result()
            ends += more
            failed += wrong
    took_s = time.monotonic() - begun_s
    print(
        f"{options.flights} flights, seed {options.seed}, {took_s:.0f} s: {len(failed)} wrong; ended as {dict(ends)}"
    )
    for number in failed[:SHOWN]:
        acts = KINDS[options.handovers][0](f"{options.seed} {number}")
        acts, flown = smallest(acts, options.handovers)
        print(f"flight {number}, {flown.outcome} ({flown.detail}):")
        print(f"    {acts!r}")
        for what in flown.wrong:
            print(f"    {what}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
