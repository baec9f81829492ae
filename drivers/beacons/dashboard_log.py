"""The log that Marvelmind's Dashboard itself writes: a line for each position, in CSV without a header.

    1763891105120,63,48211,5,4.102,1.733,1.498,1,3.912,2,4.877

Its columns are Unix time in ms, time since the line before and since the Dashboard's start in ms, the address of the
mobile beacon, x, y, z in m, and then pairs of a stationary beacon's address and the raw distance to it (Marvelmind,
"Indoor Navigation System, Operating manual", "CSV format"). What follows z differs between versions and is passed over,
as are the lines that begin with a T, which versions of today write between the positions.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from drivers.interfaces import BeaconError, BeaconFix

COLUMNS_READ = 7
UNIX_MS = range(10**12, 10**13)  # 2001 to 2286: older versions wrote no Unix time
MARK = re.compile(r"T\d")
BEGINS = re.compile(r"\s*(T?\d|$)")
IN_WORDS = "Unix ms,ms since the last,ms since the start,address,x,y,z in m"


def is_dashboard_log(file: Path) -> bool:
    """True for a list of positions that begins with no header. Raises OSError."""
    with file.open(encoding="utf-8", errors="replace") as lines:
        first = lines.readline(200)
    return bool(first and BEGINS.match(first))


def read_dashboard_log(file: Path) -> list[BeaconFix]:
    """All positions of a log, in its order. The system's rating of them is not in it.

    A last line that was not written to its end is left out: the Dashboard may have been killed.

    Raises:
        BeaconError: naming the line that is none of such a log.
        OSError: it cannot be read.
    """
    lines = file.read_text("utf-8", errors="replace").split("\n")
    fixes = [
        _fix(file, number, line.strip())
        for number, line in enumerate(lines[:-1], 1)
        if line.strip() and not MARK.match(line)
    ]
    if not fixes:
        raise BeaconError(f"{file} holds no position of a beacon", f"the Dashboard's log has lines of {IN_WORDS}")
    return fixes


def _fix(file: Path, number: int, line: str) -> BeaconFix:
    fields = line.split(",")[:COLUMNS_READ]
    try:
        unix_ms, _, _, address = map(int, fields[:4])
        x, y, z = map(float, fields[4:])
    except ValueError as error:
        raise _bad(file, number, line, "is no position of the Dashboard's log") from error
    if unix_ms not in UNIX_MS:
        raise _bad(file, number, line, f"begins with {unix_ms}, which is no Unix time in ms")
    if not 0 <= address <= 255:
        raise _bad(file, number, line, f"has the address {address}, which is not within 0..255")
    if not math.isfinite(x + y + z):
        raise _bad(file, number, line, "has a number that is not finite")
    return BeaconFix(1_000_000 * unix_ms, address, (x, y, z))


def _bad(file: Path, number: int, line: str, what: str) -> BeaconError:
    return BeaconError(f"{file}, line {number}: {line!r} {what}", f"a line is {IN_WORDS}; leave others out")
