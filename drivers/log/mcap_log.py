"""The log of a program: one MCAP file, readable to the last record whatever ended it.

PATH's own records are JSON, with a JSON Schema each (``drivers.log.topics``); images, and what
viewers draw, are Foxglove's messages (``drivers.log.foxglove``). Stamps in the file are UTC; the
program's own clock, which is what records are written and read with, differs by a constant that the
file's metadata tell.

Records are written unbuffered, each with one system call, by a thread that does nothing else: a
killed program loses what that thread had not come to, milliseconds as a rule, and a disk that
stands still holds up no loop (``drivers.written_behind``). Only a run in virtual time, which cannot
lose a drone, buffers them. A file that is closed is then put into chunks with an index
(``drivers.log.index``). Nothing in the log of a run in
virtual time depends on the wall clock or the machine.
"""

from __future__ import annotations

import dataclasses
import errno
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgspec
import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from drivers.clock import wall_offset_ns
from drivers.log.index import ABOUT, MAGIC, OFFSET, ChunkedFile, built, message_record
from drivers.log.loose_file import LooseFile
from drivers.log.protobuf import fields
from drivers.log.scan import messages
from drivers.log.topics import schema_of
from path.arrays import Image

if TYPE_CHECKING:
    from drivers.interfaces import Frame
    from drivers.log import foxglove
    from drivers.log.frames import FrameRecorder

JPEG_QUALITY = 90
RECORDING_PERIOD_NS = 1_000_000_000
VIRTUAL_EPOCH_NS = 1_767_225_600_000_000_000
"""UTC of the beginning of every run in virtual time: 2026-01-01."""
IMAGE_SCHEMA = "foxglove.CompressedImage"


