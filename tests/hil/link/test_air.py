"""The air between the drones: whoever is on it hears both, and is taken for either."""

from __future__ import annotations

import asyncio
import socket

from hil.link.air import Air
from hil.link.faulty import ProxySide, UdpFaultProxy
from tests.free_ports import free_ports


def udp() -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind(("127.0.0.1", 0))
    end.setblocking(False)
    return end


def test_packets_are_overheard_and_sent_with_the_peer_s_address() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        with udp() as sender, udp() as receiver, udp() as stranger:
            listens = tuple(("127.0.0.1", port) for port in free_ports(2))
            sides = (
                ProxySide(listens[0], sender.getsockname()),
                ProxySide(listens[1], receiver.getsockname()),
            )
            async with (
                UdpFaultProxy(*sides, seed=1) as proxy,
                Air(proxy) as air,
                asyncio.timeout(60.0),
            ):
                where = ("127.0.0.1", air.port)
                await loop.sock_sendto(sender, b"before", listens[0])
                assert await loop.sock_recv(receiver, 100) == b"before"
                await loop.sock_sendto(stranger, b"\1forged", where)
                data, source = await loop.sock_recvfrom(receiver, 100)
                # as if the proxy, so the peer, had sent it
                assert (data, source) == (b"forged", listens[1])
                await loop.sock_sendto(sender, b"true", listens[0])
                assert await loop.sock_recv(stranger, 100) == b"\1true"
                await loop.sock_sendto(stranger, b"", where)
                await loop.sock_sendto(stranger, b"\7x", where)  # no such side
                await loop.sock_sendto(stranger, b"\0back", where)
                assert await loop.sock_recvfrom(sender, 100) == (b"back", listens[0])

    asyncio.run(main())
