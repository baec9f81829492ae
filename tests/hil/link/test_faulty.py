from __future__ import annotations

import asyncio
import socket
from collections.abc import Coroutine
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import Link, LinkError, Received
from drivers.link.udp import UdpLink
from hil.harness.virtual_time import run_virtual
from hil.link.faulty import (
    FaultyChannel,
    LinkFaults,
    MemoryHub,
    MemoryLink,
    ProxySide,
    UdpFaultProxy,
)
from path.messages import Accept, Ping, Role
from tests.drivers.link.link_ends import TARGET, introduce
from tests.free_ports import free_port, free_ports

CLEAN = LinkFaults()
LOOPBACK = "127.0.0.1"


@dataclass
class LoopClock:
    offset_ns: int = 0

    def now_ns(self) -> int:
        return self.offset_ns + round(asyncio.get_running_loop().time() * 1e9)


@dataclass(frozen=True)
class Harness:
    hub: MemoryHub


@dataclass(frozen=True)
class Context:
    role: Role
    clock: LoopClock
    harness: Harness | None = None


def memory_pair(hub: MemoryHub, signed: bool = True) -> tuple[MemoryLink, MemoryLink]:
    harness, config = Harness(hub), MemoryLink.Config(signed)
    sender = MemoryLink(config, Context(Role.SENDER, LoopClock(), harness))
    receiver = MemoryLink(config, Context(Role.RECEIVER, LoopClock(5 * 10**9), harness))
    return sender, receiver


async def collect(link: Link, into: list[Received]) -> None:
    while True:
        into.append(await link.receive())


async def talk(
    faults: LinkFaults, seed: int = 1, messages: int = 400
) -> tuple[list[Received], dict[str, int]]:
    """Pings at 100 Hz through the in-memory link: what came out, and what was dropped."""
    hub = MemoryHub(seed, CLEAN)
    sender, receiver = memory_pair(hub)
    got: list[Received] = []
    async with sender, receiver:
        await introduce(sender, receiver)
        hub.faults = faults
        reader = asyncio.create_task(collect(receiver, got))
        for k in range(messages):
            sender.send(Ping(k, 0))
            await asyncio.sleep(0.01)
        await asyncio.sleep(1.0)
        reader.cancel()
        return got, dict(receiver.counters.dropped)


def nonces(got: list[Received]) -> list[int]:
    return [received.message.nonce for received in got if isinstance(received.message, Ping)]


@pytest.mark.parametrize("signed", [True, False])
def test_messages_cross_both_ways_late_and_on_the_readers_clock(signed: bool) -> None:
    async def test() -> None:
        hub = MemoryHub(1, CLEAN)
        sender, receiver = memory_pair(hub, signed)
        async with sender, receiver:
            await introduce(sender, receiver)
            hub.faults = LinkFaults(delay_s=0.25)
            before, begin_s = sender.counters.bytes_sent, asyncio.get_running_loop().time()
            sender.send(TARGET)
            received = await receiver.receive()
            assert received.message == TARGET
            assert received.arrival_ns == pytest.approx(5.25e9 + begin_s * 1e9, abs=1e4)
            receiver.send(Accept(1, 2, 3, 4, 5, 9))
            assert (await sender.receive()).message == Accept(1, 2, 3, 4, 5, 9)
            assert sender.counters.bytes_sent == receiver.counters.bytes_received
            assert sender.counters.bytes_sent - before == 28 + 12 + 28 + 13 * signed

    run_virtual(test())


def test_a_clean_link_loses_and_swaps_nothing() -> None:
    got, dropped = run_virtual(talk(CLEAN))
    assert nonces(got) == list(range(400)) and dropped == {}


def test_jitter_keeps_the_order() -> None:
    got, dropped = run_virtual(talk(LinkFaults(delay_s=0.01, jitter_s=0.2)))
    assert nonces(got) == list(range(400)) and dropped == {}


def test_the_share_that_is_lost() -> None:
    got, dropped = run_virtual(talk(LinkFaults(loss=0.3)))
    assert 0.6 < len(got) / 400 < 0.8 and dropped == {}


def test_duplicates_are_seen_by_the_signature() -> None:
    got, dropped = run_virtual(talk(LinkFaults(duplicate=0.3)))
    assert nonces(got) == list(range(400))
    assert set(dropped) == {"replayed"} and 0.2 < dropped["replayed"] / 400 < 0.4


def test_what_was_overtaken_is_refused_by_the_signature() -> None:
    got, dropped = run_virtual(talk(LinkFaults(reorder=0.2)))
    order = nonces(got)
    assert order == sorted(order)
    assert set(dropped) == {"replayed"} and len(got) + dropped["replayed"] == 400


def test_damage_never_passes_for_a_message() -> None:
    got, dropped = run_virtual(talk(LinkFaults(corrupt=0.5)))
    assert [received.message for received in got] == [Ping(nonce, 0) for nonce in nonces(got)]
    assert len(got) + sum(dropped.values()) == 400 and len(got) < 280
    assert {"bad_crc", "truncated"} <= set(dropped)


def test_the_same_seed_gives_the_same_history() -> None:
    faults = LinkFaults(
        loss=0.2, delay_s=0.01, jitter_s=0.03, duplicate=0.2, corrupt=0.2, reorder=0.2
    )
    first, again, other = (run_virtual(talk(faults, seed)) for seed in (7, 7, 8))
    assert first == again
    assert first != other


