"""Two flights as they go, in one picture."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from drivers.log.mcap_log import McapLog
from missions.live.start import live
from missions.view.watch import Watcher
from tests.free_ports import free_port

PATIENCE_S = 120.0


def fly(log: McapLog, ended: threading.Event) -> None:
    number = 0
    while not ended.wait(0.02):
        number += 1
        log.write("/phase", number, {"phase": "verify", "note": ""})


def test_two_companions_are_watched_together(tmp_path: Path) -> None:
    addresses = {name: f"127.0.0.1:{free_port(socket.SOCK_STREAM)}" for name in ("sender", "receiver")}
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
        end_s = time.monotonic() + PATIENCE_S  # the first one may have told a lot before the second one is there
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
