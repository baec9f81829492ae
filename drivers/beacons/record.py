"""A recorded session of beacons: the bytes of the serial ports as they came, played back through
the same parser.

The file is a log (``drivers.log.mcap_log``): topic ``/serial``, stamp of arrival by the listener's
clock, fields ``port`` and ``bytes`` (hexadecimal); once, first, ``/beacons`` with what the parser
was told (``latency_s``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

from drivers.beacons.dashboard_log import is_dashboard_log, read_dashboard_log
from drivers.beacons.log import read_beacons
from drivers.beacons.stream import MarvelmindStream
from drivers.interfaces import BeaconError, BeaconFix
from drivers.log.mcap_log import McapLog, read_log, virtual_log
from drivers.rig.parts import PartContext
from path.values import frozen


class BeaconRecorder:
    """Writes a record while the ports are read. ``write`` fits ``Marvelmind.on_bytes`` and never
    raises.
    """

    def __init__(
        self,
        file: Path,
        latency_s: float,
        *,
        virtual: bool = False,
    ) -> None:
        """``virtual``: what is written was heard in virtual time."""
        self._log = virtual_log(file, "beacons") if virtual else McapLog(file, "beacons")
        self._log.write("/beacons", 0, {"latency_s": latency_s})

    def write(
        self,
        port: str,
        arrival_ns: int,
        data: bytes,
    ) -> None:
        self._log.write("/serial", arrival_ns, {"port": port, "bytes": data.hex()})

    def close(self) -> None:
        """Raise BeaconError when the record is not whole."""
        self._log.close()
        if self._log.failed is not None:
            raise BeaconError(
                f"the record of the beacons is not whole: {self._log.failed}", "free some disk"
            )


def replay(file: Path, stream: MarvelmindStream | None = None) -> Iterator[BeaconFix]:
    """The positions of a record, as they came live. Raises BeaconError for a file that is none,
    OSError.

    Args:
        stream: takes the bytes, for who wants its counters; one of its own otherwise.
    """
    records = _records(file)
    told = next(records, None)
    if told is None or told.topic != "/beacons":
        raise BeaconError(f"{file} is no record of beacons", "name the beacons.mcap of a session")
    parser = stream or MarvelmindStream(float(told.record["latency_s"]))
    for record in records:
        if record.topic == "/serial":
            yield from parser.feed(
                record.record["port"],
                record.stamp_ns,
                bytes.fromhex(record.record["bytes"]),
            )


def _records(file: Path):
    try:
        yield from read_log(file)
    except ValueError as error:
        raise BeaconError(
            f"{file} is no record of beacons: {error}", "name the beacons.mcap of a session"
        ) from error


def read_any(file: Path) -> list[BeaconFix]:
    """All positions of a session: a record of its ports (``.mcap``), a list of positions, or the
    Dashboard's own log.

    Raises:
        BeaconError: for a file that is none of them.
        OSError: it cannot be read.
    """
    if file.suffix == ".mcap":
        return list(replay(file))
    return read_dashboard_log(file) if is_dashboard_log(file) else read_beacons(file)


@frozen
class RecordedBeaconsConfig:
    """``file``: a record of ports (``.mcap``), a list of positions or the Dashboard's own log
    (``.csv``).
    """

    file: Path


class RecordedBeacons:
    """Implements ``drivers.interfaces.Beacons`` from a file, as fast as it is read."""

    Config = RecordedBeaconsConfig

    def __init__(self, config: RecordedBeaconsConfig, context: PartContext) -> None:
        del context
        self._file = config.file
        self._fixes: Iterable[BeaconFix] | None = None

    async def __aenter__(self) -> Self:
        """Raise BeaconError for a file that cannot be read."""
        try:
            self._fixes = iter(read_any(self._file))
        except OSError as error:
            raise BeaconError(
                f"{self._file}: {error.strerror}", "name the file of a session"
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        self._fixes = None

    async def read(self, timeout_s: float) -> BeaconFix | None:
        """The next position; None after the last."""
        del timeout_s
        if self._fixes is None:
            raise BeaconError("the beacons are not open", "enter them with `async with` first")
        return next(iter(self._fixes), None)
