"""The computer that a role runs on: how fast it writes its log, and whether its wall clock is kept
right.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from pathlib import Path

from drivers.rig.part_check import Finding

BLOCK = 1 << 20
MOST_BLOCKS = 64
WRITE_S = 1.0
# chosen, with room above a log with pictures; a recording of a D415 needs 46 (docs/cameras.md)
SLOW_MB_S = 5.0
ASK_S = 3.0


def write_finding(folder: Path) -> Finding:
    """Write up to 64 MB into a folder for a second at most, to the disk itself, and take them away
    again.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        speed = _written_mb_s(folder)
    except OSError as error:
        return Finding(
            "fault",
            "disk",
            f"{folder}: {error.strerror or error}",
            "name a folder that can be written to",
        )
    detail = f"{speed:.0f} MB/s into {folder}"
    if speed < SLOW_MB_S:
        return Finding(
            "note",
            "disk",
            detail,
            "a faster card or disk, or --out on another one: pictures may be left out",
        )
    return Finding("ok", "disk", detail)


def _written_mb_s(folder: Path) -> float:
    block = os.urandom(BLOCK)
    with tempfile.TemporaryFile(dir=folder) as file:
        start_s = time.perf_counter()
        blocks = 0
        while blocks < MOST_BLOCKS and time.perf_counter() - start_s < WRITE_S:
            file.write(block)
            file.flush()
            os.fdatasync(file.fileno())
            blocks += 1
        return blocks * BLOCK * 1e-6 / (time.perf_counter() - start_s)


def clock_finding() -> Finding:
    """Roles go by a clock that never steps; the wall clock dates logs, and stamps of cameras pass
    through it.
    """
    steps_ns = time.get_clock_info("monotonic").resolution * 1e9
    try:
        asked = subprocess.run(
            ["timedatectl", "show", "--property=NTPSynchronized", "--value"],
            capture_output=True, text=True, timeout=ASK_S, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return Finding(
            "ok",
            "clock",
            f"monotonic to {steps_ns:.0f} ns; who sets the wall clock is not known",
        )
    if asked.stdout.strip() == "yes":
        return Finding(
            "ok",
            "clock",
            f"monotonic to {steps_ns:.0f} ns; the wall clock is set by NTP",
        )
    fix = "let NTP set it before the flight, and not during it: logs are dated by it"
    return Finding(
        "note",
        "clock",
        f"monotonic to {steps_ns:.0f} ns; the wall clock is not set by NTP",
        fix,
    )
