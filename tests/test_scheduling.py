"""Flights in real time go first: beside them two workers compute in the background, and nobody else
is given a test before the last of them is down.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests import background
from tests.scheduling import (
    APART,
    BESIDE,
    COMPUTES,
    FLIGHTS,
    FLYING,
    LONG,
    REAL_TIME,
    SESSIONS,
    Groups,
    computes,
    fits_beside_flights,
    group_of,
    told_by_group,
    urgency,
)

TESTS = Path(__file__).parent

FLIGHT = "tests/scenarios/test_own_sitl.py::test_flies"
OTHER_FLIGHT = "tests/scenarios/test_guard_sitl.py::test_flies_too"
COMPUTING = [
    f"tests/path/gate/test_{letter}.py::test_{number}" for letter in "abcdef" for number in range(3)
]
WAITING = [f"tests/drivers/tello/test_a.py::test_{number}" for number in range(5)]
ALL = [*COMPUTING, *WAITING, FLIGHT, OTHER_FLIGHT]


class Worker:
    """In the place of a worker of xdist: what it was given, in order."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.collection: list[str] = []
        self.given: list[str] = []
        self.shutting_down = False

    def send_runtest_some(self, indices: list[int]) -> None:
        self.given += [self.collection[index] for index in indices]

    def shutdown(self) -> None:
        self.shutting_down = True


def scheduled(
    collection: list[str], workers: list[Worker], flying: Path = TESTS / "none"
) -> Groups:
    no_log: Any = None
    options = SimpleNamespace(loadscopereorder=True)
    config: Any = SimpleNamespace(getvalue={"tx": ["popen"] * len(workers)}.get, option=options)
    groups = Groups(config, no_log, flying)
    add(groups, collection, workers)
    groups.schedule()
    return groups


def add(groups: Groups, collection: list[str], workers: list[Worker]) -> None:
    for worker in workers:
        worker.collection = collection
        given: Any = worker
        groups.add_node(given)
        groups.add_node_collection(given, collection)


def complete(groups: Groups, worker: Worker, nodeid: str) -> None:
    done: Any = worker
    groups.mark_test_complete(done, worker.collection.index(nodeid))


def fly_and_do_the_rest(groups: Groups, workers: list[Worker]) -> None:
    """As workers do: a test is run when the next one is there, or the word that none comes."""
    done: set[str] = set()
    while ready := [
        (worker, each)
        for worker in workers
        for each in (worker.given if worker.shutting_down else worker.given[:-1])
        if each not in done
    ]:
        worker, each = ready[0]
        done.add(each)
        complete(groups, worker, each)


@pytest.fixture
def workers() -> list[Worker]:
    return [Worker(f"gw{number}") for number in range(4)]


