"""Processor time goes to the stage that spent it."""

from __future__ import annotations

import pytest

from drivers.clock import busy_ns
from drivers.stages import Stages


def spend(nanoseconds: int) -> None:
    end_ns = busy_ns() + nanoseconds
    while busy_ns() < end_ns:
        pass


def test_each_stage_gets_what_was_spent_in_it() -> None:
    stages = Stages()
    before_ns = stages.spent_ns()
    for _ in range(3):
        with stages("marker"):
            spend(4_000_000)
    with stages("link"):
        spend(1_000_000)
    spend(2_000_000)
    spent_ns = stages.spent_ns()
    assert list(spent_ns) == ["marker", "link", "thread", "program"]
    assert spent_ns["marker"] >= 12_000_000 and spent_ns["link"] >= 1_000_000
    assert (
        spent_ns["thread"] - before_ns["thread"]
        >= spent_ns["marker"] + spent_ns["link"] + 2_000_000
    )
    assert spent_ns["program"] - before_ns["program"] >= 15_000_000


def test_a_stage_that_fails_has_spent_its_time() -> None:
    stages = Stages()
    with pytest.raises(ValueError), stages("marker"):
        spend(1_000_000)
        raise ValueError
    assert stages.spent_ns()["marker"] >= 1_000_000
