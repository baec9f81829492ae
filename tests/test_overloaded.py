"""A flight that the computer was too slow for is flown again, a stated number of times; a violation
never is.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.free_cores import WAIT_S
from tests.overloaded import TRIES, Flown, Repeating, repetitions
from tests.run_processes import says

LATE = "sender's program had no core for 0.19 s of the 0.24 s without a setpoint at 12.00 s"


class Ends:
    """Flights that end as they are to, one after another."""

    def __init__(self, *outcomes: str) -> None:
        self.flown: list[Path] = []
        self._outcomes = list(outcomes)

    def __call__(self, out: Path) -> Flown[str]:
        self.flown.append(out)
        outcome = self._outcomes.pop(0)
        return Flown(outcome, LATE, f"{outcome} {len(self.flown)}")


def repeating(tmp_path: Path, free: bool = True) -> tuple[Repeating, list[str]]:
    told: list[str] = []
    return Repeating(tmp_path, told.append, lambda: free), told


def test_an_overloaded_flight_is_flown_again_in_a_folder_of_its_own_and_counted(
    tmp_path: Path,
) -> None:
    again, told = repeating(tmp_path)
    flights = Ends("overloaded", "overloaded", "flown")
    assert again(flights) == "flown 3"
    assert len(set(flights.flown)) == 3 and all(folder.is_dir() for folder in flights.flown)
    assert told == [LATE, LATE]


@pytest.mark.parametrize("outcome", ["flown", "monitor_violated", "target_lost", "harness_failed"])
def test_any_other_end_is_what_the_flight_came_to(tmp_path: Path, outcome: str) -> None:
    again, told = repeating(tmp_path)
    flights = Ends(outcome, "flown")
    assert again(flights) == f"{outcome} 1"
    assert (len(flights.flown), told) == (1, [])


def test_a_computer_that_is_always_too_slow_fails_the_test_with_each_time_told(
    tmp_path: Path,
) -> None:
    again, told = repeating(tmp_path)
    flights = Ends(*["overloaded"] * (TRIES + 1))
    with pytest.raises(pytest.fail.Exception, match=f"too slow {TRIES} times") as failed:
        again(flights)
    assert str(failed.value).count(LATE) == len(flights.flown) == len(told) == TRIES


def test_the_cores_are_waited_for_before_each_repetition_and_it_is_told_when_they_stayed_busy(
    tmp_path: Path,
) -> None:
    again, told = repeating(tmp_path, free=False)
    assert again(Ends("overloaded", "flown")) == "flown 2"
    assert told == [f"{LATE}; no cores were free for {WAIT_S:g} s after it"]
    waits: list[int] = []
    flights = Ends(*["overloaded"] * TRIES)
    with pytest.raises(pytest.fail.Exception):
        Repeating(tmp_path / "again", told.append, lambda: not waits.append(len(flights.flown)))(
            flights
        )
    assert waits == list(range(1, TRIES))


def test_a_program_that_ends_before_what_is_waited_for_is_no_reason_to_fail() -> None:
    seen: list[str] = []
    command = [sys.executable, "-c", "print('take-off'); print('too slow')"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert says(process, "take-off", seen, 60.0)
        assert not says(process, "stand-off", seen, 60.0)
    assert seen == ["take-off\n", "too slow\n"]


def test_what_was_flown_again_is_told_at_the_end_once_for_each_time() -> None:
    properties = [("flown again", LATE), ("other", "x"), ("flown again", LATE)]
    reports = [
        SimpleNamespace(nodeid="test_a", when=when, user_properties=properties)
        for when in ("setup", "call")
    ]
    assert repetitions([*reports, SimpleNamespace(message="a warning")]) == [f"test_a: {LATE}"] * 2
