"""``path-handoff merge``: the logs of a run, or of two companions, as one on one clock.

The clock is the first drone's UTC. Another drone's stamps are brought onto it by the offset that
the two measured over their link while they flew (``clock_offset_ns`` of ``/link``), so that
computers whose clocks are an hour apart line up; what is left of an error is stated. Without such a
measurement UTC is taken as it is, and that is said.
"""

from __future__ import annotations

import heapq
import sys
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mcap.records import Metadata
from mcap.writer import Writer

from drivers.interfaces import PartError
from drivers.log.frames import is_frames
from drivers.log.index import MAGIC
from drivers.log.mcap_log import (
    ABOUT,
    OFFSET,
    LogRecord,
    parts,
    read_log,
)
from drivers.log.scan import LoggedMessage, messages
from missions.ground.held import held_file
from missions.ground.options.runs import MergeOptions
from missions.ground.run_folder import REMEDY, claim_result
from missions.look.logs.fetch import fetched
from missions.look.report.records import MERGED
from path.values import frozen

MERGED_SIGN = "merged"  # among what the log says of itself
GUARD = "_guard"
FRAMES = "_frames"
Clock = Sequence[tuple[int, int]]
"""From which UTC of a log on (in order) how much is added to it."""


@frozen
class Aligned:
    """One log's clock against the first one's. ``uncertainty_ns``: None when the offset was not
    measured.
    """

    name: str
    clock: Clock
    uncertainty_ns: int | None

    def utc_ns(self, own_utc_ns: int) -> int:
        k = bisect_right(self.clock, (own_utc_ns, 1 << 63))
        return own_utc_ns + self.clock[max(k - 1, 0)][1]


def run(options: MergeOptions) -> int:
    """``path-handoff merge``. Raises PartError."""
    there = [fetched(each) for each in options.logs]
    logs = named_logs(there)
    out = options.out or (there[0] if there[0].is_dir() else there[0].parent) / MERGED
    if any(out.resolve() == file.resolve() for files in logs.values() for file in files):
        raise PartError(f"{out} is one of the logs: it is not written over", REMEDY)
    claim_result(out, MERGED_SIGN)
    with held_file(out):
        for each in merge(logs, out):
            sys.stdout.write(f"{each.name}: {_told(each)}\n")
    sys.stdout.write(f"{out}\n")
    return 0


def merge(logs: Mapping[str, Sequence[Path]], out: Path) -> list[Aligned]:
    """Write all logs into one; ``logs`` are the parts of each, by the name that goes before its
    topics.

    Raises PartError for what is no log, OSError when it cannot be written.
    """
    refuse_empty(logs)
    aligned = align(logs)
    with out.open("wb") as file:
        writer = Writer(file)
        writer.start(library="path")
        writer.add_metadata(
            ABOUT, {"name": "merged", OFFSET: "0", **{each.name: _told(each) for each in aligned}}
        )
        channels: dict[tuple[str, str], int] = {}
        streams = [_stream(each, logs[each.name]) for each in aligned]
        for utc_ns, name, message in heapq.merge(*streams, key=lambda found: found[0]):
            channel = message.channel
            key = name, channel.topic
            if key not in channels:
                schema = writer.register_schema(
                    channel.schema.name,
                    channel.schema.encoding,
                    channel.schema.data,
                )
                channels[key] = writer.register_channel(
                    f"/{name}{channel.topic}",
                    channel.encoding,
                    schema,
                )
            writer.add_message(channels[key], utc_ns, message.data, utc_ns)
        writer.finish()
    return aligned


def refuse_empty(logs: Mapping[str, Sequence[Path]]) -> None:
    """Raise PartError when nothing can be read of any of the logs."""
    if not any(_has_message(file) for files in logs.values() for file in files):
        names = ", ".join(str(file) for files in logs.values() for file in files)
        raise PartError(
            f"{names}: nothing can be read of it",
            "was anything logged? name another log of the run",
        )


def _has_message(path: Path) -> bool:
    try:
        return next(iter(read_log(path)), None) is not None
    except (OSError, ValueError):
        return True  # which is told as what it is


