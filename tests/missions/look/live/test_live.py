"""A flight as it goes, seen by clients that know nothing of PATH but Foxglove's protocol."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from foxglove.messages import SceneUpdate
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, virtual_log
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.live.follow import FolderFollower
from missions.look.live.gate import LOOPBACK, TOKEN, TokenGate, knows
from missions.look.live.start import address_of, live
from tests.free_ports import free_port
from tests.written_logs import until_written

PROTOCOL = Subprotocol("foxglove.sdk.v1")
SECRET = "0123456789abcdef"


def dial(url: str) -> ClientConnection:
    return connect(url, subprotocols=[PROTOCOL], open_timeout=120, proxy=None, max_size=None)


def ask(client: ClientConnection, *channels: int) -> None:
    asked = [{"id": number, "channelId": number} for number in channels]
    client.send(json.dumps({"op": "subscribe", "subscriptions": asked}))


def heard(client: ClientConnection, *topics: str) -> dict[str, tuple[int, bytes]]:
    """The first message of each topic: stamp and content.

    A server on a busy computer advertises a channel before it takes subscriptions to it: it is
    asked again.
    """
    named: dict[int, str] = {}
    found: dict[str, tuple[int, bytes]] = {}
    while found.keys() != set(topics):
        word = client.recv(timeout=180)
        if isinstance(word, bytes):
            opcode, number, stamp_ns = struct.unpack_from("<BIQ", word)
            assert opcode == 1
            found.setdefault(named[number], (stamp_ns, word[13:]))
            continue
        told: dict[str, Any] = json.loads(word)
        if told["op"] == "advertise":
            wanted = {
                each["id"]: each["topic"] for each in told["channels"] if each["topic"] in topics
            }
            named |= wanted
            ask(client, *wanted)
        elif told["op"] == "status":
            time.sleep(0.01)
            ask(client, int(told["message"].removeprefix("Unknown channel ID: ")))
    return found


@pytest.fixture
def token(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv(TOKEN, SECRET)
    return SECRET


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[McapLog]:
    """A drone that logs, a hundred times a second, until the test ends."""
    ended = threading.Event()
    with McapLog(tmp_path / "sender.mcap", "sender") as log, ExitStack() as stack:

        def fly() -> None:
            while not ended.wait(0.01):
                log.write("/phase", time.monotonic_ns(), {"phase": "verify", "note": ""})

        thread = threading.Thread(target=fly)
        stack.callback(thread.join)
        stack.callback(ended.set)
        thread.start()
        yield log
    assert log.failed is None


def test_a_stranger_sees_a_flight_as_it_goes(tmp_path: Path, flight: McapLog) -> None:
    port = free_port(socket.SOCK_STREAM)
    with live(f"{LOOPBACK}:{port}", tmp_path), dial(f"ws://{LOOPBACK}:{port}") as client:
        seen = heard(client, "/sender/phase", "/sender/log")
    stamp_ns, content = seen["/sender/phase"]
    assert json.loads(content) == {"phase": "verify", "note": ""}
    assert abs(stamp_ns - time.time_ns()) < 60_000_000_000
    assert b"phase verify" in seen["/sender/log"][1]


def test_a_stranger_decodes_what_is_seen_during_a_flight_in_virtual_time(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    # the client dials before anything flies and leaves before the stream ends
    with ExitStack() as stack:
        stack.enter_context(live(f"{LOOPBACK}:{port}", tmp_path))
        client = stack.enter_context(dial(f"ws://{LOOPBACK}:{port}"))
        watched = stack.enter_context(ThreadPoolExecutor(1)).submit(
            heard, client, "/sender/state", "/receiver/3d", "/world/truth"
        )
        facts = fly_once(
            rig_library.load("sim"), 11, ("pilot_takeover@take-off+2",), tmp_path, lambda _: None
        )
        seen = watched.result()
    assert facts.outcome == "pilot_override"
    assert json.loads(seen["/sender/state"][1])["armed"] in (True, False)
    scene = SceneUpdate.get_schema()
    decode = DecoderFactory().decoder_for(
        "protobuf", Schema(1, scene.data, scene.encoding, scene.name)
    )
    assert decode is not None
    assert decode(seen["/receiver/3d"][1]).entities[0].id.startswith("receiver/")


def test_nothing_is_said_among_the_flights_lines_of_a_client_that_asks_too_early(
    tmp_path: Path, flight: McapLog, capfd: pytest.CaptureFixture[str]
) -> None:
    port = free_port(socket.SOCK_STREAM)
    with live(f"{LOOPBACK}:{port}", tmp_path), dial(f"ws://{LOOPBACK}:{port}") as client:
        ask(client, 999)
        while json.loads(client.recv(timeout=180)).get("message") != "Unknown channel ID: 999":
            pass
    said = capfd.readouterr()
    assert "unknown channel" not in said.out + said.err


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind((LOOPBACK, 0))
        taken.listen()
        address = f"{LOOPBACK}:{taken.getsockname()[1]}"
        with pytest.raises(PartError, match="could not be served"), live(address, tmp_path):
            pass


def test_whoever_has_no_token_is_refused(tmp_path: Path, flight: McapLog, token: str) -> None:
    port = free_port(socket.SOCK_STREAM)
    with live(f"127.0.0.2:{port}", tmp_path):
        for query in ("", "?token=", "?token=0123456789abcdeF", f"?other={token}"):
            with pytest.raises(InvalidStatus, match="401"):
                dial(f"ws://127.0.0.2:{port}/{query}")
        with dial(f"ws://127.0.0.2:{port}/?token={token}") as client:
            assert heard(client, "/sender/phase")


@pytest.mark.parametrize("asked", ["0.0.0.0:8765", "10.0.0.5:8765"])
def test_other_hosts_need_a_token(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for known in ("", "short"):
        monkeypatch.setenv(TOKEN, known)
        with pytest.raises(PartError, match="only watch with a token") as refused:
            address_of(asked)
        assert TOKEN in refused.value.remedy
    monkeypatch.setenv(TOKEN, SECRET)
    assert address_of(asked) == (asked.rpartition(":")[0], 8765)
    assert address_of("localhost:1") == (LOOPBACK, 1)


@pytest.mark.parametrize(
    "asked", ["8765", "localhost", ":8765", "host:port", "host:0", "host:70000"]
)
def test_what_is_no_address_is_refused(asked: str) -> None:
    with pytest.raises(PartError, match="no address"):
        address_of(asked)


@pytest.mark.parametrize(
    ("head", "let_in"),
    [
        (f"GET /?token={SECRET} HTTP/1.1\r\n\r\n", True),
        (f"GET /?x=1&token={SECRET} HTTP/1.1\r\n\r\n", True),
        (f"GET / HTTP/1.1\r\nX: ?token={SECRET}\r\n\r\n", False),
        (f"POST /?token={SECRET} HTTP/1.1\r\n\r\n", False),
        ("GET /?token=\xff HTTP/1.1\r\n\r\n", False),
        ("\r\n\r\n", False),
    ],
)
def test_the_token_is_in_the_request_line(head: str, let_in: bool) -> None:
    assert knows(head.encode("latin-1"), SECRET) is let_in
    assert not knows(head.encode("latin-1"), "")


def test_a_gate_without_a_token_does_not_open() -> None:
    with pytest.raises(ValueError, match="no token"):
        asyncio.run(TokenGate("", 1).open("0.0.0.0", 0))


# --- logs that grow


def drain(follower: FolderFollower) -> list[tuple[str, str, int]]:
    """The new records: topic, schema, stamp."""
    return [(said.topic, said.schema.name, said.message.log_time) for said in follower.new()]


def test_every_record_is_told_once_and_in_order_though_the_log_is_closed_meanwhile(
    tmp_path: Path,
) -> None:
    follower = FolderFollower(tmp_path)
    told: list[tuple[str, str, int]] = []
    with McapLog(tmp_path / "receiver.guard.mcap", "receiver") as log:
        for k in range(100):
            log.write("/note", k, {"note": str(k)})
            if k % 7 == 0:
                told += drain(follower)
    told += drain(follower)
    notes = [stamp for topic, _, stamp in told if topic == "/receiver_guard/note"]
    assert len(notes) == 100
    assert notes == sorted(notes)
    follower.close()


def test_a_log_in_virtual_time_is_told_by_the_megabyte(tmp_path: Path) -> None:
    follower = FolderFollower(tmp_path)
    told: list[tuple[str, str, int]] = []
    log = virtual_log(tmp_path / "sender.mcap", "sender")
    log.write("/note", 0, {"note": "x" * 500_000})
    told += drain(follower)
    assert told == []
    log.write("/note", 1, {"note": "x" * 600_000})
    told += drain(follower)
    assert [topic for topic, _, _ in told if topic == "/sender/note"]
    log.close()
    follower.close()


def test_logs_of_an_earlier_run_are_not_told(tmp_path: Path) -> None:
    with McapLog(tmp_path / "sender.mcap", "sender") as log:
        log.write("/note", 0, {"note": "of before"})
    time.sleep(0.2)
    follower = FolderFollower(tmp_path)
    told: list[tuple[str, str, int]] = []
    told += drain(follower)
    assert told == []
    with McapLog(tmp_path / "sender.mcap", "sender") as log:
        log.write("/note", 1, {"note": "of now"})
        until_written(log)
        told += drain(follower)
    assert len([topic for topic, _, _ in told if topic == "/sender/note"]) == 1
    follower.close()


def test_what_is_no_log_ends_its_following_alone(tmp_path: Path) -> None:
    follower = FolderFollower(tmp_path)
    told: list[tuple[str, str, int]] = []
    (tmp_path / "a.mcap").write_bytes(
        b"\x89MCAP0\r\n" + bytes([3]) + struct.pack("<Q", 4) + b"\xff\xff\xff\xff" * 3
    )
    with McapLog(tmp_path / "b.mcap", "b") as log:
        log.write("/note", 0, {"note": "here"})
        until_written(log)
        told += drain(follower)
    assert ("/b/note", "path.note") in {(topic, schema) for topic, schema, _ in told}
    follower.close()
