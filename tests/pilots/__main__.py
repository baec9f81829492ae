"""``python -m tests.pilots --seed 1 --flights 10000``: many short flights under a person's hands,
in all processes.

Of what fails the shortest sequence that still does is printed, as a line for
``tests/pilots/test_flights.py``. What one flight is, and is not: ``tests/pilots/flight.py``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from random import Random

from tests.pilots.acts import Act, drawn, simpler
from tests.pilots.flight import Flown, fly

PIECE = 50  # flights in one piece of work
SHOWN = 20


def acts_of(seed: int, number: int) -> tuple[Act, ...]:
    """Return what the person does in a flight: a function of the run's seed and the flight's number
    alone.
    """
    return drawn(Random(f"{seed} {number}"))


def smallest(acts: tuple[Act, ...]) -> tuple[tuple[Act, ...], Flown]:
    """Return the simplest sequence that still fails, and how."""
    flown = fly(acts)
    found = True
    while found:
        found = False
        for other in simpler(acts):
            tried = fly(other)
            if tried.wrong:
                acts, flown, found = other, tried, True
                break
    return acts, flown


def piece(seed: int, begin: int, end: int) -> tuple[Counter[str], list[int]]:
    """Fly the flights of these numbers; count their ends, and return the numbers of those that
    fail.
    """
    ends: Counter[str] = Counter()
    failed: list[int] = []
    for number in range(begin, end):
        flown = fly(acts_of(seed, number))
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
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    begun_s, ends, failed = time.monotonic(), Counter[str](), list[int]()
    begins = range(0, options.flights, PIECE)
    with ProcessPoolExecutor(options.processes) as pool:
        pieces = [
            pool.submit(piece, options.seed, at, min(at + PIECE, options.flights)) for at in begins
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
        acts, flown = smallest(acts_of(options.seed, number))
        print(f"flight {number}, {flown.outcome} ({flown.detail}):")
        print(f"    {acts!r}")
        for what in flown.wrong:
            print(f"    {what}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
