"""A session with beacons: they are listened to while the drones fly, and everything is kept as it
came.

A session's folder has the logs of both roles and the beacons' record, ``beacons.mcap`` (or
``beacons.csv``, the Dashboard's own log or a list from another program); ``world.mcap`` and
``beacons.truth.json`` only where a harness knows them.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from drivers.beacons.log import TRUTH_FILE, BeaconTruth, read_truth, write_truth
from drivers.beacons.record import BeaconRecorder, read_any
from drivers.beacons.stream import MarvelmindStream
from drivers.clock import SystemClock
from drivers.interfaces import BeaconError, BeaconFix, Beacons, PartError
from drivers.rig.parts import PartSpec, Rig, create, import_factory, part_context
from missions.fly.handoff.flight import fly_once
from missions.look.report.records import RECEIVER_LOG, SENDER_LOG, WORLD_LOG, load_facts
from missions.trials.flights.dynamic.flight import BEACON_LIST, BEACON_RECORD, reference_of
from path.messages import Role
from path.values import frozen

SILENT_S = 2.0  # without a position before it is said


@frozen
class BeaconSession:
    """A session's folder, and the beacons as they were heard.

    Attributes:
        notes: what a reader has to know: silences, an outcome other than a commit.
        truth: None where nobody knows it.
    """

    folder: Path
    fixes: tuple[BeaconFix, ...]
    notes: tuple[str, ...]
    truth: BeaconTruth | None


def load_session(folder: Path) -> BeaconSession:
    """A session from its folder. Raises PartError for one that is not whole."""
    missing = [name for name in (SENDER_LOG, RECEIVER_LOG) if not (folder / name).is_file()]
    records = [folder / name for name in (BEACON_RECORD, BEACON_LIST) if (folder / name).is_file()]
    if missing or not records:
        missing += [] if records else [f"{BEACON_RECORD} or {BEACON_LIST}"]
        raise PartError(
            f"{folder} is no session of beacons: {', '.join(missing)} missing",
            "put both roles' logs and the beacons' record into one folder and name it with --logs",
        )
    facts = load_facts(folder)
    notes = (
        ()
        if facts is None or facts.outcome == "committed"
        else (f"The flight ended as '{facts.outcome}'.",)
    )
    return BeaconSession(
        folder,
        tuple(read_any(records[0])),
        notes,
        read_truth(folder / TRUTH_FILE),
    )


def fly_session(
    rig: Rig,
    seed: int,
    folder: Path,
) -> BeaconSession:
    """Fly the rig once and listen to its beacons. Raises PartError: the rig cannot, or the beacons
    give nothing.
    """
    reference = reference_of(rig)
    if reference.beacons is None:
        facts = fly_once(rig, seed, (), folder, lambda _: None)
        fixes = _hear_afterwards(rig, seed, folder)
        notes: tuple[str, ...] = ()
    else:
        with Listener(rig, reference.beacons, folder / BEACON_RECORD) as listener:
            facts = fly_once(rig, seed, (), folder, lambda _: None)
        fixes = listener.fixes
        notes = tuple(listener.notes)
    if facts.outcome != "committed":
        notes += (f"The flight ended as '{facts.outcome}'.",)
    return BeaconSession(folder, tuple(fixes), notes, read_truth(folder / TRUTH_FILE))


def _hear_afterwards(
    rig: Rig,
    seed: int,
    folder: Path,
) -> list[BeaconFix]:
    """Make the bytes from the flight's truth in virtual time; what takes them is what takes a
    port's.
    """
    if "beacons" not in rig.trials:
        raise PartError(
            f"{rig.where('[reference]')}: nobody listens to the beacons",
            'name the part: [reference.beacons] with factory = "drivers.beacons.marvelmind:Marvelmind" and ports',
        )
    stream = MarvelmindStream()
    recorder = BeaconRecorder(folder / BEACON_RECORD, 0.0, virtual=True)
    fixes = list[BeaconFix]()

    def hear(
        port: str,
        arrival_ns: int,
        data: bytes,
    ) -> None:
        recorder.write(port, arrival_ns, data)
        fixes.extend(stream.feed(port, arrival_ns, data))

    listen = import_factory(rig.trials["beacons"], rig.where("trials.beacons"))
    write_truth(
        folder / TRUTH_FILE, listen(folder / WORLD_LOG, hear, seed, reference_of(rig).mounted)
    )
    recorder.close()
    return fixes


@runtime_checkable
class _HasBytes(Protocol):
    """Beacons on ports; what comes from a file is on record already."""

    on_bytes: Callable[[str, int, bytes], None] | None


class Listener:
    """Listens to beacons in a thread of its own, as a flight takes this one; entered and left
    around the flight.

    Attributes:
        fixes: positions so far.
        notes: silences and what ended the listening, in words.
    """

    def __init__(
        self,
        rig: Rig,
        spec: PartSpec,
        file: Path,
    ) -> None:
        context = replace(
            part_context(rig, Role.RECEIVER),
            clock=SystemClock(SystemClock.Config(), None),  # type: ignore[arg-type]
        )
        self._beacons: Beacons = create(spec, context)
        self._file = file
        # a flight clears its folder of earlier logs
        self._partial = file.with_name(f"{file.name}.part")
        self._recorder = BeaconRecorder(self._partial, float(spec.options.get("latency_s", 0.0)))
        self._stop = threading.Event()
        self._running: tuple[asyncio.AbstractEventLoop, asyncio.Task[None]] | None = None
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._listen()),
            name="listener",
            daemon=True,
        )
        self.fixes: list[BeaconFix] = []
        self.notes: list[str] = []

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        """Raise BeaconError when not one position was heard, or the record is not whole."""
        self._stop.set()
        if self._running is not None:
            loop, task = self._running
            with suppress(RuntimeError):  # it has ended by itself
                loop.call_soon_threadsafe(task.cancel)
        self._thread.join()
        self._recorder.close()
        if isinstance(self._beacons, _HasBytes):
            self._partial.replace(self._file)
        else:
            self._partial.unlink()
        if error is None and not self.fixes:
            raise BeaconError(
                "; ".join(self.notes) or "no position of a beacon was heard", "docs/beacons.md"
            )

    async def _listen(self) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._running = asyncio.get_running_loop(), task
        if isinstance(self._beacons, _HasBytes):
            self._beacons.on_bytes = self._recorder.write
        try:
            async with self._beacons as beacons:
                while not self._stop.is_set() and await self._heard(beacons):
                    pass
        except PartError as error:
            self.notes.append(str(error))
        except asyncio.CancelledError:
            if not self._stop.is_set():
                raise

    async def _heard(self, beacons: Beacons) -> bool:
        """One more position, or one more silence, which is noted once; False at the end of a
        record.
        """
        try:
            fix = await beacons.read(SILENT_S)
        except BeaconError as error:
            if str(error) not in self.notes:
                self.notes.append(str(error))
            return not error.final
        if fix is not None:
            self.fixes.append(fix)
        return fix is not None


def record_session(
    rig: Rig,
    folder: Path,
    seconds: float,
    show: Callable[[str], None],
) -> tuple[BeaconFix, ...]:
    """Listen without flying, as in the field: until ``seconds`` have passed (0: for ever) or
    Ctrl-C.

    Raises PartError for a rig without beacons and for beacons that give nothing.
    """
    reference = reference_of(rig)
    if reference.beacons is None:
        raise PartError(
            f"{rig.where('[reference]')}: missing table 'beacons'", "name the part that listens"
        )
    end = threading.Event()
    with Listener(rig, reference.beacons, folder / BEACON_RECORD) as listener:
        left_s = seconds or float("inf")
        try:
            while left_s > 0.0 and not end.wait(min(1.0, left_s)):
                left_s -= 1.0
                rated = ", ".join(
                    f"{name} {_of(listener.fixes, own.address)}"
                    for name, own in reference.mounted.items()
                )
                show(f"positions: {rated}{'; ' + listener.notes[-1] if listener.notes else ''}")
        except KeyboardInterrupt:
            show("recording ends")
    return tuple(listener.fixes)


def _of(fixes: list[BeaconFix], address: int) -> int:
    return sum(fix.address == address for fix in fixes)
