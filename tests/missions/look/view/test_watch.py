"""Two flights as they go, in one picture."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from websockets.sync.server import ServerConnection, serve

from drivers.log.mcap_log import McapLog
from missions.look.live.start import live
from missions.look.view.watch import PROTOCOL, Watcher
from tests.free_ports import free_port

PATIENCE_S = 120.0


def fly(log: McapLog, ended: threading.Event) -> None:
    number = 0
    while not ended.wait(0.02):
        number += 1
        log.write("/phase", number, {"phase": "verify", "note": ""})


def test_two_companions_are_watched_together(tmp_path: Path) -> None:
    addresses = {
        name: f"127.0.0.1:{free_port(socket.SOCK_STREAM)}" for name in ("sender", "receiver")
    }
    watcher = Watcher(*addresses.values())  # before either flies
    seen: set[str] = set()
    with ExitStack() as stack:
        ended = threading.Event()
        for name, address in addresses.items():
            log = stack.enter_context(McapLog(tmp_path / name / f"{name}.mcap", name))
            stack.enter_context(live(address, tmp_path / name))
            thread = threading.Thread(target=fly, args=(log, ended))
            stack.callback(thread.join)
            thread.start()
        stack.callback(ended.set)
        # the first one may have told a lot before the second one is there
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            heard = watcher.next(PATIENCE_S)
            assert heard is not None
            seen.add(heard.topic)
            if heard.topic.endswith("/log"):
                assert heard.schema.name == "foxglove.Log"
                assert b"phase verify" in heard.data
            if len(seen) == 4:
                break
    assert seen == {f"/{name}/{topic}" for name in addresses for topic in ("phase", "log")}


def test_a_channel_that_is_not_taken_at_once_is_asked_for_again() -> None:
    """foxglove-sdk says a channel's name before it knows it, on a busy computer long before."""
    asked: list[int] = []

    def late(client: ServerConnection) -> None:
        channel = {
            "id": 7,
            "topic": "/phase",
            "encoding": "json",
            "schemaName": "x",
            "schema": "{}",
        }
        client.send(json.dumps({"op": "advertise", "channels": [channel]}))
        for word in client:
            asked.extend(each["channelId"] for each in json.loads(word)["subscriptions"])
            if len(asked) < 3:
                client.send(
                    json.dumps({"op": "status", "level": 2, "message": "Unknown channel ID: 7"})
                )
            else:
                client.send(
                    bytes([1]) + (7).to_bytes(4, "little") + (99).to_bytes(8, "little") + b"here"
                )

    with serve(late, "127.0.0.1", 0, subprotocols=[PROTOCOL]) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            heard = Watcher("127.0.0.1:{1}".format(*server.socket.getsockname())).next(PATIENCE_S)
        finally:
            server.shutdown()
            thread.join()
    assert heard is not None
    assert (heard.topic, heard.utc_ns, heard.data) == ("/phase", 99, b"here")
    assert asked == [7, 7, 7]
