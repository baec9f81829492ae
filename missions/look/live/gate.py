"""Lets those watch from other computers who know the token: it stands before the page's server and
before a stream that is on loopback alone.

Whoever connects has some seconds to ask for ``/?token=...``, within a few kB; anything else is
refused with 401. A WebSocket is passed on to the stream as it is, both ways; anything else is the
page's (``web``). On loopback no token is asked for, and pages of others are refused. The page is
served to itself alone: its own origin, under a name of this computer where there is no token.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
from contextlib import suppress
from urllib.parse import parse_qs, urlsplit

from missions.look.live.web import STILL_S, Asked, Web, refusal

LOOPBACK = "127.0.0.1"
TOKEN = "PATH_LIVE_TOKEN"  # the variable of the environment that has it
HEAD_BYTES = 8192
HEAD_S = 15.0
CLIENTS = 16
REQUESTS = 48  # of pages, which end by themselves
UNKNOWN = 64
ORIGINS = frozenset({"app.foxglove.dev"})
"""Hosts whose pages may watch, besides those of this computer: viewers that run in a browser."""
_LOCAL = frozenset({"localhost", "127.0.0.1", "::1"})
REFUSED = b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
_STREAMED = ("/events",)
_PIECE = 1 << 16


class TokenGate:
    """Before ``inner``, a port on loopback, and before the page, if there is one.

    ``refused``: how often somebody was not let in, by why.
    """

    def __init__(
        self,
        token: str,
        inner: int,
        web: Web | None = None,
    ) -> None:
        self._token = token
        self._inner = inner
        self._web = web
        self.refused: dict[str, int] = {}
        self._requests = 0
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
        if self._web is not None and b"upgrade: websocket" not in head.lower():
            await self._ask_page(self._web, head, reader, writer)
            return
        if not is_own_origin(head):
            await self._refuse(writer, "a page of another origin", REFUSED)
        elif self._token and not knows(head, self._token):
            await self._refuse(writer, "without the right token", REFUSED)
        elif self._clients >= CLIENTS:
            await self._refuse(writer, "too many clients", REFUSED)
        else:
            self._clients += 1
            try:
                await self._served(head, reader, writer)
            finally:
                self._clients -= 1

    async def _ask_page(
        self,
        web: Web,
        head: bytes,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        """Pass a request on to the page's server, if it comes from the page itself."""
        try:
            asked = Asked.of(head)
        except ValueError:
            await self._refuse(writer, "no request", refusal("400 Bad Request", "no request"))
            return
        why = self._against(asked)
        if why:
            await self._refuse(writer, why, refusal("401 Unauthorized", f"refused: {why}"))
            return
        streamed = asked.path in _STREAMED
        if (self._clients >= CLIENTS) if streamed else (self._requests >= REQUESTS):
            busy = refusal("503 Service Unavailable", "too many clients")
            await self._refuse(writer, "too many clients", busy)
            return
        self._clients += streamed
        self._requests += not streamed
        try:
            await web.answer(asked, reader, writer, str(writer.get_extra_info("peername")[0]))
        finally:
            self._clients -= streamed
            self._requests -= not streamed

    def _against(self, asked: Asked) -> str:
        """Return why a request for the page is refused; empty when it is not.

        Where there is no token, a page of others could come under a name of its own that leads
        here: only names of this computer are served.
        """
        host = asked.headers.get("host", "")
        origin = asked.headers.get("origin")
        if origin is not None and origin != f"http://{host}":
            return "a page of another origin"
        if not self._token:
            return "" if is_local(host) else "under a name that is not this computer's"
        return (
            "" if is_token(asked.query.get("token", ""), self._token) else "without the right token"
        )

    async def _refuse(
        self,
        writer: asyncio.StreamWriter,
        why: str,
        answer: bytes,
    ) -> None:
        """Refuse a client, and tell of the first, tenth, hundredth and so on."""
        times = self.refused[why] = self.refused.get(why, 0) + 1
        if str(times).strip("0") == "1":
            who = writer.get_extra_info("peername")
            text = f"refused {why}, {times} times by now, the last from {who[0]}"
            logging.warning("%s", text)
            if self._web is not None:
                self._web.tell(text)
        writer.write(answer)
        await asyncio.wait_for(writer.drain(), STILL_S)

    async def _served(
        self,
        head: bytes,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
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
    return is_token(said, token)


def is_token(said: str, token: str) -> bool:
    """Return whether somebody knows the token, in a time that tells nothing of it."""
    return bool(token) and hmac.compare_digest(said.encode(), token.encode())


def is_local(host: str) -> bool:
    """Return whether a ``Host`` names this computer as it names itself."""
    try:
        return urlsplit(f"//{host}").hostname in _LOCAL
    except ValueError:
        return False


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while piece := await reader.read(_PIECE):
            writer.write(piece)
            await writer.drain()
