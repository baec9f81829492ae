"""A link that loses, delays, duplicates and corrupts: in memory for the sim levels, between sockets for sitl."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, cast

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.rig import PartContext
from drivers.udp_link import UDP_IP_BYTES, Address, Inbox
from drivers.wire import Codec, Drop
from path.messages import Message, Role

CORRUPT_BITS = 3


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """What happens to a packet; shares are 0..1. Jitter alone already reorders.

    Attributes:
        loss: share that never arrives.
        delay_s, jitter_s: every packet is late by the delay and a uniform part of the jitter.
        duplicate: share that arrives twice.
        corrupt: share that arrives with some bits turned over.
    """

    loss: float = 0.0
    delay_s: float = 0.002
    jitter_s: float = 0.002
    duplicate: float = 0.0
    corrupt: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "duplicate", "corrupt"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: {getattr(self, name)!r} is not a share, 0..1")
        if not (self.delay_s >= 0.0 and self.jitter_s >= 0.0):
            raise ValueError("delay_s and jitter_s must not be negative")


class Mangler:
    """Applies faults to packets, by seed, on the running loop's time."""

    def __init__(self, seed: object, faults: LinkFaults | None = None) -> None:
        self.faults = faults or LinkFaults()
        self._random = random.Random(str(seed))

    def carry(self, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Deliver a packet, once, twice, late, damaged or never."""
        faults, chance = self.faults, self._random
        if chance.random() < faults.loss:
            return
        copies = 2 if chance.random() < faults.duplicate else 1
        loop = asyncio.get_running_loop()
        for _ in range(copies):
            packet = self._damaged(data) if chance.random() < faults.corrupt else data
            loop.call_later(faults.delay_s + faults.jitter_s * chance.random(), deliver, packet)

    def _damaged(self, data: bytes) -> bytes:
        damaged = bytearray(data)
        for _ in range(CORRUPT_BITS):
            damaged[self._random.randrange(len(damaged))] ^= 1 << self._random.randrange(8)
        return bytes(damaged)


class MemoryHub:
    """Both ends of the in-memory link, and the faults between them."""

    def __init__(self, seed: int) -> None:
        self._mangler = Mangler(("link", seed))
        self._ends: dict[Role, MemoryLink] = {}
        self._cut: set[Role] = set()

    @property
    def faults(self) -> LinkFaults:
        return self._mangler.faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._mangler.faults = faults

    def join(self, role: Role, end: MemoryLink) -> None:
        self._ends[role] = end

    def leave(self, role: Role) -> None:
        self._ends.pop(role, None)

    def cut(self, role: Role) -> None:
        """From now on nothing comes from or gets to this role: its program is dead."""
        self._cut.add(role)

    def carry(self, role: Role, data: bytes) -> None:
        """Take a packet of one role to the other."""
        peer = Role.RECEIVER if role is Role.SENDER else Role.SENDER
        if role not in self._cut:
            self._mangler.carry(data, lambda packet: self._deliver(peer, packet))

    def _deliver(self, role: Role, data: bytes) -> None:
        end = self._ends.get(role)
        if end is not None and role not in self._cut:
            end.on_packet(data)


class HubHarness(Protocol):
    """What the link needs of ``PartContext.harness``."""

    @property
    def hub(self) -> MemoryHub: ...


@dataclass(frozen=True, slots=True)
class MemoryLinkConfig:
    """Nothing to set: the faults are the harness's."""


class MemoryLink:
    """Implements ``drivers.interfaces.Link`` in one process; packets are encoded and decoded as on the air."""

    Config = MemoryLinkConfig

    def __init__(self, config: MemoryLinkConfig, context: PartContext) -> None:
        del config
        if context.harness is None:
            raise LinkError(
                "an in-memory link needs both roles in one process", "use it with a harness such as hil.sim"
            )
        self._hub = cast("HubHarness", context.harness).hub
        self._role = context.role
        self._clock = context.clock
        self._codec = Codec(context.role, None)
        self._inbox = Inbox()
        self.counters = LinkCounters()

    async def __aenter__(self) -> Self:
        self._hub.join(self._role, self)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self._hub.leave(self._role)

    def send(self, message: Message) -> None:
        data = self._codec.encode(message)
        self.counters.packets_sent += 1
        self.counters.bytes_sent += len(data) + UDP_IP_BYTES
        self._hub.carry(self._role, data)

    async def receive(self) -> Received:
        return await self._inbox.get()

    def on_packet(self, data: bytes) -> None:
        self.counters.packets_received += 1
        self.counters.bytes_received += len(data) + UDP_IP_BYTES
        message = self._codec.decode(data)
        if isinstance(message, Drop):
            self.counters.dropped[message.value] = self.counters.dropped.get(message.value, 0) + 1
            return
        self._inbox.put(Received(message, self._clock.now_ns()))


@dataclass(frozen=True, slots=True)
class ProxySide:
    """One side of the proxy: where it listens, and the one end it talks to."""

    listen: Address
    end: Address


class UdpFaultProxy:
    """Two UDP sockets back to back: what one side's end sends comes out of the other side, with faults."""

    def __init__(self, sender: ProxySide, receiver: ProxySide, seed: int) -> None:
        self._sides = sender, receiver
        self._mangler = Mangler(("proxy", seed), LinkFaults(delay_s=0.0, jitter_s=0.0))
        self._transports: list[asyncio.DatagramTransport] = []

    @property
    def faults(self) -> LinkFaults:
        return self._mangler.faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._mangler.faults = faults

    async def __aenter__(self) -> Self:
        """Raises LinkError naming the port that is in use."""
        loop = asyncio.get_running_loop()
        for side in self._sides:
            forward = _Forward(self, len(self._transports))
            try:
                transport, _ = await loop.create_datagram_endpoint(lambda f=forward: f, local_addr=side.listen)
            except OSError as error:
                self._close()
                port = side.listen[1]
                raise LinkError(f"UDP port {port}: {error.strerror}", "end the other run, or change the rig") from error
            self._transports.append(transport)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self._close()
        await asyncio.sleep(0)

    def forward(self, data: bytes, side: int) -> None:
        """A datagram came in on a side: on to the end of the other."""
        other = 1 - side
        self._mangler.carry(data, lambda packet: self._out(other, packet))

    def _out(self, side: int, data: bytes) -> None:
        if self._transports:
            self._transports[side].sendto(data, self._sides[side].end)

    def _close(self) -> None:
        for transport in self._transports:
            transport.close()
        self._transports = []


class _Forward(asyncio.DatagramProtocol):
    def __init__(self, proxy: UdpFaultProxy, side: int) -> None:
        self._proxy, self._side = proxy, side

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        del addr
        self._proxy.forward(data, self._side)

    def error_received(self, exc: Exception) -> None:
        """An end is not open (yet, or any more): its packets are lost."""