@pytest.fixture(autouse=True)
def idle_is_possible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the system of these tests has no background."""
    monkeypatch.setattr(background, "POSSIBLE", True)


def test_flights_are_given_to_one_worker_and_two_others_compute_meanwhile(
    workers: list[Worker],
) -> None:
    scheduled(ALL, workers)
    first, second, *others = workers
    assert first.given[:2] == [FLIGHT, OTHER_FLIGHT]
    assert second.given == []
    assert [set(worker.given) <= set(COMPUTING) for worker in others] == [True, True]
    assert all(len(worker.given) >= 3 for worker in others)
    assert not any(worker.shutting_down for worker in workers)


def test_nobody_computes_beside_flights_where_it_cannot_be_in_the_background(
    workers: list[Worker], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background, "POSSIBLE", False)
    scheduled(ALL, workers)
    assert [worker.given for worker in workers[1:]] == [[], [], []]


def test_what_begins_sessions_of_its_own_is_not_beside_flights() -> None:
    assert not fits_beside_flights("tests/mutants/test_mutants.py::test_a")
    assert not fits_beside_flights(group_of(WAITING[0])) and not fits_beside_flights(FLIGHTS)
    assert fits_beside_flights(group_of(COMPUTING[0]))


def test_everybody_gets_work_when_the_last_flight_is_down_and_not_before(
    workers: list[Worker],
) -> None:
    groups = scheduled(ALL, workers)
    first, second, *_ = workers
    complete(groups, first, FLIGHT)
    assert second.given == []
    complete(groups, first, OTHER_FLIGHT)
    assert len(second.given) >= 3
    # What waits goes to whoever flew and has not computed: a worker that has cannot be urgent
    # again.
    assert first.given[2:] == WAITING


def test_a_file_says_whether_something_flies(workers: list[Worker], tmp_path: Path) -> None:
    flying = tmp_path / "flying"
    flying.touch()
    groups = scheduled(ALL, workers, flying)
    complete(groups, workers[0], FLIGHT)
    assert flying.exists()
    complete(groups, workers[0], OTHER_FLIGHT)
    assert not flying.exists()
    flying.touch()
    scheduled(COMPUTING, [Worker("gw9")], flying)
    assert not flying.exists()


def test_workers_that_computed_beside_flights_are_not_given_what_waits_after_them(
    workers: list[Worker],
) -> None:
    groups = scheduled(ALL, workers)
    _, _, *computing = workers
    for worker in computing:
        for each in list(worker.given):
            complete(groups, worker, each)
    first = workers[0]
    complete(groups, first, FLIGHT)
    complete(groups, first, OTHER_FLIGHT)
    assert not any(set(worker.given) & set(WAITING) for worker in computing)


def test_flights_of_a_worker_that_died_are_flown_by_another_while_the_rest_waits(
    workers: list[Worker],
) -> None:
    groups = scheduled(ALL, workers)
    first, second, *computing = workers
    died: Any = first
    assert groups.remove_node(died) == FLIGHT
    assert second.given[0] == OTHER_FLIGHT
    assert not any(set(worker.given) & {FLIGHT, OTHER_FLIGHT, *WAITING} for worker in computing)


def test_a_test_that_a_worker_died_in_is_given_to_nobody_else(workers: list[Worker]) -> None:
    groups = scheduled(ALL, workers)
    third = workers[2]
    died: Any = third
    left = list(third.given)
    complete(groups, third, left[0])
    assert groups.remove_node(died) == left[1]
    fly_and_do_the_rest(groups, [each for each in workers if each is not third])
    given = [each for worker in workers if worker is not third for each in worker.given]
    assert sorted(given) == sorted(set(ALL) - set(left[:2]))


def test_everybody_gets_work_when_a_worker_dies_in_the_last_flight(
    workers: list[Worker], tmp_path: Path
) -> None:
    flying = tmp_path / "flying"
    flying.touch()
    groups = scheduled(ALL, workers, flying)
    first, second, *_ = workers
    complete(groups, first, FLIGHT)
    died: Any = first
    assert groups.remove_node(died) == OTHER_FLIGHT
    assert not flying.exists()
    assert second.given[: len(WAITING)] == WAITING


def test_what_the_only_worker_leaves_is_done_by_the_one_that_comes_in_its_place(
    workers: list[Worker],
) -> None:
    groups = scheduled(ALL, workers[:1])
    died: Any = workers[0]
    assert groups.remove_node(died) == FLIGHT
    late = workers[1]
    add(groups, ALL, [late])
    groups.schedule()
    fly_and_do_the_rest(groups, [late])
    assert sorted(late.given) == sorted(set(ALL) - {FLIGHT})


def test_a_worker_that_came_in_the_place_of_another_is_given_nothing_before_it_has_collected(
    workers: list[Worker],
) -> None:
    groups = scheduled(ALL, workers[:3])
    first, second, third, late = workers
    came: Any = late
    groups.add_node(came)
    late.collection = ALL
    for each in (third, second):
        died: Any = each
        groups.remove_node(died)
    assert late.given == []
    groups.add_node_collection(came, ALL)
    groups.schedule()
    fly_and_do_the_rest(groups, [first, late])
    assert late.given
    assert groups.tests_finished


def test_a_worker_that_comes_late_is_given_more_than_one_test_or_the_word_that_none_comes(
    workers: list[Worker],
) -> None:
    alone = [f"tests/scenarios/test_sim.py::test_{number}" for number in range(6)]
    groups = scheduled(alone, workers[:1])
    died: Any = workers[0]
    groups.remove_node(died)
    late = workers[1]
    add(groups, alone, [late])
    groups.schedule()
    fly_and_do_the_rest(groups, [late])
    assert sorted(late.given) == alone[1:]
    assert groups.tests_finished


def test_every_test_is_given_to_somebody_once(workers: list[Worker]) -> None:
    groups = scheduled(ALL, workers)
    fly_and_do_the_rest(groups, workers)
    assert sorted(each for worker in workers for each in worker.given) == sorted(ALL)
    assert groups.tests_finished
    assert all(worker.shutting_down for worker in workers)


def test_without_flights_everybody_begins_at_once(workers: list[Worker]) -> None:
    scheduled([each for each in ALL if group_of(each) != FLIGHTS], workers)
    assert all(worker.given for worker in workers)


def test_what_flies_waits_or_computes_is_told_apart() -> None:
    assert group_of(FLIGHT) == group_of(OTHER_FLIGHT) == FLIGHTS
    assert [computes(each) for each in (FLIGHT, WAITING[0], COMPUTING[0])] == [False, False, True]
    assert (
        urgency(group_of(FLIGHT)) < urgency(group_of(WAITING[0])) < urgency(group_of(COMPUTING[0]))
    )
    assert computes("tests/hil/render/test_looks.py::test_a") and not computes(
        "tests/hil/tello/test_video.py::test_a"
    )


def test_every_place_that_is_named_is_there() -> None:
    """Tests that moved would else compute beside flights, or wait their turn for nothing."""
    beside = [place for places in BESIDE.values() for place in places]
    for place in (*FLYING, *REAL_TIME, *COMPUTES, *beside, *APART, *LONG, *SESSIONS):
        file = place.partition("::")[0]
        assert list(TESTS.glob(f"{file}*")), place


def test_when_each_group_was_over_is_told() -> None:
    def report(nodeid: str, start: float, stop: float) -> SimpleNamespace:
        return SimpleNamespace(nodeid=nodeid, start=start, stop=stop)

    reports = [
        report(COMPUTING[0], 102.0, 103.0),
        report(FLIGHT, 100.0, 150.4),
        report(OTHER_FLIGHT, 150.4, 190.0),
        report(WAITING[0], 190.0, 200.0),
        report(COMPUTING[5], 150.0, 230.0),
        report(COMPUTING[8], 0.0, 0.0),
    ]
    assert told_by_group(reports) == [
        "flights: 0 to 90 s",
        "computes: 2 to 130 s",
        "real time, cameras: 90 to 100 s",
    ]
    assert told_by_group([]) == []


BY_TEST = """
import os
from pathlib import Path
from tests.scheduling import be_nice
session = Path("/proc/self/autogroup")
for nodeid, flying in {tests!r}:
    be_nice(nodeid, flying)
    nice = session.read_text().split()[-1:] if session.exists() else []
    print(os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0), *nice)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the background is Linux's")
def test_a_worker_is_as_nice_as_the_test_that_comes_next_not_as_its_first_was() -> None:
    """A worker that began with contracts computed at nice 0 beside a flight."""
    tests = [(WAITING[0], False), (COMPUTING[0], True), (COMPUTING[1], False), (WAITING[0], False)]
    command = [sys.executable, "-c", BY_TEST.format(tests=tests)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    began, beside, after, again = [list(map(int, line.split())) for line in ran.stdout.splitlines()]
    behind = [min(19, began[0] + 15), os.SCHED_IDLE]
    assert beside[:2] == after[:2] == behind
    assert [beside[2:], after[2:], again[2:]] in ([[], [], []], [[15], [5], [0]])
    if os.geteuid() == 0:
        assert again[:2] == began[:2]
