"""Pieces on all cores: order, bars, failures."""

import io
import os

import pytest

from missions.ground.work import Bars, Work, open_work


def square(x: int) -> int:
    return x * x


def process_of(_: int) -> int:
    return os.getpid()


def refuse(x: int) -> int:
    if x == 3:
        raise ValueError("three")
    return x


def test_results_come_in_the_order_of_the_items_whatever_the_number_of_processes() -> None:
    for jobs in (1, 2):
        with open_work(jobs, io.StringIO()) as work:
            assert work.map("squares", square, list(range(40))) == [x * x for x in range(40)]


def test_one_pool_serves_all_work_and_is_gone_afterwards() -> None:
    with open_work(2, io.StringIO()) as work:
        first = set(work.map("a", process_of, list(range(20))))
        second = set(work.map("b", process_of, list(range(20))))
        assert len(first | second) <= 2
        assert os.getpid() not in first
    for process in first | second:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_a_piece_that_fails_ends_the_work_with_its_own_error() -> None:
    with open_work(2, io.StringIO()) as work, pytest.raises(ValueError, match="three"):
        work.map("numbers", refuse, list(range(50)))


def test_where_no_terminal_is_each_tenth_gives_a_line() -> None:
    stream = io.StringIO()
    assert Work(1, Bars(stream)).map("squares", square, list(range(30))) == [
        x * x for x in range(30)
    ]
    lines = stream.getvalue().splitlines()
    assert lines[0] == "squares: 3/30"
    assert lines[-1] == "squares: 30/30"
    assert len(lines) == 10
