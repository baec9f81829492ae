"""The log that Marvelmind's Dashboard itself writes: a line for each position, in CSV without a
header.

    1763891105120,63,48211,5,4.102,1.733,1.498,1,3.912,2,4.877

Its columns are Unix time in ms, time since the line before and since the Dashboard's start in ms,
the address of the mobile beacon, x, y, z in m, and then pairs of a stationary beacon's address and
the raw distance to it (Marvelmind, "Indoor Navigation System, Operating manual", "CSV format").
What follows z differs between versions and is passed over, as are the lines that begin with a T,
which versions of today write between the positions.

Spreadsheets save it again with quotes, semicolons or tabs, decimal commas, in UTF-16: that is read.
What is not is a decimal comma between columns that commas separate, where 4,102 may be one number
or two.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from pathlib import Path

from drivers.interfaces import BeaconError, BeaconFix

COLUMNS_READ = 7
UNIX_MS = range(10**12, 10**13)  # 2001 to 2286: older versions wrote no Unix time
FARTHEST_M = 1000.0  # a map of many submaps of 50 m at most each
MARK = re.compile(r"T\d")
BEGINS = re.compile(r"\s*(\"?T?\d|$)")
SEPARATORS = (";", "\t")  # that a spreadsheet puts in place of the comma
IN_WORDS = "Unix ms,ms since the last,ms since the start,address,x,y,z in m"


def is_dashboard_log(file: Path) -> bool:
    """True for a list of positions that begins with no header. Raises OSError."""
    with file.open("rb") as opened:
        first = _decoded(opened.read(200))
    return bool(first and BEGINS.match(first))


def read_dashboard_log(file: Path) -> list[BeaconFix]:
    """All positions of a log, in its order. The system's rating of them is not in it.

    A last line that was not written to its end is left out: the Dashboard may have been killed.

    Raises:
        BeaconError: naming the line that is none of such a log.
        OSError: it cannot be read.
    """
    lines = [line.strip() for line in _decoded(file.read_bytes()).split("\n")[:-1]]
    numbered = [(k, line) for k, line in enumerate(lines, 1) if line and not MARK.match(line)]
    if not numbered:
        raise BeaconError(
            f"{file} holds no position of a beacon", f"the Dashboard's log has lines of {IN_WORDS}"
        )
    first = numbered[0][1]
    separator = next((each for each in SEPARATORS if each in first), ",")
    return [_fix(file, number, line, separator) for number, line in numbered]


def _decoded(content: bytes) -> str:
    """Return text of UTF-8, or of the UTF-16 that a spreadsheet calls Unicode, without its byte
    order mark.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    return content.decode("utf-8-sig", errors="replace")


def _fix(
    file: Path,
    number: int,
    line: str,
    separator: str,
) -> BeaconFix:
    fields = next(csv.reader([line], delimiter=separator), [])
    place = fields[4:COLUMNS_READ]
    # Of columns that commas separate, one may still be quoted: "4,102".
    whole = not any("." in each or "," in each for each in fields[4:])
    if separator == "," and whole and len(fields) > COLUMNS_READ:
        raise BeaconError(
            f"{file}, line {number}: {line!r} has decimal commas between columns that commas separate: "
            f"{place[0]},{place[1]} may be one number or two",
            "let the Dashboard write it again under a language with decimal points (LC_NUMERIC=C on Linux)",
        )
    if "E" in fields[0].upper():
        raise _bad(file, number, line, "has a time that a spreadsheet has shortened")
    try:
        unix_ms, _, _, address = map(int, fields[:4])
        x, y, z = (float(each.replace(",", ".")) for each in place)
    except ValueError as error:
        raise _bad(file, number, line, "is no position of the Dashboard's log") from error
    if unix_ms not in UNIX_MS:
        raise _bad(file, number, line, f"begins with {unix_ms}, which is no Unix time in ms")
    if not 0 <= address <= 255:
        raise _bad(file, number, line, f"has the address {address}, which is not within 0..255")
    if not math.isfinite(x + y + z):
        raise _bad(file, number, line, "has a number that is not finite")
    if max(abs(x), abs(y), abs(z)) > FARTHEST_M:
        raise _bad(
            file,
            number,
            line,
            "has a place farther off than ultrasound is heard: millimetres?",
        )
    return BeaconFix(1_000_000 * unix_ms, address, (x, y, z))


def _bad(
    file: Path,
    number: int,
    line: str,
    what: str,
) -> BeaconError:
    return BeaconError(
        f"{file}, line {number}: {line!r} {what}", f"a line is {IN_WORDS}; leave others out"
    )
