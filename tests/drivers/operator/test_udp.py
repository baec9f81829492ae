"""Somebody who speaks by UDP is heard, is asked, and cannot stop a flight with nonsense."""

from __future__ import annotations

import asyncio
import json
import socket
from dataclasses import dataclass
from typing import Any

import pytest

from drivers.interfaces import LinkError
from drivers.operator.interfaces import Chosen, PlaceTold
from drivers.operator.udp import WAITING, UdpOperator, UdpOperatorConfig
from path.messages import Role
from tests.drivers.operator.test_words import NOW_NS, QUESTION
from tests.free_ports import free_port

PATIENCE_S = 60.0


@dataclass
class Clock:
    now: int = NOW_NS

    def now_ns(self) -> int:
        return self.now


@dataclass
class Context:
    clock: Clock
    role: Role = Role.SENDER


async def until_heard(operator: UdpOperator, count: int) -> list[Any]:
    heard: list[Any] = []
    async with asyncio.timeout(PATIENCE_S):
        while len(heard) < count:
            heard += operator.heard()
            await asyncio.sleep(0.01)
    return heard


def speaker() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(PATIENCE_S)
    return made


def test_it_is_heard_and_asked_and_answers() -> None:
    async def talk() -> None:
        port = free_port()
        clock = Clock()
        async with UdpOperator(UdpOperatorConfig(f"127.0.0.1:{port}"), Context(clock)) as operator:
            with speaker() as tablet:
                tablet.sendto(
                    json.dumps({"place": [4, 1], "error_m": 0.3}).encode(), ("127.0.0.1", port)
                )
                assert await until_heard(operator, 1) == [PlaceTold(NOW_NS, (4.0, 1.0, 0.0), 0.3)]
                assert json.loads(tablet.recv(1 << 16)) == {"asks": None}
                operator.ask(QUESTION, None)
                asked = json.loads(await asyncio.to_thread(tablet.recv, 1 << 16))
                assert asked["asks"] == 3
                answer = {"question": 3, "number": asked["objects"][0]["number"]}
                tablet.sendto(json.dumps(answer).encode(), ("127.0.0.1", port))
                assert await until_heard(operator, 1) == [Chosen(3, 7)]
                clock.now += 20_000_000_000
                operator.ask(None, None)  # who was not heard for so long is not told
                tablet.settimeout(0.1)
                with pytest.raises(TimeoutError):
                    tablet.recv(1 << 16)

    asyncio.run(talk())


def test_whoever_comes_in_while_a_question_is_open_is_asked_it() -> None:
    async def talk() -> None:
        port = free_port()
        async with UdpOperator(
            UdpOperatorConfig(f"127.0.0.1:{port}"), Context(Clock())
        ) as operator:
            operator.ask(QUESTION, None)
            with speaker() as tablet:
                tablet.sendto(b'{"hello": true}', ("127.0.0.1", port))
                asked = json.loads(await asyncio.to_thread(tablet.recv, 1 << 16))
                assert asked["asks"] == 3

    asyncio.run(talk())


def test_nonsense_is_counted_and_a_flood_is_dropped() -> None:
    async def talk() -> None:
        port = free_port()
        async with UdpOperator(
            UdpOperatorConfig(f"127.0.0.1:{port}"), Context(Clock())
        ) as operator:
            for _ in range(3):
                operator.take(b"{", ("127.0.0.1", 9))
            for _ in range(3 * WAITING):
                operator.take(b'{"question": 1, "number": 1}', ("127.0.0.1", 9))
            assert len(operator.heard()) == WAITING
            assert sum(operator.refused.values()) == 3

    asyncio.run(talk())


def test_a_port_that_is_taken_and_other_computers_are_refused() -> None:
    with pytest.raises(ValueError, match="allow_unsigned"):
        UdpOperatorConfig("0.0.0.0:47041")
    UdpOperatorConfig("0.0.0.0:47041", allow_unsigned=True)

    async def twice() -> None:
        port = free_port()
        config = UdpOperatorConfig(f"127.0.0.1:{port}")
        async with UdpOperator(config, Context(Clock())):
            with pytest.raises(LinkError, match="cannot listen"):
                await UdpOperator(config, Context(Clock())).__aenter__()

    asyncio.run(twice())
