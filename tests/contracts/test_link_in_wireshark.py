"""The link's packets as Wireshark shows them, with the dissector that PATH writes."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from drivers.link.dialect.generate import write_dissector
from drivers.link.wire import Codec
from path.messages import Message, Ping, Role, Target

PORT = 14602
TARGET = Target(7, 2, 3, 41, 123_456_780_000, (1.25, -2.5, 0.125), (0.6, 0.0, 0.8), 0.0123)

pytestmark = pytest.mark.skipif(
    shutil.which("tshark") is None, reason="tshark is not installed (docs/protocol.md)"
)


def capture(file: Path, *messages: Message) -> None:
    """What tcpdump writes of them: IP and UDP around each, to the link's port."""
    codec = Codec(Role.SENDER, None)
    with file.open("wb") as out:
        out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101))  # 101: bare IP
        for number, message in enumerate(messages):
            data = codec.encode(message)
            udp = struct.pack(">HHHH", 40_000, PORT, 8 + len(data), 0) + data
            ip = struct.pack(
                ">BBHHHBBHII", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, 0x7F000001, 0x7F000001
            )
            out.write(struct.pack("<IIII", number, 0, len(ip + udp), len(ip + udp)) + ip + udp)


def tshark(*arguments: str) -> str:
    done = subprocess.run(
        ["tshark", *arguments], capture_output=True, text=True, timeout=300.0, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "Lua: Error" not in done.stderr, done.stderr
    return done.stdout


def test_messages_and_their_fields_have_names(tmp_path: Path) -> None:
    write_dissector(tmp_path / "path.lua")
    capture(tmp_path / "link.pcap", Ping(5, 1), TARGET)
    read = ("-X", f"lua_script:{tmp_path / 'path.lua'}", "-r", str(tmp_path / "link.pcap"))
    shown = tshark(*read, "-V")
    assert "PATH_PING" in shown
    assert "PATH_TARGET" in shown
    fields = ("handoff_id", "epoch", "target_id", "sequence")
    asked = [each for name in fields for each in ("-e", f"path_link.PATH_TARGET_{name}")]
    assert tshark(*read, "-Y", "path_link.PATH_TARGET_epoch", "-T", "fields", *asked).split() == [
        "7",
        "2",
        "3",
        "41",
    ]


def test_it_loads_beside_the_one_of_mavlink(tmp_path: Path) -> None:
    """Two dissectors of mavgen's have one name and one set of variables; this one has neither."""
    from drivers.link.dialect.generate import generate  # noqa: PLC0415

    generate(tmp_path / "mavlink.lua", "WLua")
    write_dissector(tmp_path / "path.lua")
    capture(tmp_path / "link.pcap", TARGET)
    for first, second in (("path", "mavlink"), ("mavlink", "path")):
        scripts = [
            each for name in (first, second) for each in ("-X", f"lua_script:{tmp_path / name}.lua")
        ]
        shown = tshark(
            *scripts,
            "-r",
            str(tmp_path / "link.pcap"),
            "-T",
            "fields",
            "-e",
            "path_link.PATH_TARGET_epoch",
        )
        assert shown.split() == ["2"]
