"""The log of a role: one MCAP file, JSON records, readable to the last record whatever ended the process.

Records are written unchunked and unbuffered, each with one system call, so that a killed process loses nothing it has
logged; only a run in virtual time, which cannot lose a drone, buffers them. Nothing in the file depends on the wall
clock or the machine: the same records give the same bytes.
"""

from __future__ import annotations

import base64
import dataclasses
import struct
from collections.abc import Iterator, Mapping
from io import FileIO
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
JPEG_QUALITY = 90
BUFFER_BYTES = 1 << 16
IMAGE_SCHEMA = "foxglove.CompressedImage"


class McapLog:
    """A ``drivers.interfaces.Log``. Never raises: what goes wrong is kept in ``failed``, and the flight goes on.

    Numbers that are not finite become null. NumPy scalars and arrays, enums (by value) and dataclasses may be in one.
    """

    def __init__(self, path: Path, frame: str = "", *, buffered: bool = False) -> None:
        """``frame`` names the camera frame of logged images, such as ``c1``.

        ``buffered``: what was logged last is lost when the process is killed; for runs in virtual time.
        """
        self.failed: str | None = None
        self._frame = frame
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._encoder = msgspec.json.Encoder(enc_hook=encode_other)
        self._file: _File | None = None
        self._writer: Writer | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _File(path, BUFFER_BYTES if buffered else 0)
            output = cast("IO[bytes]", self._file)  # the writer needs no more of it than write and tell
            writer = Writer(output, use_chunking=False, compression=CompressionType.NONE, index_types=IndexType.NONE)
            writer.start(profile="", library="path")
            self._writer = writer
        except OSError as error:
            self._fail(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self.close()

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        """One JSON record with a stamp of the role's clock."""
        self._write(topic, "path" + topic.replace("/", "."), stamp_ns, record)

    def image(self, topic: str, stamp_ns: int, image: NDArray[np.uint8]) -> None:
        """One BGR image, shape (h, w, 3), as JPEG."""
        if self._writer is None:
            return
        jpeg = _jpeg(image)
        if jpeg is None:
            self.failed = self.failed or f"{topic}: the image could not be encoded"
            return
        record = {
            "timestamp": {"sec": stamp_ns // 1_000_000_000, "nsec": stamp_ns % 1_000_000_000},
            "frame_id": self._frame,
            "format": "jpeg",
            "data": base64.b64encode(jpeg).decode("ascii"),
        }
        self._write(topic, IMAGE_SCHEMA, stamp_ns, record)

    def close(self) -> None:
        """Write the summary and close. Closing twice does nothing."""
        if self._writer is not None:
            try:
                self._writer.finish()
            except OSError as error:
                self._fail(error)
            self._writer = None
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._fail(error)
            self._file = None

    def _write(self, topic: str, schema: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        if self._writer is None:
            return
        try:
            if not 0 <= stamp_ns < 1 << 64:
                raise ValueError(f"stamp {stamp_ns} is not of a clock")
            data = self._encoder.encode(record)
            channel = self._channels.get(topic) or self._register(self._writer, topic, schema)
            count = self._counts[topic] = self._counts[topic] + 1
            self._writer.add_message(channel, stamp_ns, data, stamp_ns, count)
        except OSError as error:
            self._fail(error)
        except (TypeError, ValueError, OverflowError, RecursionError) as error:  # this record only; others go on
            self.failed = self.failed or f"{topic}: {error}"

    def _register(self, writer: Writer, topic: str, schema: str) -> int:
        schema_id = writer.register_schema(schema, "jsonschema", b'{"type":"object"}')
        self._channels[topic] = writer.register_channel(topic, "json", schema_id)
        self._counts[topic] = 0
        return self._channels[topic]

    def _fail(self, error: OSError) -> None:
        """From here on nothing is written: what is in the file stays readable."""
        self.failed = f"log not written: {error.strerror or error}" + (f": {error.filename}" if error.filename else "")
        self._writer = None


class _File:
    """The two methods of a file that the MCAP writer uses; a write is whole or raises. ``buffer`` bytes may wait."""

    def __init__(self, path: Path, buffer: int) -> None:
        self._raw = FileIO(path, "wb")
        self._buffer = buffer
        self._waiting = bytearray()
        self._position = 0

    def write(self, data: bytes) -> int:
        self._position += len(data)
        self._waiting += data
        if len(self._waiting) > self._buffer:
            self._flush()
        return len(data)

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, bytearray()
        left = memoryview(waiting)
        while left:
            written = self._raw.write(left)
            left = left[written:]

    def tell(self) -> int:
        return self._position

    def close(self) -> None:
        try:
            self._flush()
        finally:
            self._raw.close()


def _jpeg(image: NDArray[np.uint8]) -> bytes | None:
    import cv2  # noqa: PLC0415 (a log without images does not need it)

    try:
        done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    except cv2.error:
        return None
    return jpeg.tobytes() if done else None


def encode_other(value: Any) -> Any:
    """As JSON can hold it; an ``enc_hook`` of msgspec."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"cannot log a {type(value).__name__}")


def new_part(folder: Path, name: str) -> Path:
    """The file of a program's log: ``NAME.mcap``, after a restart ``NAME.2.mcap`` and so on. It is there from now on.

    An earlier program's log is never written over; where nothing can be written the log will say so.
    """
    files = (folder / (f"{name}.mcap" if number == 1 else f"{name}.{number}.mcap") for number in count(1))
    path = next(file for file in files if not file.exists())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.open("xb").close()
    except FileExistsError:
        return new_part(folder, name) if path.exists() else path  # another program was quicker
    except OSError:
        pass
    return path


def parts(folder: Path, name: str) -> list[Path]:
    """The logs that the programs of one role wrote into a folder, in their order."""
    numbered = [(int(path.stem.rpartition(".")[2]), path) for path in folder.glob(f"{name}.*.mcap")
                if path.stem.rpartition(".")[2].isdecimal()]  # fmt: skip
    first = folder / f"{name}.mcap"
    return [*([first] if first.is_file() else []), *(path for _, path in sorted(numbered))]


@dataclasses.dataclass(frozen=True, slots=True)
class LogRecord:
    topic: str
    stamp_ns: int
    record: dict[str, Any]


def read_log(path: Path) -> Iterator[LogRecord]:
    """The records of a log in the order they were written, up to where the file ends, be it in the middle of one.

    Raises:
        OSError: when the file cannot be read.
        ValueError: when it is no MCAP file.
    """
    with path.open("rb") as file:
        begin = file.read(len(MAGIC))
        if begin != MAGIC:
            if MAGIC.startswith(begin):
                return  # the process was killed before it had written anything
            raise ValueError(f"{path} is not an MCAP file")
        topics: dict[int, str] = {}
        records = StreamReader(file, skip_magic=True).records
        decode = msgspec.json.Decoder().decode
        while True:
            try:
                record = next(records)
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    yield LogRecord(topics[record.channel_id], record.log_time, decode(record.data))
            except StopIteration:
                return
            except (McapError, struct.error, UnicodeDecodeError, msgspec.DecodeError):
                return  # the process that wrote it was killed here


def decode_image(record: Mapping[str, Any]) -> NDArray[np.uint8]:
    """The pixels, BGR, of a record written by ``McapLog.image``. Raises ValueError when it is none."""
    import cv2  # noqa: PLC0415

    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(record["data"]), np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError("not an image")
    return np.asarray(pixels, np.uint8)
