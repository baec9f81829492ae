"""Many handoffs by seed: nothing flies on for a command that is gone."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

BEGUN_S, GONE_S = 120.0, 30.0


def children_of(parent: int) -> set[int]:
    """Processes that a process has started, and that have not ended."""
    found = set[int]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, own_parent = stat.read_text("utf-8").rpartition(") ")[2].split()[:2]
        except OSError:
            continue
        if int(own_parent) == parent and state != "Z":
            found.add(int(stat.parent.name))
    return found


def waited_for(what: Callable[[], bool], within_s: float) -> bool:
    end_s = time.monotonic() + within_s
    while not (there := what()) and time.monotonic() < end_s:
        time.sleep(0.05)
    return there


def test_flights_end_with_a_command_that_was_killed(tmp_path: Path) -> None:
    """One that was killed cleans nothing up: its processes would wait for the next flight for
    ever.
    """
    command = ["handoff", "--rig", "sim", "--seeds", "50", "--jobs", "1", "--out", str(tmp_path)]
    with subprocess.Popen(
        [sys.executable, "-m", "missions.cli", *command], stdout=subprocess.DEVNULL
    ) as process:
        try:
            assert waited_for((tmp_path / "seed-0000" / "run.json").exists, BEGUN_S)
            started = children_of(process.pid)
        finally:
            process.kill()
    assert started
    assert waited_for(lambda: not any(Path(f"/proc/{own}").exists() for own in started), GONE_S)