def align(logs: Mapping[str, Sequence[Path]]) -> list[Aligned]:
    """The clock of every log against the first drone's."""
    records = {name: list(_link_records(files)) for name, files in logs.items()}
    first = next((name for name, found in records.items() if found), None)
    of_drones = {name: _aligned(name, first, records, logs) for name in logs}
    # a guard is on its drone's computer, and so is the camera
    return [
        replace(of_drones.get(_drone(name), each), name=name) for name, each in of_drones.items()
    ]


def _drone(name: str) -> str:
    """The name of a drone's log, of a log of the same computer."""
    return name.removesuffix(GUARD).removesuffix(FRAMES)


def _aligned(
    name: str,
    first: str | None,
    records: Mapping[str, Sequence[LogRecord]],
    logs: Mapping[str, Sequence[Path]],
) -> Aligned:
    """Return a log's alignment, by what this drone measured of the first one's clock.

    Two drones only have each other to measure.
    """
    measured = [r for r in records[name] if r.record["clock_uncertainty_ns"] is not None]
    if (
        first is None
        or name == first
        or not measured
        or len([n for n, found in records.items() if found]) != 2
    ):
        same = name == first or first is None
        return Aligned(name, [(0, 0)], 0 if same else None)
    own_ns = utc_minus_stamp(logs[name])
    first_ns = utc_minus_stamp(logs[first])
    clock = [
        (r.stamp_ns + own_ns, r.record["clock_offset_ns"] + first_ns - own_ns) for r in measured
    ]
    return Aligned(name, clock, max(r.record["clock_uncertainty_ns"] for r in measured))


def _link_records(files: Sequence[Path]) -> Iterator[LogRecord]:
    try:
        yield from (
            record for file in files for record in read_log(file) if record.topic == "/link"
        )
    except (OSError, ValueError) as error:
        raise PartError(str(error), "name logs of PATH, or the folder of a run") from error


def utc_minus_stamp(files: Sequence[Path]) -> int:
    """Return UTC minus a log's stamps, ns, by its first part: those after a restart are of the
    same computer.
    """
    with files[0].open("rb") as file:
        file.seek(len(MAGIC))
        for found in messages(file):
            if isinstance(found, Metadata) and found.name == ABOUT:
                return int(found.metadata[OFFSET])
            break
    return 0


def _stream(aligned: Aligned, files: Sequence[Path]) -> Iterator[tuple[int, str, LoggedMessage]]:
    """A log's messages in the order of their instants; what was logged up to a second late is put
    where it belongs.
    """
    waiting: list[tuple[int, int, LoggedMessage]] = []
    number = 0
    newest_ns = 0
    for path in files:
        with path.open("rb") as file:
            file.seek(len(MAGIC))
            for found in messages(file):
                if isinstance(found, Metadata):
                    continue
                utc_ns = aligned.utc_ns(found.utc_ns)
                newest_ns = max(newest_ns, utc_ns)
                number = number + 1
                heapq.heappush(waiting, (utc_ns, number, found))
                while waiting[0][0] < newest_ns - 1_000_000_000:
                    at_ns, _, message = heapq.heappop(waiting)
                    yield at_ns, aligned.name, message
    while waiting:
        at_ns, _, message = heapq.heappop(waiting)
        yield at_ns, aligned.name, message


def _told(each: Aligned) -> str:
    if each.uncertainty_ns is None:
        return "its UTC as it is: no offset was measured"
    if each.clock == [(0, 0)]:
        return "the clock that all are on"
    return f"moved by {each.clock[-1][1] * 1e-9:+.6f} s, known within {each.uncertainty_ns * 1e-6:.3f} ms"


def named_logs(paths: Sequence[Path]) -> dict[str, list[Path]]:
    """The parts of every log that was named, or is in a folder that was. Raises PartError.

    Every frame of a camera, which is a file of its own, has to be named.
    """
    found: dict[str, list[Path]] = {}
    for path in paths:
        files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
        for file in files:
            if is_frames(file) and path.is_dir():
                continue  # a hundred times as much as everything else
            if file.name != MERGED and not file.stem.rpartition(".")[2].isdecimal():
                found[file.stem.replace(".", "_")] = parts(file.parent, file.stem) or [file]
    if not found:
        raise PartError(
            f"{', '.join(map(str, paths))}: there is no log",
            "name .mcap files, or the folder of a run",
        )
    order = sorted(
        found,
        key=lambda name: (
            name.endswith((GUARD, FRAMES)) or name == "world",
            name != "sender",
            name,
        ),
    )
    return {name: found[name] for name in order}
