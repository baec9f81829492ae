"""Serves a folder's logs as they grow, as a page for the crew (``web``) and over Foxglove's
WebSocket, until its input ends.

    python -m missions.look.live.serve FOLDER HOST PORT CAN

``CAN`` is JSON: ``operator``, host and port of D1's program for what it is told, and ``stops``,
what it does to call the flight off; both may be empty. The flight's command is then told ``stop``
on stdout. The stream itself is on a port of loopback that nobody is told, and ``missions.look.live.gate``
stands before it: from other computers it lets in whoever knows the token in ``PATH_LIVE_TOKEN``,
and no page of a browser that is not a viewer's.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import os
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import foxglove

from missions.look.live.acts import DroneLine, Operator
from missions.look.live.flight_state import FlightState
from missions.look.live.follow import FolderFollower, Said
from missions.look.live.gate import LOOPBACK, TOKEN, TokenGate
from missions.look.live.web import Web

POLL_S = 0.03
NEW_S = 0.05  # for clients to ask for a topic before its first message
# many come at once from a log in virtual time
PIECE = 128
PIECE_S = 0.01
LAST_S = 1.0  # the page sees the end
REST_S = 5.0  # after the flight, for what is left of it
BACKLOG = 512
"""Messages that wait for a client; the oldest is dropped for a newer one."""


class Stream:
    """Channels by topic, made when something is said in them."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}

    def begin(self, said: Said) -> bool:
        """Make the channel of a message; return whether it is new, so that clients can ask for it
        first.
        """
        if said.topic in self._channels:
            return False
        schema = foxglove.Schema(
            name=said.schema.name,
            encoding=said.schema.encoding,
            data=said.schema.data,
        )
        self._channels[said.topic] = foxglove.Channel(
            said.topic,
            message_encoding=said.encoding,
            schema=schema,
            context=self.context,
        )
        return True

    def tell(self, said: Said) -> None:
        self._channels[said.topic].log(said.message.data, log_time=said.message.log_time)


def main() -> None:
    folder = Path(sys.argv[1])
    host = sys.argv[2]
    port = int(sys.argv[3])
    can: dict[str, Any] = json.loads(sys.argv[4])
    with suppress(OSError):
        os.nice(10)  # the flight comes first
    log_to_stderr()
    stream = Stream()
    server = foxglove.start_server(
        name=f"PATH: {folder.name}",
        host=LOOPBACK,
        port=0,
        context=stream.context,
        message_backlog_size=BACKLOG,
    )
    state = FlightState()
    line = DroneLine((can["operator"][0], can["operator"][1])) if can["operator"] else None
    stop = _stop if can["stops"] else None
    token = os.environ.get(TOKEN, "")
    operator = Operator(state, folder, token, line, stop, can["stops"])
    web = Web(state, operator.act, operator.can, operator.image_of)
    gate = TokenGate("" if host == LOOPBACK else token, server.port, web)
    try:
        asyncio.run(_serve(Served(folder, stream, web, operator), gate, host, port))
    finally:
        operator.close()
        server.stop()


def _stop() -> None:
    """Have the flight's command call the flight off."""
    print("stop", flush=True)


def log_to_stderr() -> None:
    """The server's warnings, among the lines of the flight, but for what nobody has to do anything
    about.

    On a busy computer foxglove-sdk advertises a channel before it takes subscriptions to it, and
    says so of the client that was quicker: that one asks again (``missions.look.view.watch``).
    """
    handler = logging.StreamHandler()
    handler.addFilter(lambda record: "subscribe to unknown channel" not in record.getMessage())
    logging.basicConfig(format="live: %(message)s", handlers=[handler])
    foxglove.set_log_level("WARNING")


async def _serve(
    served: Served,
    gate: TokenGate,
    host: str,
    port: int,
) -> None:
    await gate.open(host, port)
    print(f"up {port}", flush=True)
    await served.until_ended()


class Served:
    """A flight as it is served: what is logged goes to the stream's clients and into the page."""

    def __init__(
        self,
        folder: Path,
        stream: Stream,
        web: Web,
        operator: Operator,
    ) -> None:
        self._follower = FolderFollower(folder)
        self._stream = stream
        self._web = web
        self._operator = operator

    async def until_ended(self) -> None:
        """Pass on what is logged until stdin ends, and some seconds more what is left of it."""
        ended = asyncio.Event()
        asyncio.get_running_loop().add_reader(
            sys.stdin.fileno(), lambda: os.read(sys.stdin.fileno(), 4096) or ended.set()
        )
        last_s = math.inf
        while time.monotonic() < last_s:
            if ended.is_set() and last_s == math.inf:
                last_s = time.monotonic() + REST_S
            if not await self._pass_on(last_s) and ended.is_set():
                break
            self._operator.turn(time.monotonic(), watched=self._web.watching > 0)
            await asyncio.sleep(POLL_S)
        self._follower.close()
        # for what clients have not been sent yet
        await asyncio.sleep(LAST_S if self._web.watching else LAST_S / 5)

    async def _pass_on(self, last_s: float) -> int:
        """Send what is new, no faster than clients take it; return the number of messages."""
        count = 0
        for count, said in enumerate(self._follower.new(), 1):
            self._web.state.take(said, time.monotonic())
            if self._stream.begin(said):
                await asyncio.sleep(NEW_S)
            self._stream.tell(said)
            if count % PIECE == 0:
                await asyncio.sleep(PIECE_S)
            if time.monotonic() >= last_s:
                break
        return count


if __name__ == "__main__":
    main()