def test_faults_may_change_and_a_role_may_fall_silent() -> None:
    async def test() -> None:
        hub = MemoryHub(1, CLEAN)
        sender, receiver = memory_pair(hub)
        async with sender, receiver:
            await introduce(sender, receiver)
            sent = sender.counters.packets_sent
            hub.faults = replace(hub.faults, loss=1.0)
            sender.send(TARGET)
            receiver.send(Accept(1, 2, 3, 4, 5, 9))
            await asyncio.sleep(1.0)
            assert receiver.counters.packets_received == sender.counters.packets_received == sent
            hub.faults = CLEAN
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            receiver.send(Accept(1, 2, 3, 4, 5, 9))  # under way when its program dies
            hub.cut(Role.RECEIVER)
            sender.send(TARGET)
            receiver.send(Accept(1, 2, 3, 4, 6, 9))
            await asyncio.sleep(1.0)
            assert (
                receiver.counters.packets_received == sender.counters.packets_received == sent + 1
            )

    run_virtual(test())


def test_the_link_needs_a_harness_and_one_end_for_each_role() -> None:
    with pytest.raises(LinkError, match="same process"):
        MemoryLink(MemoryLink.Config(), Context(Role.SENDER, LoopClock()))

    async def test() -> None:
        hub = MemoryHub(1)
        sender, _ = memory_pair(hub)
        again, _ = memory_pair(hub)
        async with sender:
            with pytest.raises(LinkError, match="in use"):
                await again.__aenter__()
        with pytest.raises(LinkError, match="closed"):
            await sender.receive()
        async with again:
            pass

    run_virtual(test())


@pytest.mark.parametrize(
    "changes",
    [
        {"loss": 1.1},
        {"reorder": -0.1},
        {"corrupt": float("nan")},
        {"delay_s": -1.0},
        {"jitter_s": float("inf")},
    ],
)
def test_faults_that_cannot_be_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(changes))):
        LinkFaults(**changes)


@given(
    data=st.binary(min_size=1, max_size=120),
    seed=st.integers(0, 1000),
    delay=st.floats(0.0, 1.0),
    jitter=st.floats(0.0, 1.0),
)
def test_no_packet_is_early_or_later_than_the_faults_allow(
    data: bytes, seed: int, delay: float, jitter: float
) -> None:
    channel = FaultyChannel(str(seed), LinkFaults(0.1, delay, jitter, 0.3, 0.3, 0.3))
    for k in range(20):
        for at_s, packet in channel.arrivals(data, float(k)):
            assert k + delay <= at_s <= k + delay + jitter + 0.03 + 1e-3
            assert len(packet) <= len(data)


@dataclass(frozen=True)
class UdpContext:
    role: Role
    clock: LoopClock


class CountingProxy(UdpFaultProxy):
    seen = 0

    def forward(self, data: bytes, side: int, source: tuple[str, int]) -> None:
        super().forward(data, side, source)
        self.seen += 1


def through_proxy() -> tuple[CountingProxy, UdpLink, UdpLink]:
    a, b, to_b, to_a = ((LOOPBACK, port) for port in free_ports(4))
    named = {end: f"{end[0]}:{end[1]}" for end in (a, b, to_b, to_a)}
    sender = UdpLink(UdpLink.Config(named[a], named[to_b]), UdpContext(Role.SENDER, LoopClock()))
    receiver = UdpLink(
        UdpLink.Config(named[b], named[to_a]), UdpContext(Role.RECEIVER, LoopClock())
    )
    return CountingProxy(ProxySide(to_b, a), ProxySide(to_a, b), seed=1), sender, receiver


def run(test: Coroutine[Any, Any, None]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(60.0):
            await test

    asyncio.run(bounded())


async def until(condition: Any) -> None:
    while not condition():  # noqa: ASYNC110 (what is waited for is a counter)
        await asyncio.sleep(0.001)


def test_the_proxy_passes_both_ways_and_its_faults_change_while_it_runs() -> None:
    async def test() -> None:
        proxy, sender, receiver = through_proxy()
        async with proxy, sender, receiver:
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            receiver.send(Accept(1, 2, 3, 4, 5, 9))
            assert (await sender.receive()).message == Accept(1, 2, 3, 4, 5, 9)
            proxy.faults = LinkFaults(duplicate=1.0)
            sender.send(Ping(1, 0))
            assert [(await receiver.receive()).message for _ in range(2)] == [Ping(1, 0)] * 2
            proxy.faults = LinkFaults(loss=1.0)
            sender.send(Ping(2, 0))
            await until(lambda: proxy.seen == 4)
            proxy.faults = LinkFaults()
            sender.send(Ping(3, 0))
            assert (await receiver.receive()).message == Ping(3, 0)
            assert receiver.counters.packets_received == 4

    run(test())


def test_the_proxy_delays() -> None:
    async def test() -> None:
        proxy, sender, receiver = through_proxy()
        proxy.faults = LinkFaults(delay_s=0.05)
        async with proxy, sender, receiver:
            start_ns = LoopClock().now_ns()
            sender.send(TARGET)
            assert (await receiver.receive()).arrival_ns - start_ns >= 49_000_000

    run(test())


def test_the_proxy_ignores_strangers_and_names_a_used_port() -> None:
    async def test() -> None:
        proxy, sender, receiver = through_proxy()
        listen = proxy._sides[0].listen
        async with proxy, sender, receiver:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"anything", listen)
            sender.send(TARGET)
            assert (await receiver.receive()).message == TARGET
            await until(lambda: proxy.seen == 2)
            assert receiver.counters.packets_received == 1
            second = UdpFaultProxy(
                ProxySide((LOOPBACK, free_port()), ("127.0.0.1", 1)), proxy._sides[0], seed=1
            )
            with pytest.raises(LinkError, match=f"{listen[1]} is in use"):
                await second.__aenter__()
            assert second._transports == []

    run(test())
