"""The contract of both ends of every line between a role and its guard: over UDP, and inside a
process.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

import pytest

from drivers.mavlink.guard.interfaces import Beat, BeatLine, GuardAnswer, GuardLine, Hand, Script
from drivers.mavlink.guard.line import UdpBeatLine, UdpGuardLine
from hil.harness.guard import MemoryBeatLine
from tests.drivers.link.link_ends import WallClock, run, until
from tests.free_ports import free_ports

CLOCK = WallClock()


@dataclass
class Stage:
    """The guard's end is open; ``role`` makes an end of a program that begins."""

    guard: BeatLine
    role: Callable[[], GuardLine]


@asynccontextmanager
async def udp() -> AsyncGenerator[Stage]:
    bind = f"127.0.0.1:{free_ports(1)[0]}"
    async with UdpBeatLine(bind, CLOCK) as guard:
        yield Stage(guard, lambda: UdpGuardLine(bind, CLOCK))


@asynccontextmanager
async def memory() -> AsyncGenerator[Stage]:
    async with MemoryBeatLine(CLOCK) as guard:
        yield Stage(guard, guard.role_end)


LINES = pytest.mark.parametrize("stage_of", [udp, memory])
StageOf = Callable[[], contextlib.AbstractAsyncContextManager[Stage]]


async def heard(guard: BeatLine) -> tuple[int, Beat]:
    got: list[tuple[int, Beat]] = []

    def look() -> bool:
        newest = guard.newest()
        got.extend([newest] if newest is not None else [])
        return bool(got)

    await until(look)
    return got[0]


@LINES
def test_the_newest_beat_counts_once_and_is_stamped(stage_of: StageOf) -> None:
    async def test() -> None:
        async with stage_of() as stage, stage.role() as role:
            assert role.name
            assert stage.guard.newest() is None
            before_ns = CLOCK.now_ns()
            for setpoints in range(5):
                role.beat(Beat(Script.CONTROL, setpoints, 1.5, (1.0, 2.0, -3.0)))
            arrival_ns, beat = await heard(stage.guard)
            assert beat == Beat(Script.CONTROL, 4, 1.5, (1.0, 2.0, -3.0))
            assert before_ns <= arrival_ns <= CLOCK.now_ns()
            assert stage.guard.newest() is None
            role.beat(Beat(Script.IDLE, 5))
            assert math.isnan((await heard(stage.guard))[1].separation_m)

    run(test())


@LINES
def test_answers_go_to_whoever_beat_last_and_the_newest_stays(stage_of: StageOf) -> None:
    async def test() -> None:
        async with stage_of() as stage, stage.role() as role:
            stage.guard.answer(GuardAnswer(True, Hand.FREE))  # to nobody yet
            await asyncio.sleep(0.01)
            assert role.answer() is None
            role.beat(Beat(Script.CONTROL, 1))
            await heard(stage.guard)
            stage.guard.answer(GuardAnswer(True, Hand.SCRIPT))
            stage.guard.answer(GuardAnswer(True, Hand.GUARD, "why"))
            await until(
                lambda: (newest := role.answer()) is not None and newest[1].hand is Hand.GUARD
            )
            assert role.answer() == role.answer()
            async with stage.role() as again:  # the program was started again
                assert again.answer() is None
                again.beat(Beat(Script.IDLE, 0))
                await heard(stage.guard)
                stage.guard.answer(GuardAnswer(False, Hand.FREE))
                await until(lambda: again.answer() is not None)
                newest = role.answer()
                assert newest is not None
                assert newest[1].hand is Hand.GUARD

    run(test())


@LINES
def test_an_end_that_is_not_open_says_nothing_and_raises_nothing(stage_of: StageOf) -> None:
    async def test() -> None:
        async with stage_of() as stage:
            role = stage.role()
            role.beat(Beat(Script.CLIMB, 0))
            assert role.answer() is None
            async with role:
                pass
            role.beat(Beat(Script.CLIMB, 0))
            await role.__aexit__(None, None, None)
            await asyncio.sleep(0.01)
            assert stage.guard.newest() is None

    run(test())
