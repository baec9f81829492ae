"""Lets those watch from other computers who know the token: it stands before a stream that is on loopback alone.

Whoever connects has some seconds to ask for ``/?token=...``, within a few kB; anything else is refused with 401. What
follows is passed on as it is, both ways.
"""

from __future__ import annotations

import asyncio
import hmac
from contextlib import suppress
from urllib.parse import parse_qs, urlsplit

LOOPBACK = "127.0.0.1"
TOKEN = "PATH_LIVE_TOKEN"  # the variable of the environment that has it
HEAD_BYTES, HEAD_S = 8192, 15.0
CLIENTS = 16
REFUSED = b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
_PIECE = 1 << 16


class TokenGate:
    """Before ``inner``, a port on loopback."""

    def __init__(self, token: str, inner: int) -> None:
        self._token, self._inner = token, inner
        self._server: asyncio.Server | None = None
        self._clients = 0

    async def open(self, host: str, port: int) -> int:
        """Listen; returns the port. Raises OSError, ValueError without a token."""
        if not self._token:
            raise ValueError("there is no token")
        self._server = await asyncio.start_server(self._client, host, port, limit=HEAD_BYTES)
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        if self._server is not None:
            self._server.close()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        try:
            if self._clients <= CLIENTS:
                await self._let_in(reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass
        finally:
            self._clients -= 1
            with suppress(OSError):
                writer.close()

    async def _let_in(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
        if not knows(head, self._token):
            writer.write(REFUSED)
            await writer.drain()
            return
        inner_reader, inner_writer = await asyncio.open_connection(LOOPBACK, self._inner)
        inner_writer.write(head)
        ways = [
            asyncio.create_task(_pass_on(reader, inner_writer)),
            asyncio.create_task(_pass_on(inner_reader, writer)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            inner_writer.close()


def knows(head: bytes, token: str) -> bool:
    """True when the request line of an HTTP request has the token."""
    words = head.split(b"\r\n", 1)[0].split(b" ")
    if len(words) != 3 or words[0] != b"GET":
        return False
    try:
        said = parse_qs(urlsplit(words[1].decode("ascii")).query).get("token", [""])[0]
    except ValueError:
        return False
    return bool(token) and hmac.compare_digest(said.encode(), token.encode())


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while piece := await reader.read(_PIECE):
            writer.write(piece)
            await writer.drain()
