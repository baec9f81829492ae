"""The helpers that the tests of all links share.

A role's context, bounded waits, and two ends that prove themselves.
"""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.interfaces import Link
from drivers.link.serial_radio import SerialLink
from path.messages import Ping, Pong, Role, Status, Target
from tests.doubles import WallClock

TARGET = Target(1, 2, 3, 4, 50_000, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), 0.01)
STATUS = Status(Role.SENDER, 50_000, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 3, True, True, 0.5)


@dataclass(frozen=True)
class Context:
    role: Role
    clock: WallClock


def run(test: Coroutine[Any, Any, None], within_s: float = 60.0) -> None:
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


class Cable:
    """Two ports, by names that stay, and what one writes the other reads, as ``carry`` says."""

    def __init__(self, folder: Path, carry: Callable[[bytes], bytes] = lambda data: data) -> None:
        self.names = [folder / "one", folder / "other"]
        self._carry = carry
        self._ends: list[tuple[int, int]] = []

    def plug(self) -> None:
        loop = asyncio.get_running_loop()
        self._ends = [os.openpty() for _ in self.names]
        for name, (radio, port) in zip(self.names, self._ends, strict=True):
            tty.setraw(port)
            name.unlink(missing_ok=True)
            name.symlink_to(os.ttyname(port))
            os.set_blocking(radio, False)
        (one, _), (other, _) = self._ends
        loop.add_reader(one, self._move, one, other)
        loop.add_reader(other, self._move, other, one)

    def _move(self, source: int, sink: int) -> None:
        try:
            os.write(sink, self._carry(os.read(source, 4096)))
        except OSError:
            asyncio.get_running_loop().remove_reader(source)

    def garble(self) -> None:
        """From now on noise comes in place of what was sent."""
        self._carry = _noise

    def inject(self, data: bytes) -> None:
        """Adds bytes to what the other one's radio hears."""
        os.write(self._ends[1][0], data)

    def unplug(self) -> None:
        for name in self.names:
            name.unlink(missing_ok=True)
        for radio, port in self._ends:
            asyncio.get_running_loop().remove_reader(radio)
            os.close(radio)
            os.close(port)
        self._ends = []


def serial_links(
    cable: Cable, key_file: Path | None, baud: int = 115_200
) -> tuple[SerialLink, SerialLink]:
    one, other = (
        SerialLink(
            SerialLink.Config(str(name), baud, key_file, key_file is None),
            Context(role, WallClock()),
        )
        for name, role in zip(cable.names, Role, strict=True)
    )
    return one, other


def _noise(data: bytes) -> bytes:
    return os.urandom(len(data))
