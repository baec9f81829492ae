"""The live page's server: one file of HTML, what it shows, and what its buttons ask for.

    GET  /          the page
    GET  /events    server-sent events, "now" five times a second and "slow" once, while they change
    GET  /image     the newest image of a drone, ?of=NAME, as JPEG
    POST /act       what the operator asks for (``acts``)

``gate`` has let the client in and read its head. A client is written to as fast as it takes things
and no faster: it is sent what is so when it can take more, and never what was. So one that is slow
sees fewer pictures, one that stands still is left after a while, and nobody waits for either.

Server-sent events over asyncio, and not a WebSocket: every browser has them, they come again by
themselves after a gap, and they need no package that is not there. What the page says is rare, and
goes by POST.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from missions.look.live.alarms import WARNING
from missions.look.live.flight_state import FlightState
from path.values import frozen

NOW_S = 0.2
SLOW_S = 1.0
STILL_S = 20.0  # a client that takes nothing for so long is left
BUFFER_BYTES = 1 << 16  # that wait in this process for one client
ALIVE_S = 2.0  # a page that hears nothing for longer knows that it is cut off
MOST_BODY = 4096
BODY_S = 5.0
PAGE = "page.html"
HEADERS = (
    "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n"
    "Connection: close\r\n"
)
# one file, which nobody may put into a page of theirs: a tap there would be a tap here
PAGE_POLICY = (
    "Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n"
)

Act = Callable[[Mapping[str, Any], str], Awaitable[dict[str, Any]]]


@frozen
class Asked:
    """The head of a request."""

    method: str
    path: str
    query: Mapping[str, str]
    headers: Mapping[str, str]

    @classmethod
    def of(cls, head: bytes) -> Asked:
        """Raises ValueError for what is no request."""
        first, *lines = head.decode("ascii").split("\r\n")
        method, target, _ = first.split(" ")
        parts = urlsplit(target)
        said = {name: values[-1] for name, values in parse_qs(parts.query).items()}
        named = (line.partition(":") for line in lines if ":" in line)
        headers = {name.strip().lower(): value.strip() for name, _, value in named}
        return cls(method, parts.path, said, headers)


class Web:
    """What is served of one flight.

    Args:
        act: carries out what the operator asks for, or says why not.
        can: what the operator may do here, for the page to offer.
        image_of: the newest image of a name: its stamp, and JPEG.
    """

    def __init__(
        self,
        state: FlightState,
        act: Act,
        can: Callable[[], Mapping[str, Any]],
        image_of: Callable[[str], tuple[int, bytes] | None],
    ) -> None:
        self.state = state
        self._act = act
        self._can = can
        self._image_of = image_of
        self.watching = 0
        self._page = files("missions.look.live").joinpath(PAGE).read_bytes()

    def tell(self, text: str) -> None:
        """Say something of the page itself to all who look at it."""
        self.state.alarms.say(self.state.newest_ns, WARNING, "page", text)

    async def answer(
        self,
        asked: Asked,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        who: str,
    ) -> None:
        """Answer one request; the connection ends after it. ``who``: the client, for the log."""
        writer.transport.set_write_buffer_limits(high=BUFFER_BYTES)
        match (asked.method, asked.path):
            case ("GET", "/"):
                await self._send(writer, self._page, "text/html; charset=utf-8", PAGE_POLICY)
            case ("GET", "/events"):
                await self._events(writer)
            case ("GET", "/image"):
                await self._image(writer, asked.query.get("of", ""))
            case ("POST", "/act"):
                await self._asked_to_act(asked, reader, writer, who)
            case _:
                await self._refuse(writer, "404 Not Found", "there is no such page")

    async def _image(self, writer: asyncio.StreamWriter, name: str) -> None:
        image = self._image_of(name)
        if image is None:
            await self._refuse(writer, "404 Not Found", "no image yet")
            return
        utc_ns, jpeg = image
        await self._send(writer, jpeg, "image/jpeg", f"X-Stamp: {utc_ns}\r\n")

    async def _asked_to_act(
        self,
        asked: Asked,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        who: str,
    ) -> None:
        length = asked.headers.get("content-length", "")
        if not length.isdecimal() or int(length) > MOST_BODY:
            await self._refuse(writer, "413 Content Too Large", f"at most {MOST_BODY} bytes")
            return
        body = await asyncio.wait_for(reader.readexactly(int(length)), BODY_S)
        try:
            wanted = msgspec.json.decode(body, type=dict[str, Any])
        except (msgspec.DecodeError, msgspec.ValidationError):
            await self._refuse(writer, "400 Bad Request", "no JSON object")
            return
        answer = await self._act(wanted, who)
        await self._send(writer, msgspec.json.encode(answer), "application/json")

    async def _events(self, writer: asyncio.StreamWriter) -> None:
        """Send what is so, for ever, each time that the client has taken what was sent before."""
        writer.write(
            f"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n{HEADERS}\r\n".encode()
        )
        self.watching += 1
        sent: dict[str, bytes] = {}
        slow_s = said_s = 0.0
        try:
            while True:
                now_s = time.monotonic()
                events = {"now": {**self.state.now(now_s, time.time_ns()), "can": self._can()}}
                if now_s - slow_s >= SLOW_S:
                    slow_s = now_s
                    events["slow"] = self.state.slow()
                for name, what in events.items():
                    data = msgspec.json.encode(what)
                    if sent.get(name) != data or now_s - said_s > ALIVE_S:
                        sent[name] = data
                        said_s = now_s
                        writer.write(b"event: %s\ndata: %s\n\n" % (name.encode(), data))
                await _taken(writer)
                await asyncio.sleep(NOW_S)
        finally:
            self.watching -= 1

    async def _send(
        self,
        writer: asyncio.StreamWriter,
        body: bytes,
        kind: str,
        more: str = "",
    ) -> None:
        head = f"HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
        writer.write(f"{head}{HEADERS}{more}\r\n".encode() + body)
        await _taken(writer)

    async def _refuse(
        self,
        writer: asyncio.StreamWriter,
        status: str,
        why: str,
    ) -> None:
        writer.write(refusal(status, why))
        await _taken(writer)


def refusal(status: str, why: str) -> bytes:
    """Return the answer to a request that is not granted, with the reason for whoever reads it."""
    body = f"{why}\n".encode()
    kind = "Content-Type: text/plain; charset=utf-8\r\n"
    head = f"HTTP/1.1 {status}\r\n{kind}Content-Length: {len(body)}\r\n{HEADERS}\r\n"
    return head.encode() + body


async def _taken(writer: asyncio.StreamWriter) -> None:
    """Wait until the client has taken most of it. Raises TimeoutError for one that stands still,
    whose connection is then gone.
    """
    try:
        await asyncio.wait_for(writer.drain(), STILL_S)
    except TimeoutError:
        with suppress(OSError):
            writer.transport.abort()
        raise
