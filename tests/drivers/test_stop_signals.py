"""The signals that end a flight, and those that do not when the program was begun to outlive its
terminal.
"""

from __future__ import annotations

import subprocess
import sys

TELL = "from drivers.stop_signals import stop_signals; print(*(number.name for number in stop_signals()))"


def told(*before: str) -> list[str]:
    return subprocess.run(
        [*before, sys.executable, "-c", TELL], capture_output=True, text=True, check=True
    ).stdout.split()


def test_a_terminal_that_goes_away_ends_a_flight() -> None:
    assert told() == ["SIGINT", "SIGTERM", "SIGHUP"]


def test_what_was_begun_with_nohup_flies_on() -> None:
    assert told("nohup") == ["SIGINT", "SIGTERM"]
