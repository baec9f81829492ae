"""Serves a folder's logs as they grow, over Foxglove's WebSocket, until its input ends.

    python -m missions.look.live.serve FOLDER HOST PORT

The stream itself is on a port of loopback that nobody is told, and ``missions.look.live.gate``
stands before it: from other computers it lets in whoever knows the token in ``PATH_LIVE_TOKEN``,
and no page of a browser that is not a viewer's.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

import foxglove

from missions.look.live.follow import FolderFollower, Said
from missions.look.live.gate import LOOPBACK, TOKEN, TokenGate

POLL_S = 0.03
NEW_S = 0.05  # for clients to ask for a topic before its first message
# many come at once from a log in virtual time
PIECE = 128
PIECE_S = 0.01
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
            name=said.schema.name, encoding=said.schema.encoding, data=said.schema.data
        )
        self._channels[said.topic] = foxglove.Channel(
            said.topic, message_encoding=said.encoding, schema=schema, context=self.context
        )
        return True

    def tell(self, said: Said) -> None:
        self._channels[said.topic].log(said.message.data, log_time=said.message.log_time)


def main() -> None:
    folder = Path(sys.argv[1])
    host = sys.argv[2]
    port = int(sys.argv[3])
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
    try:
        asyncio.run(_serve(FolderFollower(folder), stream, host, port, server.port))
    finally:
        server.stop()


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
    follower: FolderFollower, stream: Stream, host: str, port: int, inner: int
) -> None:
    gate = TokenGate("" if host == LOOPBACK else os.environ.get(TOKEN, ""), inner)
    await gate.open(host, port)
    print(f"up {port}", flush=True)
    ended = asyncio.Event()
    asyncio.get_running_loop().add_reader(
        sys.stdin.fileno(), lambda: os.read(sys.stdin.fileno(), 4096) or ended.set()
    )
    last_s = math.inf
    while time.monotonic() < last_s:
        if ended.is_set() and last_s == math.inf:
            last_s = time.monotonic() + REST_S
        if not await _pass_on(follower, stream, last_s) and ended.is_set():
            break
        await asyncio.sleep(POLL_S)
    follower.close()
    await asyncio.sleep(0.2)  # for what clients have not been sent yet


async def _pass_on(follower: FolderFollower, stream: Stream, last_s: float) -> int:
    """Send what is new, no faster than clients take it; return the number of messages."""
    count = 0
    for count, said in enumerate(follower.new(), 1):
        if stream.begin(said):
            await asyncio.sleep(NEW_S)
        stream.tell(said)
        if count % PIECE == 0:
            await asyncio.sleep(PIECE_S)
        if time.monotonic() >= last_s:
            break
    return count


if __name__ == "__main__":
    main()
