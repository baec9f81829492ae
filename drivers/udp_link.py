"""The link between the drones as UDP datagrams, one packet each, signed with a key that only the pair has."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import stat
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.rig import PartContext
from drivers.wire import KEY_LENGTH, Codec, Drop
from path.messages import Candidate, Message, Status, Target

UDP_IP_BYTES = 28
MAX_WAITING = 256
SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, the zero of MAVLink signing time

Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class UdpLinkConfig:
    """Addresses are ``host:port``.

    Attributes:
        bind: own end.
        peer: the other end; datagrams from anywhere else are dropped.
        key_file: 32 bytes, readable by the owner alone; the same file on both drones.
        allow_unsigned: fly without a key although the link leaves this computer.
    """

    bind: str
    peer: str
    key_file: Path | None = None
    allow_unsigned: bool = False

    def __post_init__(self) -> None:
        ends = [address_of(self.bind, "bind"), address_of(self.peer, "peer")]
        local = all(ipaddress.ip_address(host).is_loopback for host, _ in ends)
        if self.key_file is None and not (local or self.allow_unsigned):
            raise ValueError("key_file: a link that leaves this computer needs a key (or allow_unsigned = true)")


def address_of(text: str, name: str) -> Address:
    """``host:port`` with a numeric host. Raises ValueError naming ``name``."""
    host, _, port = text.rpartition(":")
    try:
        return str(ipaddress.ip_address(host)), _port(port)
    except ValueError:
        raise ValueError(f'{name}: {text!r} is no address, such as "192.168.1.21:47001"') from None


def _port(text: str) -> int:
    port = int(text)
    if not 0 < port < 65536:
        raise ValueError
    return port


def read_key(path: Path) -> bytes:
    """The pair's key. Raises LinkError for a file others can read, or of another length."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        key = path.read_bytes()
    except OSError as error:
        raise LinkError(f"key file {path}: {error.strerror}", "copy the pair's key there, on both drones") from error
    if mode & 0o077:
        raise LinkError(f"key file {path} has mode {mode:04o}: others can read it", f"chmod 600 {path}")
    if len(key) != KEY_LENGTH:
        make = f"head -c {KEY_LENGTH} /dev/urandom > {path}; copy it to the other drone"
        raise LinkError(f"key file {path} has {len(key)} bytes instead of {KEY_LENGTH}", make)
    return key


class Inbox:
    """Messages that wait for their reader: the newest one of each stream, every one of the hand-over.

    A Target, Candidate or Status that waits is replaced by a newer one, so that a slow reader sees the present and
    nothing piles up.
    """

    def __init__(self) -> None:
        self._waiting: deque[Received] = deque()
        self._reader: asyncio.Future[None] | None = None
        self.replaced = 0

    def put(self, received: Received) -> None:
        kind = type(received.message)
        if kind in (Target, Candidate, Status):
            for i, other in enumerate(self._waiting):
                if type(other.message) is kind:
                    del self._waiting[i]
                    self.replaced += 1
                    break
        if len(self._waiting) >= MAX_WAITING:
            self._waiting.popleft()
            self.replaced += 1
        self._waiting.append(received)
        if self._reader is not None and not self._reader.done():
            self._reader.set_result(None)

    async def get(self) -> Received:
        while not self._waiting:
            self._reader = asyncio.get_running_loop().create_future()
            await self._reader
        return self._waiting.popleft()


class UdpLink:
    """Implements ``drivers.interfaces.Link``."""

    Config = UdpLinkConfig

    def __init__(self, config: UdpLinkConfig, context: PartContext) -> None:
        self._bind, self._peer = address_of(config.bind, "bind"), address_of(config.peer, "peer")
        self._key_file = config.key_file
        self._clock = context.clock
        self._role = context.role
        self._inbox = Inbox()
        self._codec: Codec | None = None
        self._transport: asyncio.DatagramTransport | None = None
        self.counters = LinkCounters()

    async def __aenter__(self) -> Self:
        key = None if self._key_file is None else read_key(self._key_file)
        self._codec = Codec(self._role, key, stamp=_signing_time)
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: _Receiver(self), local_addr=self._bind)
        except OSError as error:
            host, port = self._bind
            if error.errno == errno.EADDRINUSE:
                raise LinkError(f"UDP port {port} is in use", "end the other run, or change bind in the rig") from error
            raise LinkError(
                f"cannot listen on {host}:{port}: {error.strerror}", "is this computer's address right?"
            ) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None
            await asyncio.sleep(0)  # the socket is closed in the loop's next turn

    def send(self, message: Message) -> None:
        """One datagram. A network that cannot take it loses it, as it may lose any."""
        if self._transport is None or self._codec is None:
            raise LinkError("the link is not open", "enter it with `async with` first")
        data = self._codec.encode(message)
        self._transport.sendto(data, self._peer)
        self.counters.packets_sent += 1
        self.counters.bytes_sent += len(data) + UDP_IP_BYTES

    async def receive(self) -> Received:
        return await self._inbox.get()

    def on_datagram(self, data: bytes, sender: Address) -> None:
        """Called by the socket; never raises."""
        arrival_ns = self._clock.now_ns()
        self.counters.packets_received += 1
        self.counters.bytes_received += len(data) + UDP_IP_BYTES
        if sender[:2] != self._peer:
            self._drop("stranger")
            return
        assert self._codec is not None
        message = self._codec.decode(data)
        if isinstance(message, Drop):
            self._drop(message.value)
            return
        self._inbox.put(Received(message, arrival_ns))

    def _drop(self, reason: str) -> None:
        self.counters.dropped[reason] = self.counters.dropped.get(reason, 0) + 1


class _Receiver(asyncio.DatagramProtocol):
    def __init__(self, link: UdpLink) -> None:
        self._link = link

    def datagram_received(self, data: bytes, addr: tuple[str | object, int]) -> None:
        self._link.on_datagram(data, (str(addr[0]), addr[1]))

    def error_received(self, exc: Exception) -> None:
        """The peer's port is closed, or the network is gone: silence is what tells the mission."""


def _signing_time() -> int:
    """Units of 10 us of wall time, so that a restarted role never goes back."""
    return int((time.time() - SIGNING_EPOCH_S) * 1e5)
