"""The link between the drones as UDP datagrams, one packet each, signed with a key that only the pair has."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.link.end import LinkContext, LinkEnd, count
from drivers.link.key import key_finding, read_key, signing_time
from drivers.link.wire import UDP_IP_OVERHEAD, Codec
from drivers.rig.part_check import Finding
from path.messages import Message

IPV6_EXTRA = 20  # an IPv6 header is that much longer than an IPv4 one

Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class UdpLinkConfig:
    """Addresses are ``host:port`` with a numeric host (``[host]:port`` for IPv6).

    Attributes:
        bind: own end.
        peer: the other end; datagrams from anywhere else are dropped.
        key_file: 32 bytes, mode 0600; the same on both drones. Without it packets are unsigned, which is refused
            unless both ends are on this computer or ``allow_unsigned`` says so.
        allow_unsigned: fly without a key although the link leaves this computer.
    """

    bind: str
    peer: str
    key_file: Path | None = None
    allow_unsigned: bool = False

    def __post_init__(self) -> None:
        ends = [address_of(self.bind, "bind"), address_of(self.peer, "peer")]
        if ends[0] == ends[1]:
            raise ValueError(f"peer: {self.peer!r} is this end itself")
        if len({":" in host for host, _ in ends}) > 1:
            raise ValueError(f"peer: {self.peer!r} and bind {self.bind!r} must both be IPv4 or both be IPv6")
        local = all(ipaddress.ip_address(host).is_loopback for host, _ in ends)
        if self.key_file is None and not (local or self.allow_unsigned):
            raise ValueError("key_file: a link that leaves this computer needs a key (or allow_unsigned = true)")


def address_of(text: str, name: str) -> Address:
    """``host:port`` with a numeric host. Raises ValueError naming ``name``."""
    host, _, port = text.rpartition(":")
    try:
        address = str(ipaddress.ip_address(host.removeprefix("[").removesuffix("]")))
        number = int(port)
    except ValueError:
        number = 0
        address = ""
    if not 0 < number < 65536:
        raise ValueError(f'{name}: {text!r} is no address, such as "192.168.1.21:47001"')
    return address, number


class UdpLink:
    """Implements ``drivers.interfaces.Link``."""

    Config = UdpLinkConfig

    def __init__(self, config: UdpLinkConfig, context: LinkContext) -> None:
        self._bind, self._peer = address_of(config.bind, "bind"), address_of(config.peer, "peer")
        self._key_file = config.key_file
        self._clock = context.clock
        self._role = context.role
        self._transport: asyncio.DatagramTransport | None = None
        self._end = self._new_end(None)
        self._end.inbox.close()

    @property
    def counters(self) -> LinkCounters:
        return self._end.counters

    async def __aenter__(self) -> Self:
        """Raises LinkError for a key that cannot be used and for a port that cannot be had."""
        end = self._new_end(None if self._key_file is None else read_key(self._key_file))
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: _Socket(self), local_addr=self._bind)
        except OSError as error:
            raise open_error(self._bind, error) from error
        self._end = end
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self._end.inbox.close()
        if self._transport is not None:
            self._transport.abort()
            self._transport = None
            await asyncio.sleep(0)  # the socket is closed in the loop's next turn

    async def examine(self) -> Sequence[Finding]:
        return (key_finding(self._key_file),)

    def send(self, message: Message) -> None:
        """One datagram, now or never: what the network cannot take at once is dropped, not queued."""
        if self._transport is None:
            raise LinkError("the link is not open", "enter it with `async with` first")
        if cast("asyncio.WriteTransport", self._transport).get_write_buffer_size():
            count(self.counters, "network_busy")
            return
        data = self._end.pack(message)
        if data is not None:
            self._transport.sendto(data, self._peer)

    async def receive(self) -> Received:
        return await self._end.inbox.get()

    def on_datagram(self, data: bytes, source: Address) -> None:
        """Called by the socket; never raises."""
        self._end.arrived(data, self._clock.now_ns(), stranger=source != self._peer)

    def on_network_error(self) -> None:
        """The peer's port is closed, or the network is gone: silence is what tells the mission."""
        count(self.counters, "network_error")

    def _new_end(self, key: bytes | None) -> LinkEnd:
        overhead = UDP_IP_OVERHEAD + (IPV6_EXTRA if ":" in self._peer[0] else 0)
        return LinkEnd(Codec(self._role, key, stamp=signing_time), overhead)


class _Socket(asyncio.DatagramProtocol):
    def __init__(self, link: UdpLink) -> None:
        self._link = link

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._link.on_datagram(data, (str(addr[0]), int(addr[1])))

    def error_received(self, exc: Exception) -> None:
        self._link.on_network_error()


def open_error(bind: Address, error: OSError) -> LinkError:
    """What to tell a person about a UDP port that cannot be had."""
    host, port = bind
    if error.errno == errno.EADDRINUSE:
        return LinkError(f"UDP port {port} is in use", "end the other run, or change the port in the rig")
    return LinkError(f"cannot listen on {host}:{port}: {error.strerror}", "is this computer's address right?")
