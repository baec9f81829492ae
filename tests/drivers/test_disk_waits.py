"""What a thread stood in the kernel for is told apart from what it did, or slept, by itself."""

from __future__ import annotations

import asyncio
import ctypes
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.disk_waits import DiskWaits
from drivers.lateness import watch_lateness

LATE_NS = 600_000_000
pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="only Linux tells what a thread waits for"
)


def stand(folder: Path, seconds: float) -> None:
    """Stand in the kernel as for a disk, without one: a child that is begun by ``posix_spawn`` keeps
    its parent there until it has opened what it is told to, and that is a pipe without a writer.
    """
    pipe = folder / "pipe"
    if not pipe.exists():
        os.mkfifo(pipe)
    c = ctypes.CDLL(None)
    actions = ctypes.create_string_buffer(512)
    c.posix_spawn_file_actions_init(actions)
    c.posix_spawn_file_actions_addopen(actions, 0, os.fsencode(pipe), os.O_RDONLY, 0)
    child = ctypes.c_int()
    argv = (ctypes.c_char_p * 2)(b"true", None)
    opener = threading.Timer(seconds, lambda: os.close(os.open(pipe, os.O_WRONLY)))
    opener.start()
    spawned = c.posix_spawn(ctypes.byref(child), b"/bin/true", actions, None, argv, None)
    opener.join()
    assert spawned == 0
    os.waitpid(child.value, 0)


def compute(seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        sum(range(1000))


def test_a_thread_that_stood_in_the_kernel_says_for_how_long(tmp_path: Path) -> None:
    waits = DiskWaits()
    stand(tmp_path, 0.5)
    told_ns = waits.look(LATE_NS)
    assert 0.3e9 < told_ns <= LATE_NS
    assert waits.look(LATE_NS) < 0.1e9  # it is told once
    stand(tmp_path, 0.2)
    assert waits.look(50_000_000) <= 50_000_000  # not more than it was late
    waits.close()


@pytest.mark.parametrize("own", [time.sleep, compute])
def test_a_thread_that_slept_or_computed_stood_for_nothing(own: Callable[[float], None]) -> None:
    waits = DiskWaits()
    own(0.4)
    assert waits.look(400_000_000) < 0.1e9
    waits.close()


def some(total_us: int) -> str:
    return f"some avg10=0.00 avg60=0.00 avg300=0.00 total={total_us}\nfull avg10=0.00 total=7\n"


@pytest.mark.parametrize(("pages", "pressed_us", "told_ns"), [
    (3, 500_000, 500_000_000),  # its pages came from a disk on which all stood
    (3, 2_000, 2_000_000),  # from one that was quick: it slept by itself
    (0, 500_000, 0),  # others stood for it, and this one slept
])  # fmt: skip
def test_pages_that_were_read_while_the_disk_stood_still_count_and_only_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pages: int, pressed_us: int, told_ns: int
) -> None:
    """Nothing else can look meanwhile: a thread that needs a page keeps the interpreter's lock."""
    (tmp_path / "io").write_text(some(1000))
    read = 5
    monkeypatch.setattr("drivers.disk_waits._pages_read", lambda: read)
    waits = DiskWaits(tmp_path, tmp_path / "io")
    read += pages
    (tmp_path / "io").write_text(some(1000 + pressed_us))
    assert waits.look(LATE_NS) == told_ns
    assert waits.look(LATE_NS) == 0
    waits.close()


def test_a_loop_that_stands_for_a_disk_says_so_beside_how_late_it_was(tmp_path: Path) -> None:
    told: list[dict[str, Any]] = []

    async def main() -> None:
        watching = asyncio.create_task(watch_lateness(told.append))
        await asyncio.sleep(0.1)
        stand(tmp_path, 0.5)
        await asyncio.sleep(0.1)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    asyncio.run(main())
    longest = max(told, key=lambda record: record["loop_ns"])
    assert longest["disk_ns"] > 0.3e9
    assert longest["disk_ns"] + longest["waited_ns"] <= longest["loop_ns"]
