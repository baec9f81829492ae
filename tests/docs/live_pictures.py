"""Makes the pictures of ``docs/live.md``: a flight that was flown is played to its live page once
more, and a headless browser looks at it.

    path-handoff handoff --rig sim-rendered --seed 6 --out build/flown
    python -m tests.docs.live_pictures build/flown [--at 41] [--into docs]
"""

from __future__ import annotations

import argparse
import io
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer
from PIL import Image

from missions.look.live.gate import LOOPBACK, TOKEN
from missions.look.live.start import Operated, live
from tests.free_ports import free_port
from tests.missions.look.live.browser import browser

SECRET = "shown to nobody"
SCREENS = {"live-phone": (360, 780, 1.5), "live-laptop": (1280, 800, 1.0)}
COLOURS = 64
LAST_S = 1.2  # what comes while the page looks
MOST_BYTES = 150_000


class Played:
    """A flight's logs, written into another folder up to one instant after the other, with stamps
    of now.
    """

    def __init__(self, flown: Path, folder: Path) -> None:
        self._messages = sorted(_messages(flown), key=lambda each: each[0])
        self._folder = folder
        self._begin_ns = self._messages[0][0]
        self._later_ns = 0
        self._logs: dict[str, tuple[Writer, IO[bytes], dict[str, int]]] = {}

    def until(self, seconds: float) -> None:
        """Write all that was logged in so many seconds of the flight; the last of it is of now."""
        end_ns = self._begin_ns + round(seconds * 1e9)
        self._later_ns = self._later_ns or time.time_ns() - end_ns
        while self._messages and self._messages[0][0] <= end_ns:
            self._write(*self._messages.pop(0))
        for _, file, _ in self._logs.values():
            file.flush()

    def close(self) -> None:
        for _, file, _ in self._logs.values():
            file.close()

    def _write(self, utc_ns: int, log: str, schema: Schema, channel: Channel, data: bytes) -> None:
        if log not in self._logs:
            file = (self._folder / log).open("wb")
            writer = Writer(file, compression=CompressionType.NONE, use_chunking=False)
            writer.start()
            self._logs[log] = writer, file, {}
        writer, _, known = self._logs[log]
        if channel.topic not in known:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            encoding = channel.message_encoding
            known[channel.topic] = writer.register_channel(channel.topic, encoding, number)
        at_ns = utc_ns + self._later_ns
        writer.add_message(known[channel.topic], at_ns, data, at_ns)


def _messages(flown: Path) -> Iterator[tuple[int, str, Schema, Channel, bytes]]:
    for path in sorted(flown.glob("*.mcap")):
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if schema is not None:
                    yield message.log_time, path.name, schema, channel, message.data


def make_pictures(flown: Path, at_s: float, into: Path) -> list[Path]:
    """Write the page's pictures at an instant of a flight; returns their files."""
    os.environ[TOKEN] = SECRET
    made: list[Path] = []
    for name, (width, height, ratio) in SCREENS.items():
        address = f"{LOOPBACK}:{free_port(socket.SOCK_STREAM)}"
        # as if D1 heard: nothing is said to it
        operated = Operated((LOOPBACK, free_port()), "both drones end the hand-over and land")
        with tempfile.TemporaryDirectory() as name_of_folder:
            played = Played(flown, Path(name_of_folder))
            with live(address, Path(name_of_folder), operated), browser() as tab:
                tab.size(width, height, ratio)
                tab.open(f"http://{address}/?token={SECRET}")
                tab.until("true")
                for until_s in (at_s - LAST_S, at_s):
                    played.until(until_s)
                    tab.until(f"now && now.since_s >= {until_s - 0.3} && drawn.timeline")
                time.sleep(1.0)
                picture = tab.picture()
            played.close()
        file = into / f"{name}.png"
        with Image.open(io.BytesIO(picture)) as image:
            image.convert("RGB").quantize(COLOURS).save(file, optimize=True)
        made.append(file)
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("flown", type=Path)
    parser.add_argument("--at", type=float, default=41.0)
    parser.add_argument("--into", type=Path, default=Path("docs"))
    asked = parser.parse_args()
    for file in make_pictures(asked.flown, asked.at, asked.into):
        print(f"{file}: {file.stat().st_size} bytes")
        assert file.stat().st_size < MOST_BYTES


if __name__ == "__main__":
    main()
