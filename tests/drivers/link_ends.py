"""What the tests of all links share: a role's context, bounded waits, and two ends that prove themselves."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from drivers.interfaces import Link
from path.messages import Ping, Pong, Role, Status, Target

TARGET = Target(1, 2, 3, 4, 50_000, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 0.01)
STATUS = Status(Role.SENDER, 50_000, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 3, True, True, 0.5)


class WallClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()


@dataclass(frozen=True)
class Context:
    role: Role
    clock: WallClock


def run(test: Coroutine[Any, Any, None], within_s: float = 10.0) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(within_s):
            await test

    asyncio.run(bounded())


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 (what is waited for is a counter)
        await asyncio.sleep(0.001)


async def introduce(one: Link, other: Link) -> None:
    """Each end proves itself by answering the other's ping."""
    for asking, answering in ((one, other), (other, one)):
        asking.send(Ping(1, 5))
        assert (await answering.receive()).message == Ping(1, 5)
        answering.send(Pong(1, 5, 6, 7))
        assert (await asking.receive()).message == Pong(1, 5, 6, 7)
