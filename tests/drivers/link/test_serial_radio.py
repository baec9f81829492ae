"""The serial link over pseudo terminals: the real library and the real port handling, a cable of
our own between.
"""

from __future__ import annotations

import asyncio
import termios
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import serial

from drivers.interfaces import LinkError
from drivers.link.serial_radio import SerialLink
from path.messages import Accept, Target
from tests.drivers.link.link_ends import STATUS, TARGET, Cable, introduce, run, serial_links, until


def test_noise_on_the_radio_is_counted_and_costs_only_what_it_hit(
    tmp_path: Path, key_file: Path
) -> None:
    async def test() -> None:
        cable = Cable(tmp_path, carry=lambda data: b"\xfd\x00noise" + data)
        cable.plug()
        sender, receiver = serial_links(cable, key_file)
        async with sender, receiver:
            await introduce(sender, receiver)
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            assert receiver.counters.dropped["noise"] >= 1
        cable.unplug()

    run(test())


def test_a_slow_radio_carries_the_present(tmp_path: Path) -> None:
    """9600 baud are 960 B/s; twice that is asked for. What arrives is recent, and the hand-over is
    not held up.
    """

    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = serial_links(cable, None, baud=9600)
        async with sender, receiver:
            for k in range(40):
                sender.send(replace(TARGET, sequence=k))
                sender.send(replace(STATUS, phase=k))
            sender.send(Accept(1, 2, 3, 4, 5, 9))
            got = [(await receiver.receive()).message]
            while not {replace(STATUS, phase=39), replace(TARGET, sequence=39)} <= set(got):
                got.append((await receiver.receive()).message)
            assert Accept(1, 2, 3, 4, 5, 9) in got
            assert got.index(Accept(1, 2, 3, 4, 5, 9)) < got.index(replace(TARGET, sequence=39))
            assert len(got) < 12
            assert sender.counters.dropped["superseded_unsent"] > 60
        cable.unplug()

    run(test())


def test_a_radio_that_is_unplugged_is_silence_and_may_come_back(
    tmp_path: Path, key_file: Path
) -> None:
    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = serial_links(cable, key_file)
        async with sender, receiver:
            await introduce(sender, receiver)
            cable.unplug()
            await until(lambda: _lost(sender, TARGET) and _lost(receiver, Accept(1, 2, 3, 4, 5, 9)))
            cable.plug()
            waiting = asyncio.ensure_future(receiver.receive())
            while not waiting.done():
                sender.send(TARGET)
                await asyncio.sleep(0.01)
            assert waiting.result().message == TARGET
        cable.unplug()

    run(test())


def _lost(link: SerialLink, message: Target | Accept) -> bool:
    link.send(message)
    return "port_lost" in link.counters.dropped


def test_a_port_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    async def test() -> None:
        link, _ = serial_links(Cable(tmp_path), None)
        with pytest.raises(LinkError, match=r"serial port .*one") as error:
            await link.__aenter__()
        assert "dialout" in error.value.remedy

    run(test())


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"baud": 300}, "baud"), ({"key_file": None, "allow_unsigned": False}, "key_file")],
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, Any], named: str) -> None:
    settings: dict[str, Any] = {"port": "/dev/null", "allow_unsigned": True}
    with pytest.raises(ValueError, match=named):
        SerialLink.Config(**(settings | changes))


def test_a_port_that_vanishes_again_while_it_is_opened_is_tried_again(
    tmp_path: Path, key_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pyserial lets errors of the terminal's settings through as they are: no OSError."""
    real, failed = serial.Serial, list[str]()

    def flaps(port: str, *arguments: Any, **named: Any) -> serial.Serial:
        if len(failed) < 2:
            failed.append(port)
            raise termios.error(5, "Input/output error")
        return real(port, *arguments, **named)

    async def test() -> None:
        cable = Cable(tmp_path)
        cable.plug()
        sender, receiver = serial_links(cable, key_file)
        async with sender, receiver:
            cable.unplug()
            await until(lambda: _lost(sender, TARGET) and _lost(receiver, Accept(1, 2, 3, 4, 5, 9)))
            monkeypatch.setattr("drivers.link.serial_radio.serial.Serial", flaps)
            cable.plug()
            async with asyncio.timeout(30.0):
                await introduce_at_last(sender, receiver)
        cable.unplug()

    run(test())
    assert len(failed) == 2


async def introduce_at_last(one: SerialLink, other: SerialLink) -> None:
    """Once both ports are open."""
    await until(lambda: one._port is not None and other._port is not None)
    await introduce(one, other)
