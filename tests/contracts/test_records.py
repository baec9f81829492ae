"""The contract of every RecordStore, Log and Clock."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.interfaces import Clock, Kept, Log, RecordStore
from drivers.log.mcap_log import McapLog
from drivers.log.state_file import MemoryStore, StateFile
from hil.harness.virtual_time import run_virtual
from hil.world.clocks import OffsetClock, OffsetClockConfig
from path.messages import AbortReason, Role
from path.protocol.values import Handoff, SenderRecord

FIRST = SenderRecord(2)
SECOND = SenderRecord(
    3, "released", Handoff(7, 3, 1), 0xFFFF_FFFF, 1 << 60, (1 << 60) + 5, AbortReason.PILOT
)

# --- records that outlive the program


def memory(folder: Path) -> RecordStore:
    del folder
    return MemoryStore()


def file(folder: Path) -> RecordStore:
    return StateFile(folder / "sender.state.json", Role.SENDER)


STORES = pytest.mark.parametrize("store_of", [memory, file])
StoreOf = Callable[[Path], RecordStore]


@STORES
def test_what_was_saved_last_is_loaded_and_before_that_nothing(
    store_of: StoreOf, tmp_path: Path
) -> None:
    store = store_of(tmp_path)
    assert store.load() is None
    for record in (FIRST, SECOND, SECOND):
        store.save(record)
        assert store.load() == store.load() == Kept(record, same_clock=True)


@STORES
def test_a_save_that_nobody_waits_for_is_done_when_it_says_so(
    store_of: StoreOf, tmp_path: Path
) -> None:
    store = store_of(tmp_path)
    for record in (FIRST, SECOND):
        saving = store.begin_save(record)
        assert not saving.cancel()  # nobody can take it back
        assert saving.result(timeout=60.0) is None
        assert store.load() == Kept(record, same_clock=True)


# --- logs


def at_once(folder: Path) -> McapLog:
    return McapLog(folder / "a.mcap")


def buffered(folder: Path) -> McapLog:
    return McapLog(folder / "a.mcap", buffered=True)


def full_disk(folder: Path) -> McapLog:
    del folder
    return McapLog(Path("/dev/full"))


def no_file(folder: Path) -> McapLog:
    return McapLog(folder)


LOGS = pytest.mark.parametrize("log_of", [at_once, buffered, full_disk, no_file])
BAD_IMAGES: list[Any] = [
    np.zeros((0, 0, 3), np.uint8),
    np.zeros((4, 0, 3), np.uint8),
    np.zeros((4, 4, 7), np.uint8),
    np.zeros(3, np.uint8),
    np.zeros((4, 4, 3)) + math.nan,
    np.zeros((4, 4, 3), np.int64),
]


@LOGS
def test_a_log_never_raises(log_of: Callable[[Path], McapLog], tmp_path: Path) -> None:
    log = log_of(tmp_path)
    flight: Log = log
    loop: list[Any] = []
    loop.append(loop)
    records: list[dict[str, Any]] = [
        {"x": math.nan, "array": np.eye(3), "none": None},
        {"object": object()},
        {"loop": loop},
        {"lone surrogate": "\ud800"},
        {"huge": 1 << 80},
    ]
    for record in records:
        flight.write("/state", 1, record)
    flight.write("/state", -1, {})
    flight.write("/state", 1 << 64, {})
    for image in BAD_IMAGES:
        flight.image("/image", 1, image)
    log.close()
    flight.write("/state", 2, {})
    flight.image("/image", 2, np.zeros((4, 4, 3), np.uint8))
    log.close()
    assert log.failed is not None


# --- clocks


def system() -> Clock:
    none: Any = None
    return SystemClock(SystemClock.Config(), none)


def offset() -> Clock:
    none: Any = None
    return OffsetClock(OffsetClockConfig(1234.5), none)


@pytest.mark.parametrize(
    ("clock_of", "runner"), [(system, asyncio.run), (offset, run_virtual), (offset, asyncio.run)]
)
def test_a_clock_counts_whole_nanoseconds_forwards_as_fast_as_the_loop(
    clock_of: Callable[[], Clock], runner: Callable[[Any], Any]
) -> None:
    async def main() -> None:
        clock, loop = clock_of(), asyncio.get_running_loop()
        before_s, begin_ns, begin_s = loop.time(), clock.now_ns(), loop.time()
        stamps: list[int] = []
        for _ in range(20):
            stamps.append(clock.now_ns())
            await asyncio.sleep(0.002)
        end_s, end_ns, after_s = loop.time(), clock.now_ns(), loop.time()
        assert all(type(stamp) is int and stamp >= 0 for stamp in stamps)
        assert all(later > earlier for earlier, later in pairwise(stamps))
        # between what was looked at just before and just after
        passed_s = (end_ns - begin_ns) * 1e-9
        assert 0.7 * (end_s - begin_s) <= passed_s <= 1.3 * (after_s - before_s)

    runner(main())
