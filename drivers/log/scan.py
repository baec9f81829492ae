"""The messages of a log in the order it was written, from chunks or loose, up to where the file
ends.

What tells viewers where things are is passed over unread: it is as much again, and is for seeking.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from os import SEEK_CUR
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError

from drivers.log.topics import blank

_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<H4xQ8x")  # channel and log time
# enums compare slowly
_MESSAGE = int(Opcode.MESSAGE)
_CHUNK = int(Opcode.CHUNK)
_END = int(Opcode.DATA_END)
_SAID = {int(Opcode.SCHEMA): Schema, int(Opcode.CHANNEL): Channel, int(Opcode.METADATA): Metadata}
_LONGEST = 4 << 30  # bytes of one record, before it is taken for damage

Raw = tuple[int, bytes]
"""A record as it is in the file: its opcode, and what follows its length."""


class LoggedChannel(NamedTuple):
    """A topic as it is in the file. ``blank``: what a JSON record of it leaves out."""

    topic: str
    encoding: str
    schema: Schema
    blank: dict[str, Any]


class LoggedMessage(NamedTuple):
    channel: LoggedChannel
    utc_ns: int
    data: bytes


def messages(file: IO[bytes]) -> Iterator[LoggedMessage | Metadata]:
    """Yield the messages and metadata of a log, after its magic. A record that is cut off or
    damaged ends it.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, LoggedChannel] = {}
    raw = _records(file)
    while True:
        try:
            opcode, record = next(raw)
            if opcode == _MESSAGE:
                number, utc_ns = _MESSAGE_HEAD.unpack_from(record)
                found = LoggedMessage(channels[number], utc_ns, record[_MESSAGE_HEAD.size :])
            else:
                found = _SAID[opcode].read(ReadDataStream(BytesIO(record)))
                if isinstance(found, Channel):
                    known = schemas[found.schema_id]
                    channels[found.id] = LoggedChannel(
                        found.topic,
                        found.message_encoding,
                        known,
                        blank(found.topic),
                    )
        except StopIteration:
            return
        except (McapError, struct.error, UnicodeDecodeError, KeyError, ZstdError):
            return  # the process that wrote it was killed here, or the file is damaged
        if isinstance(found, Schema):
            schemas[found.id] = found
        elif not isinstance(found, Channel):
            yield found


def _records(file: IO[bytes]) -> Iterator[Raw]:
    """Messages, schemas, channels and metadata, out of their chunks; what follows the data is said
    again.
    """
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        if opcode == _END or length > _LONGEST:
            return
        if opcode not in (_CHUNK, _MESSAGE) and opcode not in _SAID:
            file.seek(length, SEEK_CUR)
            continue
        record = file.read(length)
        if len(record) < length:
            return
        if opcode == _CHUNK:
            yield from _in_chunk(record)
        else:
            yield opcode, record


def _in_chunk(record: bytes) -> list[Raw]:
    stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(record))))
    data = stream.read(length)
    found: list[Raw] = []
    at = 0
    while at < len(data):
        opcode, size = _HEAD.unpack_from(data, at)
        begin = at + _HEAD.size
        at = at + _HEAD.size + size
        if at > len(data):
            raise struct.error("a record longer than its chunk")
        if opcode == _MESSAGE or opcode in _SAID:
            found.append((opcode, data[begin:at]))
    return found
