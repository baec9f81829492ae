"""A program that stands still in virtual time: nothing of it runs, everybody else does, and nothing
of it is lost.
"""

from __future__ import annotations

import asyncio
from contextvars import copy_context
from typing import Any

import pytest

from hil.harness.stalls import PROGRAM, StallingLoop
from hil.harness.virtual_time import run_virtual


def program(name: str, main: Any) -> asyncio.Future[Any]:
    context = copy_context()
    context.run(PROGRAM.set, name)
    return context.run(asyncio.ensure_future, main)


def stalling() -> StallingLoop:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, StallingLoop)
    return loop


def fly(main: Any) -> Any:
    return run_virtual(main, StallingLoop)


def test_only_the_program_that_stands_still_does() -> None:
    ticks: dict[str, list[float]] = {"a": [], "b": []}

    async def tick(name: str) -> None:
        async def inside() -> None:
            for _ in range(5):
                await asyncio.sleep(0.1)
                ticks[name].append(round(asyncio.get_running_loop().time(), 3))

        await asyncio.create_task(inside())  # a task of its own is the program's too

    async def main() -> None:
        both = [program(name, tick(name)) for name in ticks]
        await asyncio.sleep(0.25)
        assert stalling().stand_still("a", 1.0) == pytest.approx(1.25)
        await asyncio.gather(*both)

    fly(main())
    assert ticks == {"a": [0.1, 0.2, 1.25, 1.35, 1.45], "b": [0.1, 0.2, 0.3, 0.4, 0.5]}


def test_what_came_due_meanwhile_runs_in_its_order_and_what_was_taken_back_does_not() -> None:
    order: list[str] = []

    async def own() -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(0.5, order.append, "second")
        loop.call_later(0.4, order.append, "first")
        taken_back = loop.call_later(0.3, order.append, "never")
        loop.call_later(0.2, taken_back.cancel)
        await asyncio.sleep(2.0)

    async def main() -> None:
        running = program("a", own())
        await asyncio.sleep(0.1)
        stalling().stand_still("a", 1.0)
        await asyncio.sleep(0.9)
        assert order == []
        await running

    fly(main())
    assert order == ["first", "second"]


def test_a_deadline_that_passed_in_a_stall_has_passed_when_the_program_goes_on() -> None:
    async def own() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await asyncio.sleep(10.0)
        return asyncio.get_running_loop().time()

    async def main() -> float:
        running = program("a", own())
        await asyncio.sleep(0.1)
        stalling().stand_still("a", 2.0)
        return await running

    assert fly(main()) == pytest.approx(2.1)


def test_a_second_stall_within_the_first_makes_it_longer_and_one_that_is_killed_waits_for_nothing() -> (
    None
):
    async def own() -> None:
        await asyncio.sleep(0.2)

    async def main() -> list[float]:
        ends: list[float] = []
        for wake in (False, True):
            began_s = asyncio.get_running_loop().time()
            running = program("a", own())
            await asyncio.sleep(0.1)
            stalling().stand_still("a", 1.0)
            await asyncio.sleep(0.5)
            stalling().stand_still("a", 1.0)
            if wake:
                stalling().wake("a")
            await running
            ends.append(asyncio.get_running_loop().time() - began_s)
        return ends

    assert fly(main()) == pytest.approx([1.6, 0.6])
