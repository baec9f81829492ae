"""The short test of the link: its port and key, and with the other end there its round trips,
losses and clock.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.interfaces import Clock, Link, LinkCounters
from drivers.link.wire import Drop
from drivers.rig.part_check import Finding, examined
from flight.clocks import ClockAlignment, answer
from path.messages import Ping, Pong

EVERY_S = 0.025
MEASURE_S = 2.0
LAST_S = 0.5
LOSSY = 0.05
MOSTLY_LOST = 0.3
SLOW_MS = 100.0
DISTURBED = {
    Drop.BAD_SIGNATURE.value: "copy the same key file to both drones",
    Drop.UNSIGNED.value: "the other end has no key: name `key_file` in its rig too",
    Drop.UNEXPECTED_SIGNATURE.value: "the other end has a key: name `key_file` in this rig too",
    Drop.WRONG_SYSTEM.value: "the other end says that it has this role: one of the two has the wrong one",
    "stranger": "they come from another address than `peer`: correct it, or end who sends them",
    Drop.BAD_CRC.value: "packets are damaged on the way, or the ends have different versions of PATH",
    "noise": "bytes that are no packets: the same `baud` on both ports and radios, and nothing else on the port",
    Drop.UNKNOWN_ID.value: "something else sends to this port, or the ends have different versions of PATH",
}


@dataclass(slots=True)
class PingExchange:
    """Pings of the measured time and their answers. ``alignment`` has had them all."""

    alignment: ClockAlignment = field(default_factory=ClockAlignment)
    sent: set[int] = field(default_factory=set[int])
    trips_ms: dict[int, float] = field(default_factory=dict[int, float])

    @property
    def lost(self) -> float:
        """Share of the pings that no answer came to."""
        return 1.0 - len(self.trips_ms.keys() & self.sent) / max(len(self.sent), 1)


async def check_link(
    link: Link,
    clock: Clock,
    wait_s: float,
) -> AsyncIterator[Finding]:
    """Open, ping, answer pings, close. The other end may be a flight's or another ``doctor``'s,
    started meanwhile.

    Args:
        wait_s: for its first answer.

    Raises LinkError when the link cannot be opened.
    """
    async with link:
        yield Finding("ok", "opens", "its port is free")
        for own in await examined(link):
            yield own
        exchange = await _exchanged(link, clock, wait_s)
        for finding in judged(exchange, link.counters):
            yield finding


async def _exchanged(
    link: Link,
    clock: Clock,
    wait_s: float,
) -> PingExchange:
    exchange = PingExchange()
    met = asyncio.Event()
    listening = asyncio.create_task(_listen(link, clock, exchange, met))
    loop = asyncio.get_running_loop()
    nonce = 0
    try:
        end_s = loop.time() + wait_s
        while not met.is_set() and loop.time() < end_s:
            nonce += 1
            link.send(Ping(nonce, clock.now_ns()))
            await asyncio.sleep(EVERY_S)
        end_s = loop.time() + MEASURE_S
        while met.is_set() and loop.time() < end_s:
            nonce += 1
            exchange.sent.add(nonce)
            link.send(Ping(nonce, clock.now_ns()))
            await asyncio.sleep(EVERY_S)
        if met.is_set():
            await asyncio.sleep(LAST_S)  # for the last answers, and to give the other end its own
    finally:
        listening.cancel()
        failed = (await asyncio.gather(listening, return_exceptions=True))[0]
    if isinstance(failed, Exception):
        raise failed
    return exchange


async def _listen(
    link: Link,
    clock: Clock,
    exchange: PingExchange,
    met: asyncio.Event,
) -> None:
    while True:
        received = await link.receive()
        message = received.message
        arrival_ns = received.arrival_ns
        if isinstance(message, Ping):
            link.send(answer(message, arrival_ns, clock.now_ns()))
        elif isinstance(message, Pong):
            there_ns = message.sent_ns - message.received_ns
            exchange.trips_ms[message.nonce] = (arrival_ns - message.ping_sent_ns - there_ns) * 1e-6
            exchange.alignment.on_pong(message, arrival_ns)
            met.set()


def judged(exchange: PingExchange, counters: LinkCounters) -> Iterator[Finding]:
    yield from _disturbances(counters)
    if not exchange.trips_ms:
        yield _nobody(counters)
        return
    trips_ms = np.array(list(exchange.trips_ms.values()))
    median = float(np.median(trips_ms))
    most = float(trips_ms.max())
    detail = f"{median:.1f} ms median, {most:.1f} ms at most"
    fix = "nearer together, another Wi-Fi channel, or a faster radio"
    yield (
        Finding("note", "round trip", detail, fix)
        if median > SLOW_MS
        else Finding("ok", "round trip", detail)
    )
    lost = exchange.lost
    detail = f"{100.0 * lost:.0f} % of {len(exchange.sent)} pings without an answer"
    if lost > LOSSY:
        yield Finding("fault" if lost > MOSTLY_LOST else "note", "loss", detail, fix)
    else:
        yield Finding("ok", "loss", detail)
    yield _clocks(exchange.alignment)


def _disturbances(counters: LinkCounters) -> Iterator[Finding]:
    for reason, fix in DISTURBED.items():
        if (number := counters.dropped.get(reason, 0)) > 0:
            yield Finding("fault", "packets", f"{number} not taken: {reason}", fix)


def _nobody(counters: LinkCounters) -> Finding:
    received = counters.packets_received
    why = f"{received} packets came, none an answer" if received else "nothing came"
    fix = "run doctor on the other drone at the same time; then round trip, loss and clocks are measured"
    return Finding(
        "note",
        "other end",
        f"nobody answered {counters.packets_sent} pings: {why}",
        fix,
        untested=True,
    )


def _clocks(alignment: ClockAlignment) -> Finding:
    if not alignment.ready:
        said = (
            "a clock was stepped"
            if alignment.fault
            else f"known to {alignment.uncertainty_ns * 1e-6:.0f} ms only"
        )
        return Finding(
            "fault",
            "clocks",
            f"the other drone's clock cannot be used: {said}",
            "a quicker link; then again",
        )
    offset_s = alignment.offset_ns * 1e-9
    known_ms = alignment.uncertainty_ns * 1e-6
    return Finding(
        "ok",
        "clocks",
        f"the other drone's is {offset_s:+.4f} s from this one, known to {known_ms:.2f} ms",
    )
