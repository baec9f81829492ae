"""The link between the drones as UDP datagrams, one packet each, signed with a key that only the
pair has.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.link.end import LinkContext, LinkEnd, count
from drivers.link.key import key_finding, signing_key, signing_time
from drivers.link.wire import UDP_IP_OVERHEAD, Codec
from drivers.rig.part_check import Finding
from path.messages import Message
from path.values import frozen

IPV6_EXTRA = 20  # an IPv6 header is that much longer than an IPv4 one
# datagrams in one turn of the event loop: whatever comes in, the rest of the program has its turn
READ_AT_ONCE = 256
MOST_BYTES = 512  # of a datagram: what is longer is none of ours, and is cut
WAITING_BYTES = 1 << 20  # what the kernel keeps while this program is busy, if it may

Address = tuple[str, int]


@frozen
class UdpLinkConfig:
    """Addresses are ``host:port`` with a numeric host (``[host]:port`` for IPv6).

    Attributes:
        bind: own end.
        peer: the other end; datagrams from anywhere else are dropped.
        key_file: 32 bytes, mode 0600; the same on both drones. Without it packets are unsigned,
            which is refused unless both ends are on this computer or ``allow_unsigned`` says so.
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
            raise ValueError(
                f"peer: {self.peer!r} and bind {self.bind!r} must both be IPv4 or both be IPv6"
            )
        local = all(ipaddress.ip_address(host).is_loopback for host, _ in ends)
        if self.key_file is None and not (local or self.allow_unsigned):
            raise ValueError(
                "key_file: a link that leaves this computer needs a key (or allow_unsigned = true)"
            )


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
        self._socket: socket.socket | None = None
        self._end = self._new_end(None)
        self._end.inbox.close()

    @property
    def counters(self) -> LinkCounters:
        return self._end.counters

    async def __aenter__(self) -> Self:
        """Raise LinkError for a key that cannot be used and for a port that cannot be had."""
        end = self._new_end(signing_key(self._key_file))
        family = socket.AF_INET6 if ":" in self._bind[0] else socket.AF_INET
        opened = socket.socket(family, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, WAITING_BYTES)
            opened.bind(self._bind)
        except OSError as error:
            opened.close()
            raise open_error(self._bind, error) from error
        asyncio.get_running_loop().add_reader(opened, self._readable, opened)
        self._socket = opened
        self._end = end
        return self

    async def __aexit__(self, *_: object) -> None:
        self._end.inbox.close()
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None

    async def examine(self) -> Sequence[Finding]:
        return (key_finding(self._key_file),)

    def send(self, message: Message) -> None:
        """One datagram, now or never: what the network cannot take at once is dropped, not
        queued.
        """
        if self._socket is None:
            raise LinkError("the link is not open", "enter it with `async with` first")
        data = self._end.pack(message)
        if data is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except BlockingIOError:
            count(self.counters, "network_busy")
        except OSError:  # the network is gone: silence is what tells the mission
            count(self.counters, "network_error")

    async def receive(self) -> Received:
        return await self._end.inbox.get()

    def _readable(self, opened: socket.socket) -> None:
        """All that came in, or a good part of it. Never raises."""
        for _ in range(READ_AT_ONCE):
            try:
                data, source = opened.recvfrom(MOST_BYTES)
            except BlockingIOError:
                return
            except OSError:  # the peer's port is closed
                count(self.counters, "network_error")
                return
            self._end.arrived(data, self._clock.now_ns(), stranger=source[:2] != self._peer)

    def _new_end(self, key: bytes | None) -> LinkEnd:
        overhead = UDP_IP_OVERHEAD + (IPV6_EXTRA if ":" in self._peer[0] else 0)
        return LinkEnd(Codec(self._role, key, stamp=signing_time), overhead)


def open_error(bind: Address, error: OSError) -> LinkError:
    """Return the error for a person when a UDP port cannot be had."""
    host, port = bind
    if error.errno == errno.EADDRINUSE:
        return LinkError(
            f"UDP port {port} is in use", "end the other run, or change the port in the rig"
        )
    return LinkError(
        f"cannot listen on {host}:{port}: {error.strerror}", "is this computer's address right?"
    )
