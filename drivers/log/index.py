"""Puts a closed log into chunks with an index, as the viewers want it: they seek, and read only
what they show.

A log is written message by message, so that whoever is killed loses hardly any. Here its bytes are
copied, a megabyte at a time, into compressed chunks; no message is decoded. The file is replaced
when the copy is whole: whatever happens meanwhile, one of the two is there. A log in virtual time
goes straight into chunks.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from array import array
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

Record = (
    Channel | Chunk | ChunkIndex | DataEnd | Footer | Header | Metadata | MetadataIndex | Schema | Statistics
    | SummaryOffset
)  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
ABOUT = "path"
OFFSET = "utc_minus_stamp_ns"
"""Metadata of every log: a record of this name, and the key of how far its UTC is from its
program's clock.
"""
CHUNK_BYTES = 1 << 20
LEVEL = 1  # of the compression: as fast as the disk
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<9xH4xQ")  # channel and log time of a whole record
# enums compare slowly
_IS_MESSAGE = int(Opcode.MESSAGE)
_ENDS = (int(Opcode.DATA_END), int(Opcode.FOOTER))
_INDEX = struct.Struct("<BQHI")
_WRITTEN = struct.Struct("<BQHIQQ")  # head, then channel, sequence, log and publish time


def index_log(path: Path) -> None:
    """Put a whole log into chunks. What is no file stays as it is. Raises OSError."""
    if not path.is_file():
        return
    copy = path.with_name(path.name + ".indexing")
    try:
        with (
            path.open("rb") as loose,
            mmap.mmap(loose.fileno(), 0, access=mmap.ACCESS_READ) as data,
        ):
            chunked = ChunkedFile(copy)
            try:
                _copy(data, chunked)
            finally:
                chunked.close()
        copy.replace(path)
    finally:
        copy.unlink(missing_ok=True)


def _copy(data: mmap.mmap, chunked: ChunkedFile) -> None:
    at = len(MAGIC)
    end = len(data)
    while at + _HEAD.size <= end:
        opcode, length = _HEAD.unpack_from(data, at)
        after = at + _HEAD.size + length
        if after > end or opcode in _ENDS:
            return
        if opcode == _IS_MESSAGE:
            channel, utc_ns = _MESSAGE.unpack_from(data, at)
            chunked.message(channel, utc_ns, data[at:after])
        else:
            chunked.say(opcode, data[at:after])
        at = after


class ChunkedFile:
    """A log in chunks; of one that was not closed the newest megabyte is missing. Raises
    OSError.
    """

    lost = 0  # it waits for the disk, whatever that takes

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._chunk = bytearray()
        # by channel: log time and place, one after the other
        self._in_chunk: dict[int, array[int]] = {}
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._said: dict[int, list[bytes]] = {int(Opcode.SCHEMA): [], int(Opcode.CHANNEL): []}
        self._metadata: list[bytes] = []  # their indices
        self._file.write(MAGIC)

    def say(self, opcode: int, record: bytes) -> None:
        """Anything but a message. Header and metadata come first."""
        if opcode in self._said:
            self._said[opcode].append(record)
            self._chunk += record
            return
        if opcode == Opcode.METADATA:
            name = Metadata.read(ReadDataStream(BytesIO(record[_HEAD.size :]))).name
            self._metadata.append(built(MetadataIndex(self._file.tell(), len(record), name)))
        self._file.write(record)

    def message(
        self,
        channel: int,
        utc_ns: int,
        record: bytes,
    ) -> None:
        """A whole record of a message."""
        index = self._in_chunk.get(channel)
        if index is None:
            index = self._in_chunk[channel] = array("Q")
        index.append(utc_ns)
        index.append(len(self._chunk))
        self._chunk += record
        if len(self._chunk) >= CHUNK_BYTES:
            self._write_chunk()

    def settle(self) -> bool:
        """Return True: nothing waits but the newest chunk."""
        return True

    def end_chunk(self) -> int:
        """Write what waits, and return how many bytes of the file that was."""
        at = self._file.tell()
        self._write_chunk()
        return self._file.tell() - at

    def close(self) -> None:
        """Write what is left, and the summary."""
        with self._file:
            self._write_chunk()
            self._write_summary()

    def _write_chunk(self) -> None:
        if not self._in_chunk:
            return
        records = self._chunk
        stamps = [index[::2] for index in self._in_chunk.values()]
        begin_ns = min(map(min, stamps))
        end_ns = max(map(max, stamps))
        data = zstandard.compress(records, LEVEL)
        at = self._file.tell()
        length = self._file.write(
            built(Chunk("zstd", data, end_ns, begin_ns, zlib.crc32(records), len(records)))
        )
        places: dict[int, int] = {}
        for channel, index in self._in_chunk.items():
            places[channel] = self._file.tell()
            entries = index.tobytes()
            self._file.write(
                _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
            )
            self._counts[channel] = self._counts.get(channel, 0) + len(index) // 2
        indices = self._file.tell() - at - length
        self._chunks.append(
            ChunkIndex(
                length,
                at,
                "zstd",
                len(data),
                end_ns,
                indices,
                places,
                begin_ns,
                len(records),
            )
        )
        self._file.flush()  # for whoever follows the flight
        self._in_chunk.clear()
        self._chunk.clear()

    def _write_summary(self) -> None:
        self._file.write(built(DataEnd(0)))
        begin = self._file.tell()
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            *self._said.items(),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [built(chunk) for chunk in self._chunks]),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            if records:
                at = self._file.tell()
                offsets.append(
                    SummaryOffset(Opcode(opcode), at, self._file.write(b"".join(records)))
                )
        offsets_at = self._file.tell()
        self._file.write(b"".join(built(offset) for offset in offsets))
        self._file.write(built(Footer(begin, offsets_at, 0)) + MAGIC)

    def _statistics(self) -> bytes:
        return built(
            Statistics(
                attachment_count=0,
                channel_count=len(self._said[Opcode.CHANNEL]),
                channel_message_counts=self._counts,
                chunk_count=len(self._chunks),
                message_count=sum(self._counts.values()),
                message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
                message_start_time=min(
                    (chunk.message_start_time for chunk in self._chunks), default=0
                ),
                metadata_count=len(self._metadata),
                schema_count=len(self._said[Opcode.SCHEMA]),
            )
        )


def message_record(
    channel: int,
    sequence: int,
    utc_ns: int,
    data: bytes,
) -> bytes:
    """The bytes of a whole message."""
    return _WRITTEN.pack(_IS_MESSAGE, 22 + len(data), channel, sequence, utc_ns, utc_ns) + data


def built(record: Record) -> bytes:
    """The bytes of a record of MCAP."""
    built = RecordBuilder()
    record.write(built)
    return built.end()
