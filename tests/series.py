"""The tests again and again, with busy loops beside them: what fails one time in twenty.

    python -m tests.series --times 20 --beside 1
    python -m tests.series --times 5 --beside 2 -- tests/scenarios tests/contracts

A run is README's second command (or what stands after ``--`` for pytest), in a process of its own.
Each run's time, its failures and the flights that were flown again are told as it ends; the exit code
is 1 when anything failed.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

BUSY = [sys.executable, "-c", "while True: pass"]
PYTEST = [sys.executable, "-m", "pytest"]
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
_AGAIN = re.compile(r"(\d+) flights were flown again")


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the tests. ``again``: flights that the computer was too slow for."""

    took_s: float
    code: int
    failed: tuple[str, ...]
    again: int
    last: str

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.took_s), 60)
        told = "".join(f"\n    {each}" for each in self.failed)
        return f"{minutes}:{seconds:02d}  {self.last.strip('= ')}, {self.again} flown again{told}"


def once(command: Sequence[str]) -> Run:
    """Run the tests once."""
    began_s = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    again = _AGAIN.search(said)
    return Run(
        time.monotonic() - began_s,
        done.returncode,
        tuple(_FAILED.findall(said)),
        int(again[1]) if again else 0,
        (said.strip().splitlines() or ["it said nothing"])[-1],
    )


@contextmanager
def beside(count: int) -> Generator[None]:
    """While so many programs keep a core busy each, as urgent as the tests."""
    loops = [subprocess.Popen(BUSY) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def main(arguments: Sequence[str], tell: Callable[[str], object] = print) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.series", description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--beside", type=int, default=0, help="busy loops")
    parser.add_argument("tests", nargs="*", help="for pytest; all of them")
    asked = parser.parse_args(arguments)
    runs: list[Run] = []
    with beside(asked.beside):
        for number in range(1, asked.times + 1):
            runs.append(once([*PYTEST, *asked.tests]))
            tell(f"[{number}/{asked.times}] {runs[-1]}")
    bad = sum(run.code != 0 for run in runs)
    tell(f"{bad} of {len(runs)} runs failed, with {asked.beside} busy loops beside them")
    for test, times in Counter(test for run in runs for test in run.failed).most_common():
        tell(f"  {times} times: {test}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path.cwd()))
    sys.exit(main(sys.argv[1:]))
