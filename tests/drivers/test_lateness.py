"""A process knows how late it was, and for how much of that it was given no core."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.lateness import CoreWaits, watch_lateness

TICK_NS = round(1e9 / os.sysconf("SC_CLK_TCK"))
COMPUTES = "import os\nos.sched_setaffinity(0, {core})\nwhile True: pass"
COUNTS = Path("/proc/self/schedstat").exists()


def write(folder: Path, waits_ns: dict[int, int], stolen: tuple[int, int] = (0, 0)) -> None:
    for thread, waited_ns in waits_ns.items():
        (folder / str(thread)).mkdir(exist_ok=True)
        (folder / str(thread) / "schedstat").write_text(f"5000 {waited_ns} 7\n")
    line = "cpu{} 5 5 5 5 5 5 5 {} 0 0\n"
    lines = [
        line.format("", sum(stolen)),
        *(line.format(core, each) for core, each in enumerate(stolen)),
    ]
    (folder / "stat").write_text("".join(lines))


def test_it_tells_the_wait_of_its_thread_the_longest_of_the_others_and_what_a_host_took(
    tmp_path: Path,
) -> None:
    write(tmp_path, {1: 100, 2: 200, 3: 300}, (7, 9))
    waits = CoreWaits(1, tmp_path, tmp_path / "stat")
    write(tmp_path, {1: 150, 2: 230, 3: 310}, (7, 12))
    assert waits.look() == {"waited_ns": 50, "beside_ns": 30, "stolen_ns": 3 * TICK_NS}
    assert waits.look() == {"waited_ns": 0, "beside_ns": 0, "stolen_ns": 0}
    waits.close()


def test_what_a_thread_had_waited_before_it_was_known_is_of_another_time(tmp_path: Path) -> None:
    write(tmp_path, {1: 100})
    waits = CoreWaits(1, tmp_path, tmp_path / "stat")
    write(tmp_path, {1: 100, 2: 9_000_000})
    waits._looks = 0  # as after a second: threads are listed again
    assert waits.look()["beside_ns"] == 0
    write(tmp_path, {1: 100, 2: 9_000_500})
    assert waits.look()["beside_ns"] == 500
    waits.close()


def test_where_nothing_is_counted_nothing_was_taken(tmp_path: Path) -> None:
    waits = CoreWaits(1, tmp_path / "none", tmp_path / "nothing")
    assert waits.look() == {"waited_ns": 0, "beside_ns": 0, "stolen_ns": 0}
    waits.close()


def told_while(act: Any) -> list[dict[str, Any]]:
    """What is told of a loop in which something is done."""
    told: list[dict[str, Any]] = []

    async def main() -> None:
        watching = asyncio.create_task(watch_lateness(told.append))
        await asyncio.sleep(0.15)
        told.clear()
        act()
        await asyncio.sleep(0.15)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    asyncio.run(main())
    return told


def test_a_loop_that_is_kept_by_its_own_program_is_late_and_had_its_core() -> None:
    longest = max(told_while(lambda: time.sleep(0.4)), key=lambda record: record["loop_ns"])
    assert longest["loop_ns"] > 0.3e9
    assert longest["since_ns"] == pytest.approx(longest["loop_ns"] + 0.04e9, abs=1e6)
    assert longest["waited_ns"] < 0.2e9  # of a machine that is busy with others


@pytest.mark.skipif(not COUNTS, reason="this system does not count waits for a core")
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs to name a core")
def test_a_thread_that_others_kept_from_its_core_says_so() -> None:
    """Three programs that compute on its core, each at least as urgent: it waits most of the
    time.
    """
    core = {min(os.sched_getaffinity(0))}
    found: list[dict[str, int]] = []

    def compute() -> None:
        os.sched_setaffinity(0, core)
        waits = CoreWaits()
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            sum(range(1000))
        found.append(waits.look())
        waits.close()

    others = [
        subprocess.Popen([sys.executable, "-c", COMPUTES.format(core=core)]) for _ in range(3)
    ]
    try:
        time.sleep(0.4)
        thread = threading.Thread(target=compute)
        thread.start()
        thread.join()
    finally:
        for other in others:
            other.kill()
            other.wait()
    assert found[0]["waited_ns"] > 0.1e9
