"""Logs that are being written, read as they grow.

A log in real time reaches the disk record by record; one in virtual time a megabyte at a time. What
a log says is passed on under its own name. A log that is closed is replaced by one with an index:
what was open is read to its end.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from drivers.log.frames import is_frames
from drivers.log.index import MAGIC
from path.values import frozen

READ_BYTES = 1 << 20
SLACK_S = 0.05  # stamps of files are coarser than the clock
_HEAD = struct.Struct("<BQ")


@frozen
class Said:
    """A message; the log's name is before its topic."""

    topic: str
    encoding: str
    schema: Schema
    message: Message


class FolderFollower:
    """All logs of a folder written from now on, but for those of every frame of a camera.

    Those of an earlier run, which a new one takes away, are not.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._since_s = folder, time.time() - SLACK_S
        self._logs: dict[Path, LogFollower] = {}

    def new(self) -> Iterator[Said]:
        """Return what is new, at most a megabyte of each log."""
        for path in sorted(self._folder.glob("*.mcap")):
            if (
                path not in self._logs
                and path.stem != "merged"
                and not is_frames(path)
                and self._is_new(path)
            ):
                self._logs[path] = LogFollower(path)
        for log in self._logs.values():
            yield from log.new()

    def _is_new(self, path: Path) -> bool:
        try:
            return path.stat().st_mtime >= self._since_s
        except OSError:
            return False

    def close(self) -> None:
        for log in self._logs.values():
            log.close()


class LogFollower:
    """One log. Never raises for what is in it: what cannot be read ends it."""

    def __init__(self, path: Path) -> None:
        self._name = name_of(path)
        self._path = path
        self._file: IO[bytes] | None = None
        self._rest = b""
        self._begun = self._ended = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def new(self) -> Iterator[Said]:
        if self._ended:
            return
        try:
            if self._file is None:
                self._file = self._path.open("rb")
            self._rest += self._file.read(READ_BYTES)
            for opcode, content in self._whole():
                yield from self._take(opcode, content)
        except Exception:  # nothing that is wrong with one log ends the others
            self.close()

    def close(self) -> None:
        self._ended = True
        if self._file is not None:
            self._file.close()

    def _whole(self) -> Iterator[tuple[int, bytes]]:
        """The records that are there to their last byte."""
        at = 0
        if not self._begun:
            if len(self._rest) < len(MAGIC):
                return
            at = len(MAGIC)
            self._begun = True
        while at + _HEAD.size <= len(self._rest):
            opcode, length = _HEAD.unpack_from(self._rest, at)
            if at + _HEAD.size + length > len(self._rest):
                break
            yield opcode, self._rest[at + _HEAD.size : at + _HEAD.size + length]
            at += _HEAD.size + length
        self._rest = self._rest[at:]

    def _take(self, opcode: int, content: bytes) -> Iterator[Said]:
        stream = ReadDataStream(BytesIO(content))
        match opcode:
            case Opcode.SCHEMA:
                yield from self._record(Schema.read(stream))
            case Opcode.CHANNEL:
                yield from self._record(Channel.read(stream))
            case Opcode.MESSAGE:
                yield from self._record(Message.read(stream, len(content)))
            case Opcode.CHUNK:
                for record in breakup_chunk(Chunk.read(stream)):
                    yield from self._record(record)
            case Opcode.DATA_END:
                self.close()
            case _:
                pass

    def _record(self, record: object) -> Iterator[Said]:
        match record:
            case Schema():
                self._schemas[record.id] = record
            case Channel():
                self._channels[record.id] = record
            case Message():
                channel = self._channels[record.channel_id]
                schema = self._schemas[channel.schema_id]
                yield Said(
                    f"/{self._name}{channel.topic}",
                    channel.message_encoding,
                    schema,
                    record,
                )
            case _:
                pass


def name_of(path: Path) -> str:
    """The prefix of a log's topics, as ``missions.look.logs.merge`` has it; parts after a restart
    have the first's.
    """
    stem, _, number = path.stem.rpartition(".")
    return (stem if number.isdecimal() else path.stem).replace(".", "_")
