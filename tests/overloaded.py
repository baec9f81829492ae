"""Flights in real time that a computer was too slow for say nothing: they are flown again, counted,
and told.

Before it is flown again, the computer's cores are waited for: whoever took them may be busy for
minutes. Only an end as ``overloaded`` is repeated, and it is one only where lateness explains what
was seen (``missions/ground/lateness.py``). A violation, or any other end, is what the flight came
to the first time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import pytest

from flight.outcome import Outcome
from tests.free_cores import WAIT_S, wait_until_free

TRIES = 3
"""A flight is flown so often at the most."""
REPEATED = "flown again"
"""The property of a test's report that says why: one for each repetition."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Flown(Generic[_T]):
    """One flight's end, and what a test looks at."""

    outcome: str
    detail: str
    seen: _T


@dataclass(frozen=True, slots=True)
class Repeating:
    """Flies a flight of one test, and again while the computer is too slow. Each has a folder of
    its own.

    Attributes:
        folder: of the test.
        tell: takes why one is flown again.
        wait: returns whether the cores are free, at last; it is flown again in any case.
    """

    folder: Path
    tell: Callable[[str], object]
    wait: Callable[[], bool] = wait_until_free

    def __call__(self, fly: Callable[[Path], Flown[_T]]) -> _T:
        """Returns what was seen of the flight that counts. Fails the test when the computer was too
        slow each time.
        """
        flown: list[Flown[_T]] = []
        while len(flown) < TRIES:
            out = self.folder / f"flight-{len(flown) + 1}"
            out.mkdir(parents=True)
            flown.append(fly(out))
            if flown[-1].outcome != Outcome.OVERLOADED.label:
                return flown[-1].seen
            busy = len(flown) < TRIES and not self.wait()
            self.tell(
                flown[-1].detail
                + (f"; no cores were free for {WAIT_S:g} s after it" if busy else "")
            )
        told = "\n".join(each.detail for each in flown)
        pytest.fail(
            f"this computer was too slow {TRIES} times out of {TRIES}:\n{told}", pytrace=False
        )


def repetitions(reports: Iterable[Any]) -> list[str]:
    """What is told at the end of a run of tests: each flight that was flown again, and why."""
    return [
        f"{report.nodeid}: {value}"
        for report in reports
        if getattr(report, "when", "") == "call"
        for name, value in report.user_properties
        if name == REPEATED
    ]
