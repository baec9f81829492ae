"""Who may watch a flight: programs of this computer, viewers, who knows the token; no page of
anybody else.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import pytest

from missions.look.live.gate import LOOPBACK, UNKNOWN, TokenGate, is_own_origin

TOKEN = "a token of some length"
OWN = (
    "", "Origin: http://localhost:8080", "Origin: http://127.0.0.1:9090", "Origin: http://[::1]:8080",
    "origin: https://app.foxglove.dev", "Origin: file://", "Origin: foxglove://app",
)  # fmt: skip
OTHERS = (
    "Origin: https://evil.example", "Origin: http://evil.example:8765", "Origin: null", "ORIGIN: https://evil.example",
    "Origin: http://localhost.evil.example", "Origin: http://app.foxglove.dev", "Origin: http://[", "Origin: \xff",
    "Origin: http://localhost\r\nOrigin: https://evil.example", "Origin:", "Origin: https://app.foxglove.dev.evil.example",
)  # fmt: skip


def head(line: str, token: str = "") -> bytes:
    said = f"?token={token.replace(' ', '%20')}" if token else ""
    return f"GET /{said} HTTP/1.1\r\nHost: x\r\n{line}\r\n\r\n".replace(
        "\r\n\r\n\r\n", "\r\n\r\n"
    ).encode("latin-1")


@pytest.mark.parametrize("line", OWN)
def test_programs_and_viewers_may_watch(line: str) -> None:
    assert is_own_origin(head(line))


@pytest.mark.parametrize("line", OTHERS)
def test_any_other_page_may_not(line: str) -> None:
    assert not is_own_origin(head(line))


Ask = Callable[[bytes], Awaitable[bytes]]


def behind(token: str, body: Callable[[Ask, int], Coroutine[Any, Any, None]]) -> None:
    """Runs a gate before a stream that answers ``inner`` to whatever it is asked."""

    async def main() -> None:
        async def stream(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"inner")
            await writer.drain()
            writer.close()

        inner = await asyncio.start_server(stream, LOOPBACK, 0)
        gate = TokenGate(token, inner.sockets[0].getsockname()[1])
        port = await gate.open(LOOPBACK, 0)

        async def ask(request: bytes) -> bytes:
            reader, writer = await asyncio.open_connection(LOOPBACK, port)
            writer.write(request)
            answer = await asyncio.wait_for(reader.read(100), 60.0)
            writer.close()
            return answer

        try:
            await body(ask, port)
        finally:
            gate.close()
            inner.close()

    asyncio.run(main())


def test_on_loopback_no_token_is_asked_for_and_no_other_page_is_served() -> None:
    async def body(ask: Ask, _: int) -> None:
        assert await ask(head("")) == b"inner"
        assert (await ask(head("Origin: https://evil.example"))).startswith(b"HTTP/1.1 401")

    behind("", body)


def test_a_token_does_not_let_a_page_in() -> None:
    async def body(ask: Ask, _: int) -> None:
        assert await ask(head("", TOKEN)) == b"inner"
        assert (await ask(head("Origin: https://evil.example", TOKEN))).startswith(b"HTTP/1.1 401")
        assert (await ask(head(""))).startswith(b"HTTP/1.1 401")

    behind(TOKEN, body)


@pytest.mark.parametrize("silent", [16, UNKNOWN, 2 * UNKNOWN])
def test_silent_connections_keep_nobody_out_who_knows_the_token(silent: int) -> None:
    async def body(ask: Ask, port: int) -> None:
        held = [await asyncio.open_connection(LOOPBACK, port) for _ in range(silent)]
        assert await ask(head("", TOKEN)) == b"inner"
        for _, writer in held:
            writer.close()

    behind(TOKEN, body)


def test_clients_that_are_there_at_the_end_leave_no_traceback(
    capsys: pytest.CaptureFixture[str],
) -> None:
    told: list[dict[str, Any]] = []

    def keep(loop: object, context: dict[str, Any]) -> None:
        del loop
        told.append(context)

    async def body(ask: Ask, port: int) -> None:
        del ask
        asyncio.get_running_loop().set_exception_handler(keep)
        held.extend(socket.create_connection((LOOPBACK, port)) for _ in range(3))
        await asyncio.sleep(0.1)

    held: list[socket.socket] = []
    behind(TOKEN, body)
    for each in held:
        each.close()
    assert told == []
    assert "Traceback" not in capsys.readouterr().err
