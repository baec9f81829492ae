"""The live page's server: who is served, and that nobody who is slow, silent or hostile costs
anybody anything.
"""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import pytest

from missions.look.live import web as web_module
from missions.look.live.drone import Drone
from missions.look.live.flight_state import FlightState
from missions.look.live.gate import LOOPBACK, UNKNOWN, TokenGate
from missions.look.live.web import MOST_BODY, Web

TOKEN = "0123456789abcdef"
Body = Callable[["Served"], Coroutine[Any, Any, None]]


class Served:
    """A page of a flight, and all that was asked of it."""

    def __init__(self, token: str) -> None:
        self.state = FlightState()
        self.state.drones["sender"] = Drone("sender")
        self.state.drones["sender"].image = (123_456_789, b"\xff\xd8 a picture")
        self.acts: list[Mapping[str, Any]] = []
        web = Web(self.state, self._act, dict, self.state.image_of)
        self.gate = TokenGate(token, 1, web)
        self.port = 0

    async def _act(self, wanted: Mapping[str, Any], who: str) -> dict[str, Any]:
        self.acts.append(wanted)
        return {"done": who}

    async def open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection(LOOPBACK, self.port, limit=1 << 22)

    async def ask(self, request: str, body: bytes = b"", host: str = LOOPBACK) -> bytes:
        """Return the whole answer to a request; its first line has no version."""
        reader, writer = await self.open()
        length = f"Content-Length: {len(body)}\r\n" if body else ""
        head, _, more = request.partition("\n")
        extra = f"{more}\r\n" if more else ""
        text = f"{head} HTTP/1.1\r\nHost: {host}:{self.port}\r\n{length}{extra}\r\n"
        answer = b""
        try:
            writer.write(text.encode() + body)
            answer = await asyncio.wait_for(reader.read(), 30.0)
        except ConnectionError:
            pass  # it was left while it still sent
        writer.close()
        return answer

    async def events(self, count: int) -> list[dict[str, Any]]:
        """Return the first pictures of the flight that a client is sent."""
        reader, writer = await self.open()
        writer.write(f"GET /events HTTP/1.1\r\nHost: {LOOPBACK}\r\n\r\n".encode())
        found: list[dict[str, Any]] = []
        while len(found) < count:
            line = await asyncio.wait_for(reader.readline(), 30.0)
            if line.startswith(b"data: "):
                found.append(json.loads(line[6:]))
        writer.close()
        return found


def served(body: Body, token: str = "") -> Served:
    page = Served(token)

    async def main() -> None:
        page.port = await page.gate.open(LOOPBACK, 0)
        try:
            await body(page)
        finally:
            page.gate.close()

    asyncio.run(main())
    return page


async def until(true: Callable[[], bool]) -> None:
    for _ in range(600):
        if true():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("it did not come true")


def test_the_page_is_one_file_that_asks_nobody_else_for_anything() -> None:
    async def body(page: Served) -> None:
        answer = await page.ask("GET /")
        assert answer.startswith(b"HTTP/1.1 200 OK")
        assert b"frame-ancestors 'none'" in answer
        assert b"default-src 'none'" in answer
        _, _, html = answer.partition(b"\r\n\r\n")
        assert b"http://" not in html and b"https://" not in html

    served(body)


def test_an_image_comes_with_its_stamp() -> None:
    async def body(page: Served) -> None:
        answer = await page.ask("GET /image?of=sender")
        assert answer.endswith(b"\xff\xd8 a picture")
        assert b"X-Stamp: 123456789\r\n" in answer
        assert b" 404 " in await page.ask("GET /image?of=nobody")
        assert b" 404 " in await page.ask("GET /../../etc/passwd")

    served(body)


