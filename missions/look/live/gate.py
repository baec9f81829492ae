"""Lets those watch from other computers who know the token: it stands before a stream that is on
loopback alone.

Whoever connects has some seconds to ask for ``/?token=...``, within a few kB; anything else is
refused with 401. What follows is passed on as it is, both ways. On loopback no token is asked for,
and pages of others are refused.
"""

from __future__ import annotations

import asyncio
import hmac
from contextlib import suppress
from urllib.parse import parse_qs, urlsplit

LOOPBACK = "127.0.0.1"
TOKEN = "PATH_LIVE_TOKEN"  # the variable of the environment that has it
HEAD_BYTES = 8192
HEAD_S = 15.0
CLIENTS = 16
UNKNOWN = 64
ORIGINS = frozenset({"app.foxglove.dev"})
"""Hosts whose pages may watch, besides those of this computer: viewers that run in a browser."""
_LOCAL = frozenset({"localhost", "127.0.0.1", "::1"})
REFUSED = b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
_PIECE = 1 << 16


class TokenGate:
    """Before ``inner``, a port on loopback."""

    def __init__(self, token: str, inner: int) -> None:
        self._token = token
        self._inner = inner
        self._server: asyncio.Server | None = None
        self._clients = 0
        # who has not asked for anything yet, the oldest first
        self._unknown: list[asyncio.StreamWriter] = []

    async def open(self, host: str, port: int) -> int:
        """Listen; returns the port. Raises OSError, ValueError for another host than this one
        without a token.
        """
        if not self._token and host != LOOPBACK:
            raise ValueError("there is no token")
        self._server = await asyncio.start_server(self._client, host, port, limit=HEAD_BYTES)
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        if self._server is not None:
            self._server.close()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection. At the end of the program it is cancelled, of which nobody needs to
        be told.
        """
        self._make_room()
        self._unknown.append(writer)
        try:
            await self._let_in(reader, writer)
        except (
            OSError,
            asyncio.IncompleteReadError,
            asyncio.LimitOverrunError,
            TimeoutError,
            asyncio.CancelledError,
        ):
            pass
        finally:
            self._known(writer)
            with suppress(OSError):
                writer.close()

    def _make_room(self) -> None:
        """Of those who have not said who they are, the one who has kept silent for the longest
        makes way.

        So nobody can keep a client that knows the token out by connecting and saying nothing.
        """
        while len(self._unknown) >= UNKNOWN:
            with suppress(OSError):
                self._unknown.pop(0).transport.abort()

    def _known(self, writer: asyncio.StreamWriter) -> None:
        if writer in self._unknown:
            self._unknown.remove(writer)

    async def _let_in(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
        self._known(writer)
        if (
            not (is_own_origin(head) and (not self._token or knows(head, self._token)))
            or self._clients >= CLIENTS
        ):
            writer.write(REFUSED)
            await writer.drain()
            return
        self._clients += 1
        try:
            await self._served(head, reader, writer)
        finally:
            self._clients -= 1

    async def _served(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
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


def is_own_origin(head: bytes) -> bool:
    """Return whether a request comes from a program, or from a page that may watch.

    A browser sends the page's Origin along, and asks nobody whether that page may connect to this
    computer: so any page that is open in it could read a flight.
    """
    said = [
        line.partition(b":")[2].strip()
        for line in head.split(b"\r\n")[1:]
        if line.lower().startswith(b"origin:")
    ]
    for origin in said:
        try:
            parts = urlsplit(origin.decode("ascii"))
            host = parts.hostname
        except ValueError:
            return False
        # a desktop viewer has a scheme of its own; "null" has none
        web = parts.scheme in ("http", "https", "")
        if web and host not in _LOCAL and not (parts.scheme == "https" and host in ORIGINS):
            return False
    return True


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
