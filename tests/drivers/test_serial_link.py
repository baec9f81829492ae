"""The serial link over pseudo terminals: the real library and the real port handling, a cable of our own between."""

from __future__ import annotations

import asyncio
import os
import time
import tty
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import LinkError
from drivers.serial_link import SerialLink
from path.messages import Accept, Role, Target
from tests.drivers.link_ends import STATUS, TARGET, Context, WallClock, introduce, run, until


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

    def unplug(self) -> None:
        for name, (radio, port) in zip(self.names, self._ends, strict=True):
            asyncio.get_running_loop().remove_reader(radio)
            os.close(radio)
            os.close(port)
            name.unlink(missing_ok=True)
        self._ends = []


def links(cable: Cable, key_file: Path | None, baud: int = 115_200) -> tuple[SerialLink, SerialLink]:
    one, other = (
        SerialLink(SerialLink.Config(str(name), baud, key_file, key_file is None), Context(role, WallClock()))
        for name, role in zip(cable.names, Role, strict=True)
    )
    return one, other


def test_messages_cross_both_ways_signed(tmp_path: Path, key_file: Path) -> None:
    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = links(cable, key_file)
        async with sender, receiver:
            await introduce(sender, receiver)
            sender.send(TARGET)
            received = await receiver.receive()
            assert received.message == TARGET
            assert received.arrival_ns <= time.monotonic_ns()
            receiver.send(Accept(1, 2, 3, 4, 5))
            assert (await sender.receive()).message == Accept(1, 2, 3, 4, 5)
            assert sender.counters.bytes_sent == receiver.counters.bytes_received
            assert sender.counters.dropped == receiver.counters.dropped == {}
        cable.unplug()

    run(test(), within_s=20.0)


def test_noise_on_the_radio_is_counted_and_costs_only_what_it_hit(tmp_path: Path, key_file: Path) -> None:
    async def test() -> None:
        cable = Cable(tmp_path, carry=lambda data: b"\xfd\x00noise" + data)
        cable.plug()
        sender, receiver = links(cable, key_file)
        async with sender, receiver:
            await introduce(sender, receiver)
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            assert receiver.counters.dropped["noise"] >= 1
        cable.unplug()

    run(test(), within_s=20.0)


def test_a_slow_radio_carries_the_present(tmp_path: Path) -> None:
    """9600 baud are 960 B/s; twice that is asked for. What arrives is recent, and the hand-over is not held up."""

    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = links(cable, None, baud=9600)
        async with sender, receiver:
            for k in range(40):
                sender.send(replace(TARGET, sequence=k))
                sender.send(replace(STATUS, phase=k))
            sender.send(Accept(1, 2, 3, 4, 5))
            got = [(await receiver.receive()).message]
            while not {replace(STATUS, phase=39), replace(TARGET, sequence=39)} <= set(got):
                got.append((await receiver.receive()).message)
            assert Accept(1, 2, 3, 4, 5) in got
            assert got.index(Accept(1, 2, 3, 4, 5)) < got.index(replace(TARGET, sequence=39))
            assert len(got) < 12
            assert sender.counters.dropped["superseded_unsent"] > 60
        cable.unplug()

    run(test(), within_s=20.0)


def test_a_radio_that_is_unplugged_is_silence_and_may_come_back(tmp_path: Path, key_file: Path) -> None:
    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = links(cable, key_file)
        async with sender, receiver:
            await introduce(sender, receiver)
            cable.unplug()
            await until(lambda: _lost(sender, TARGET) and _lost(receiver, Accept(1, 2, 3, 4, 5)))
            cable.plug()
            waiting = asyncio.ensure_future(receiver.receive())
            while not waiting.done():
                sender.send(TARGET)
                await asyncio.sleep(0.01)
            assert waiting.result().message == TARGET
        cable.unplug()

    run(test(), within_s=20.0)


def _lost(link: SerialLink, message: Target | Accept) -> bool:
    link.send(message)
    return "port_lost" in link.counters.dropped


def test_a_port_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    async def test() -> None:
        link, _ = links(Cable(tmp_path), None)
        with pytest.raises(LinkError, match=r"serial port .*one") as error:
            await link.__aenter__()
        assert "dialout" in error.value.remedy

    run(test(), within_s=20.0)


@pytest.mark.parametrize(
    ("changes", "named"), [({"baud": 300}, "baud"), ({"key_file": None, "allow_unsigned": False}, "key_file")]
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, Any], named: str) -> None:
    settings: dict[str, Any] = {"port": "/dev/null", "allow_unsigned": True}
    with pytest.raises(ValueError, match=named):
        SerialLink.Config(**(settings | changes))