@pytest.mark.parametrize(
    ("request_text", "host", "why"),
    [
        ("GET /", "evil.example", "under a name that is not this computer's"),
        ("GET /events", "127.0.0.1.evil.example", "under a name that is not this computer's"),
        ("GET /image?of=sender", "[", "under a name that is not this computer's"),
        ("POST /act\nOrigin: https://evil.example", LOOPBACK, "a page of another origin"),
        ("POST /act\nOrigin: http://127.0.0.1:1", LOOPBACK, "a page of another origin"),
        ("POST /act\nOrigin: https://app.foxglove.dev", LOOPBACK, "a page of another origin"),
        ("POST /act\nOrigin: null", LOOPBACK, "a page of another origin"),
    ],
)
def test_pages_of_others_are_refused_and_told(request_text: str, host: str, why: str) -> None:
    async def body(page: Served) -> None:
        answer = await page.ask(request_text, b"{}", host)
        assert answer.startswith(b"HTTP/1.1 401")
        assert page.gate.refused == {why: 1}

    page = served(body)
    assert page.acts == []
    [event] = page.state.alarms.newest()
    assert (event["level"], event["of"]) == ("warning", "page")
    assert why in event["text"]


@pytest.mark.parametrize("token", ["", "wrong", TOKEN[:-1] + "e", "%ff"])
def test_nobody_without_the_token_sees_or_does_anything_where_there_is_one(token: str) -> None:
    async def body(page: Served) -> None:
        for wanted in ("GET /", "GET /events", "GET /image", "POST /act"):
            path = f"{wanted}?token={token}"
            assert (await page.ask(path, b"{}")).startswith(b"HTTP/1.1 401")

    page = served(body, TOKEN)
    assert page.acts == []
    assert page.gate.refused == {"without the right token": 4}
    assert len(page.state.alarms.newest()) == 1  # of a hundred more it would be two


def test_its_own_page_is_served_and_acts_with_the_token() -> None:
    async def body(page: Served) -> None:
        own = f"POST /act?token={TOKEN}\nOrigin: http://{LOOPBACK}:{page.port}"
        answer = await page.ask(own, b'{"act": "stop"}')
        assert json.loads(answer.partition(b"\r\n\r\n")[2]) == {"done": LOOPBACK}

    assert served(body, TOKEN).acts == [{"act": "stop"}]


@pytest.mark.parametrize(
    ("body_bytes", "status"),
    [(b"x" * 1_000_000, b" 413 "), (b"[1]", b" 400 "), (b"{", b" 400 "), (b"\xff", b" 400 ")],
)
def test_a_message_of_a_megabyte_or_no_json_does_nothing(body_bytes: bytes, status: bytes) -> None:
    async def body(page: Served) -> None:
        answer = await page.ask("POST /act", body_bytes)
        assert status in answer.split(b"\r\n")[0] or len(body_bytes) > MOST_BODY
        assert (await page.ask("GET /")).startswith(b"HTTP/1.1 200")

    assert served(body).acts == []


def test_a_head_without_end_and_fifty_silent_clients_keep_nobody_out() -> None:
    async def body(page: Served) -> None:
        silent = [await page.open() for _ in range(50)]
        endless = await page.ask("GET /" + "x" * 1_000_000)
        assert endless == b""
        assert (await page.ask("GET /")).startswith(b"HTTP/1.1 200")
        [seen, _] = await page.events(2)
        assert [drone["name"] for drone in seen["drones"]] == ["sender"]
        for _, writer in silent:
            writer.close()

    assert UNKNOWN > 50
    served(body)


def test_a_client_that_takes_nothing_is_left_and_costs_the_others_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(web_module, "STILL_S", 1.5)
    monkeypatch.setattr(web_module, "NOW_S", 0.01)

    async def body(page: Served) -> None:
        for number in range(40):  # some kB a picture, each another one
            page.state.alarms.say(0, "told", "D1", f"{number} " + "x" * 20_000)
        stopped = socket.socket()
        stopped.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stopped.connect((LOOPBACK, page.port))
        stopped.sendall(f"GET /events HTTP/1.1\r\nHost: {LOOPBACK}\r\n\r\n".encode())
        web = page.gate._web
        assert web is not None
        await until(lambda: web.watching > 0)
        begun_s = time.monotonic()
        for _ in range(5):  # beside it
            page.state.newest_ns += 1
            assert len(await page.events(3)) == 3
        assert time.monotonic() - begun_s < 20.0
        await until(lambda: web.watching == 0)
        stopped.close()

    served(body)
