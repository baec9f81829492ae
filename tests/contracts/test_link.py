"""The contract of every Link: UDP sockets, serial radios, and the in-memory one of the sim levels,
signed and not.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import Link, LinkError
from drivers.link.end import MAX_WAITING
from drivers.link.udp import UdpLink
from hil.link.faulty import LinkFaults, MemoryHub, MemoryLink, ProxySide, UdpFaultProxy
from path.messages import Abort, AbortReason, Accept, Commit, Confirm, Message, Ping, Pong, Role
from tests.drivers.link.link_ends import (
    STATUS,
    TARGET,
    Cable,
    Context,
    WallClock,
    introduce,
    run,
    serial_links,
    until,
)
from tests.free_ports import free_ports

WORDS: list[Message] = [
    Commit(1, 2, 3, 4, 5, 6, 9),
    Commit(1, 2, 3, 4, 5, 7, 9),
    Ping(1, 2),
    Confirm(1, 2, 3, 4, 5, 9),
    Pong(1, 5, 6, 7),
    Accept(1, 2, 3, 4, 5, 9),
    Abort(1, 2, AbortReason.PILOT, 5),
]
GARBAGE = (b"\xfd", b"\xfd\x00garbage", bytes(300), bytes(range(256)))


@dataclass
class Stage:
    """Both ends, closed, and a hand on what is between them."""

    sender: Link
    receiver: Link
    inject: Callable[[bytes], object]  # into what the receiver hears


@asynccontextmanager
async def udp(folder: Path, key: Path | None) -> AsyncGenerator[Stage]:
    del folder
    a, b, c, d = free_ports(4)
    here = ("127.0.0.1", a), ("127.0.0.1", b)
    sides = [ProxySide(("127.0.0.1", port), end) for port, end in zip((c, d), here, strict=True)]
    ends = [
        UdpLink(
            UdpLink.Config(f"127.0.0.1:{port}", f"127.0.0.1:{side.listen[1]}", key),
            Context(role, WallClock()),
        )
        for role, port, side in zip(Role, (a, b), sides, strict=True)
    ]
    async with UdpFaultProxy(sides[0], sides[1], 1) as proxy:
        yield Stage(ends[0], ends[1], lambda data: proxy.inject(data, 1))


@asynccontextmanager
async def radio(folder: Path, key: Path | None) -> AsyncGenerator[Stage]:
    cable = Cable(folder)
    cable.plug()
    sender, receiver = serial_links(cable, key)
    try:
        yield Stage(sender, receiver, cable.inject)
    finally:
        cable.unplug()


@dataclass(frozen=True)
class HubContext(Context):
    harness: Any


@dataclass
class Harness:
    hub: MemoryHub


@asynccontextmanager
async def memory(folder: Path, key: Path | None) -> AsyncGenerator[Stage]:
    del folder
    harness = Harness(MemoryHub(1, LinkFaults()))
    ends = [
        MemoryLink(MemoryLink.Config(key is not None), HubContext(role, WallClock(), harness))
        for role in Role
    ]
    yield Stage(ends[0], ends[1], ends[1].on_packet)


StageOf = Callable[[Path, Path | None], contextlib.AbstractAsyncContextManager[Stage]]
LINKS = pytest.mark.parametrize("stage_of", [udp, radio, memory])
SIGNED = pytest.mark.parametrize("signed", [True, False], ids=["signed", "unsigned"])


def on(stage: contextlib.AbstractAsyncContextManager[Stage], test: Callable[[Stage], Any]) -> None:
    async def main() -> None:
        async with stage as staged:
            await test(staged)

    run(main())


@LINKS
@SIGNED
def test_what_is_sent_arrives_equal_stamped_and_counted(
    stage_of: StageOf, signed: bool, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        clock = WallClock()
        async with stage.sender as sender, stage.receiver as receiver:
            await introduce(sender, receiver)
            for one, other in ((sender, receiver), (receiver, sender)):
                for message in (*WORDS, TARGET, STATUS):
                    sent_ns = clock.now_ns()
                    one.send(message)
                    received = await other.receive()
                    assert received.message == message
                    assert sent_ns <= received.arrival_ns <= clock.now_ns()
            for one, other in ((sender, receiver), (receiver, sender)):
                assert (
                    one.counters.packets_sent == other.counters.packets_received == len(WORDS) + 4
                )
                assert one.counters.bytes_sent == other.counters.bytes_received > 0
                assert one.counters.dropped == {}

    on(stage_of(tmp_path, key_file if signed else None), test)


@LINKS
def test_a_slow_reader_gets_every_word_in_order_and_the_newest_of_each_stream(
    stage_of: StageOf, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.sender as sender, stage.receiver as receiver:
            await introduce(sender, receiver)
            before = receiver.counters.packets_received
            for k, word in enumerate(WORDS):
                for number, message in enumerate(
                    (replace(TARGET, sequence=k), word, replace(STATUS, phase=k)), 1
                ):
                    sender.send(message)
                    await until(
                        lambda number=number, k=k: (
                            receiver.counters.packets_received - before == 3 * k + number
                        )
                    )
            got = [await receiver.receive() for _ in range(len(WORDS) + 2)]
            newest = [
                replace(TARGET, sequence=len(WORDS) - 1),
                replace(STATUS, phase=len(WORDS) - 1),
            ]
            assert [received.message for received in got] == [*WORDS, *newest]
            assert all(
                later.arrival_ns >= earlier.arrival_ns
                for earlier, later in pairwise(got[: len(WORDS)])
            )
            assert receiver.counters.dropped == {"superseded": 2 * len(WORDS) - 2}

    on(stage_of(tmp_path, key_file), test)


@LINKS
def test_words_wait_for_their_reader_up_to_a_number(
    stage_of: StageOf, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.sender as sender, stage.receiver as receiver:
            await introduce(sender, receiver)
            before = receiver.counters.packets_received
            for k in range(MAX_WAITING + 3):
                sender.send(Ping(k, 0))
                await until(lambda k=k: receiver.counters.packets_received - before == k + 1)
            assert receiver.counters.dropped == {"inbox_full": 3}
            assert (await receiver.receive()).message == Ping(3, 0)

    on(stage_of(tmp_path, key_file), test)


@LINKS
@SIGNED
def test_garbage_is_counted_and_costs_no_message_after_it(
    stage_of: StageOf, signed: bool, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.sender as sender, stage.receiver as receiver:
            await introduce(sender, receiver)
            for data in GARBAGE:
                stage.inject(data)
            sender.send(Ping(7, 7))
            assert await heard(receiver, Ping(7, 7))
            assert sum(receiver.counters.dropped.values()) > 0

    on(stage_of(tmp_path, key_file if signed else None), test)


@LINKS
def test_what_does_not_fit_the_wire_is_counted_and_not_sent(
    stage_of: StageOf, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.sender as sender, stage.receiver as receiver:
            await introduce(sender, receiver)
            before = sender.counters.packets_sent
            sender.send(replace(TARGET, point_v_m=(float("nan"), 0.0, 0.0)))
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            assert sender.counters.packets_sent == before + 1
            assert sender.counters.dropped == {"cannot_encode": 1}

    on(stage_of(tmp_path, key_file), test)


@LINKS
def test_before_it_is_open_nothing_is_sent_and_nobody_waits(
    stage_of: StageOf, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        with pytest.raises(LinkError, match="not open"):
            stage.sender.send(TARGET)
        with pytest.raises(LinkError, match=r"not open|closed"):
            await stage.sender.receive()
        assert stage.sender.counters.packets_sent == 0

    on(stage_of(tmp_path, key_file), test)


@LINKS
def test_closing_wakes_the_reader_and_ends_sending_and_twice_is_once(
    stage_of: StageOf, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.receiver:
            async with stage.sender as sender:
                waiting = asyncio.create_task(sender.receive())
                await asyncio.sleep(0)
            with pytest.raises(LinkError, match="closed"):
                await waiting
            with pytest.raises(LinkError, match="closed"):
                await sender.receive()
            sent = sender.counters.packets_sent
            with pytest.raises(LinkError, match="not open"):
                sender.send(TARGET)
            assert sender.counters.packets_sent == sent
            await sender.__aexit__(None, None, None)

    on(stage_of(tmp_path, key_file), test)


@LINKS
@SIGNED
def test_a_peer_that_is_gone_is_silence_and_it_may_come_back(
    stage_of: StageOf, signed: bool, tmp_path: Path, key_file: Path
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.sender as sender:
            for _ in range(3):
                sender.send(TARGET)
                await asyncio.sleep(0)
            for _ in range(2):  # the same object is opened again
                async with stage.receiver as receiver:
                    if signed:  # a new end has to prove itself
                        receiver.send(Ping(1, 5))
                        assert await heard(sender, Ping(1, 5))
                        sender.send(Pong(1, 5, 6, 7))
                        assert await heard(receiver, Pong(1, 5, 6, 7))
                        sender.send(Ping(2, 5))
                        assert await heard(receiver, Ping(2, 5))
                        receiver.send(Pong(2, 5, 6, 7))
                    receiver.send(Accept(1, 2, 3, 4, 5, 9))
                    assert await heard(sender, Accept(1, 2, 3, 4, 5, 9))

    on(stage_of(tmp_path, key_file if signed else None), test)


async def heard(link: Link, message: Message) -> bool:
    """Whatever else comes first."""
    while (await link.receive()).message != message:
        pass
    return True
