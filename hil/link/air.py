"""The air between the drones, for a process that listens to it and sends on it what it likes.

One UDP socket on loopback. Whoever sends to it hears every packet from then on, and what it sent
goes to one drone as if the other had sent it. The first byte of a datagram is the side that the
rest is for: 0 the sender, 1 the receiver. With ``MANY`` added to it the rest is many packets, each
behind its length in two bytes.
"""

from __future__ import annotations

import asyncio
from typing import Any, Self

from hil.link.faulty import UdpFaultProxy

MANY = 2


class Air(asyncio.DatagramProtocol):
    """Beside an open proxy. ``port`` is known once it is entered."""

    def __init__(self, proxy: UdpFaultProxy) -> None:
        self._proxy = proxy
        self._transport: asyncio.DatagramTransport | None = None
        self._listener: tuple[Any, ...] | None = None

    @property
    def port(self) -> int:
        assert self._transport is not None, "enter it first"
        return int(self._transport.get_extra_info("sockname")[1])

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, local_addr=("127.0.0.1", 0)
        )
        self._proxy.overheard = self._pass_on
        return self

    async def __aexit__(self, *_: object) -> None:
        self._proxy.overheard = None
        if self._transport is not None:
            self._transport.abort()
            self._transport = None

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._listener = addr
        if len(data) > 1 and data[0] in (0, 1):
            self._proxy.inject(data[1:], data[0])
        elif len(data) > 1 and data[0] - MANY in (0, 1):
            at = 1
            while at < len(data):
                end = at + 2 + int.from_bytes(data[at : at + 2], "little")
                self._proxy.inject(data[at + 2 : end], data[0] - MANY)
                at = end

    def _pass_on(self, data: bytes, side: int) -> None:
        if self._transport is not None and self._listener is not None:
            self._transport.sendto(bytes((side,)) + data, self._listener)