class McapLog:
    """A ``drivers.interfaces.Log``. Never raises: what goes wrong is kept in ``failed``, and the
    flight goes on.

    Numbers that are not finite become null. NumPy scalars and arrays, enums (by value) and
    dataclasses may be in one.
    """

    def __init__(
        self,
        path: Path,
        name: str = "",
        *,
        utc_minus_stamp_ns: int | None = None,
        buffered: bool = False,
    ) -> None:
        """``name``: of the drone, for the frames that viewers draw.

        ``utc_minus_stamp_ns``: UTC minus the clock of the stamps; None: that is this computer's
        monotonic one. ``buffered``: what was logged last is lost when the process is killed; for
        runs in virtual time.
        """
        from drivers.log.foxglove import Standards  # noqa: PLC0415 (whoever only reads logs does not need it)

        self._failed: str | None = None
        self._path = path
        self._name = name
        self._buffered = buffered
        self._recorder: FrameRecorder | None = None
        self._recording_told_ns = 0
        self._standards = Standards(name)
        self._utc_ns = (
            wall_offset_ns(time.monotonic_ns) if utc_minus_stamp_ns is None else utc_minus_stamp_ns
        )
        self._channels: dict[str, int] = {}
        self._count = 0
        self._encode = msgspec.json.Encoder(enc_hook=encode_other).encode
        self._file: LooseFile | ChunkedFile | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = ChunkedFile(path) if buffered else LooseFile(path)
            about = Metadata(name=ABOUT, metadata={"name": name, OFFSET: str(self._utc_ns)})
            self._file.say(Opcode.HEADER, built(Header("", "path")))
            self._file.say(Opcode.METADATA, built(about))
        except OSError as error:
            self._fail(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def failed(self) -> str | None:
        """The first thing that went wrong, of the log or of the frames beside it."""
        if self._file is not None:
            self._note_lost(self._file)
        return self._failed or (None if self._recorder is None else self._recorder.failed)

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        """One JSON record with a stamp of the program's clock."""
        if self._file is None:
            return
        try:
            utc_ns = self._utc(stamp_ns)
            data = self._encode(
                {name: value for name, value in record.items() if value is not None}
            )
            if topic not in self._channels:
                self._register(
                    topic, "json", "path" + topic.replace("/", "."), "jsonschema", schema_of(topic)
                )
            self._write(topic, utc_ns, data)
            for standard in self._standards.of(topic, utc_ns, record):
                self._message(utc_ns, *standard)
        except OSError as error:
            self._fail(error)
        # whatever was wrong with this record: the others go on, and so does the flight
        except Exception as error:
            self._failed = self._failed or f"{topic}: {error}"

    def image(self, topic: str, stamp_ns: int, image: Image) -> None:
        """One BGR image, shape (h, w, 3), as JPEG."""
        if self._file is None:
            return
        jpeg = _jpeg(image)
        if jpeg is None:
            self._failed = (
                self._failed or f"{topic}: the image could not be encoded as JPEG, of 8 bits"
            )
            return
        from drivers.log.foxglove_primitives import compressed_image  # noqa: PLC0415

        try:
            utc_ns = self._utc(stamp_ns)
            self._message(utc_ns, topic, compressed_image(utc_ns, self._standards.camera, jpeg))
            for standard in self._standards.of_image(utc_ns):
                self._message(utc_ns, *standard)
        except OSError as error:
            self._fail(error)
        except Exception as error:
            self._failed = self._failed or f"{topic}: {error}"

    def frame(self, frame: Frame) -> None:
        """One frame, whole, into the file beside the log (``drivers.log.frames``); or it is
        dropped.
        """
        if self._recorder is None:
            if self._file is None:
                return
            from drivers.log.frames import FrameRecorder  # noqa: PLC0415 (few programs record frames)

            self._recorder = FrameRecorder(
                self._path, self._name, self._utc_ns, waits=self._buffered
            )
        self._recorder.take(frame)
        if frame.stamp_ns - self._recording_told_ns >= RECORDING_PERIOD_NS:
            self._recording_told_ns = frame.stamp_ns
            self._tell_recording(frame.stamp_ns)

    def settled(self) -> str | None:
        """Return what went wrong once all that was written is on its way to the disk, as far as
        that is soon.
        """
        if self._file is not None:
            try:
                self._file.settle()
            except OSError as error:
                self._fail(error)
        return self.failed

    def close(self) -> None:
        """Close, and put the file into chunks with an index. Closing twice does nothing."""
        file = self._file
        self._file = None
        if file is None:
            return
        there = self._path.exists()
        try:
            file.close()
        except OSError as error:
            self._fail(error)
        self._note_lost(file)
        if not there:
            self._fail(
                FileNotFoundError(
                    errno.ENOENT, "it was taken away while it was written", str(self._path)
                )
            )
        if self._recorder is not None:
            self._recorder.close()

    def _note_lost(self, file: LooseFile | ChunkedFile) -> None:
        if file.lost and self._failed is None:
            self._failed = (
                f"log not whole: the disk stood still, and {file.lost} records found no room"
            )

    def _tell_recording(self, stamp_ns: int) -> None:
        assert self._recorder is not None
        counts = self._recorder.counts
        record = {"taken": counts.taken, "dropped": counts.dropped, "bytes": counts.bytes}
        if not self._buffered:  # in virtual time nothing in a log is of the machine
            record["spent_ns"] = counts.spent_ns
        self.write("/recording", stamp_ns, record)

    def _utc(self, stamp_ns: int) -> int:
        if not 0 <= stamp_ns < 1 << 63:
            raise ValueError(f"stamp {stamp_ns} is not of a clock")
        return stamp_ns + self._utc_ns

    def _message(self, utc_ns: int, topic: str, message: foxglove.Message) -> None:
        if topic not in self._channels:
            schema = type(message).get_schema()
            self._register(topic, "protobuf", schema.name, schema.encoding, schema.data)
        self._write(topic, utc_ns, message.encode())

    def _write(self, topic: str, utc_ns: int, data: bytes) -> None:
        assert self._file is not None
        self._count += 1
        channel = self._channels[topic]
        self._file.message(channel, utc_ns, message_record(channel, self._count, utc_ns, data))

    def _register(self, topic: str, encoding: str, name: str, kind: str, schema: bytes) -> None:
        assert self._file is not None
        number = len(self._channels) + 1
        self._file.say(Opcode.SCHEMA, built(Schema(number, schema, kind, name)))
        self._file.say(Opcode.CHANNEL, built(Channel(number, topic, encoding, {}, number)))
        self._channels[topic] = number

    def _fail(self, error: OSError) -> None:
        """End the log: from here on nothing is written, and what is in the file stays readable."""
        self._failed = f"log not written: {error.strerror or error}" + (
            f": {error.filename}" if error.filename else ""
        )
        file = self._file
        self._file = None
        if file is not None:
            with suppress(OSError):
                file.close()


def virtual_log(path: Path, name: str, clock_offset_ns: int = 0) -> McapLog:
    """The log of a program in virtual time; ``clock_offset_ns``: its clock minus the run's time."""
    return McapLog(path, name, utc_minus_stamp_ns=VIRTUAL_EPOCH_NS - clock_offset_ns, buffered=True)


def _jpeg(image: Image) -> bytes | None:
    """None for what is no image of 8 bits: OpenCV would cut the bits of others off, and only print
    a warning.
    """
    import cv2  # noqa: PLC0415 (a log without images does not need it)

    if image.dtype != np.uint8:
        return None
    try:
        done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    except cv2.error:
        return None
    return jpeg.tobytes() if done else None


def encode_other(value: Any) -> Any:
    """Return a value as JSON can hold it; an ``enc_hook`` of msgspec."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"cannot log a {type(value).__name__}")


def new_part(folder: Path, name: str) -> Path:
    """The file of a program's log: ``NAME.mcap``, after a restart ``NAME.2.mcap`` and so on. It is
    there from now on.

    An earlier program's log is never written over; where nothing can be written the log will say
    so.
    """
    files = (
        folder / (f"{name}.mcap" if number == 1 else f"{name}.{number}.mcap") for number in count(1)
    )
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
    utc_ns: int = dataclasses.field(default=0, compare=False)


def read_log(path: Path, topics: Collection[str] | None = None) -> Iterator[LogRecord]:
    """PATH's own records and the images of a log in the order they were written, up to where the
    file ends.

    That may be in the middle of one. Stamps are those they were written with; what a record leaves
    out is null. ``topics``: those that are read; None: all.

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
        offset_ns = 0
        decode = msgspec.json.Decoder().decode
        try:
            for found in messages(file):
                if isinstance(found, Metadata):
                    if found.name == ABOUT:
                        offset_ns = int(found.metadata.get(OFFSET, offset_ns))
                    continue
                if topics is not None and found.channel.topic not in topics:
                    continue
                if found.channel.encoding == "json":
                    record = {**found.channel.blank, **decode(found.data)}
                elif found.channel.schema.name == IMAGE_SCHEMA:
                    record = image_record(found.data)
                else:
                    continue
                stamp_ns = found.utc_ns - offset_ns
                yield LogRecord(found.channel.topic, stamp_ns, record, found.utc_ns)
        except (UnicodeDecodeError, msgspec.DecodeError):
            return  # the process that wrote it was killed here


def image_record(data: bytes) -> dict[str, Any]:
    """A Foxglove CompressedImage: ``frame_id``, ``format`` and ``data``. Raises ValueError for what
    is none.
    """
    names = {2: "data", 3: "format", 4: "frame_id"}
    record: dict[str, Any] = {"data": b"", "format": "", "frame_id": ""}
    for number, value in fields(data):
        if number in names and isinstance(value, bytes):
            record[names[number]] = value if number == 2 else value.decode()
    return record


def decode_image(record: Mapping[str, Any]) -> Image:
    """The pixels, BGR, of an image read from a log. Raises ValueError when it is none."""
    import cv2  # noqa: PLC0415

    pixels = cv2.imdecode(np.frombuffer(record["data"], np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError("not an image")
    return np.asarray(pixels, np.uint8)
