"""The stamps of a recording's images and frames: from a table, from the names of files, or by a
rate.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from drivers.interfaces import CameraError
from drivers.text_file import read_file

STAMPS_FILE = "stamps.csv"
NS_DIGITS = 16  # file names of at least as many digits are nanoseconds


class RecordingError(CameraError):
    """A recording cannot be opened, or is damaged."""


def frame_stamps(file: Path) -> list[int]:
    """The stamps, ns, of a film's frames, from a column ``stamp_ns`` or ``stamp_s`` with a line for
    each.

    Raises RecordingError.
    """
    remedy = "one column is stamp_ns or stamp_s, with a line for each frame, in their order"
    stamps = [
        _stamp_of(f"{file}: line {number}: {row} has no stamp", row, remedy)
        for number, row in enumerate(_rows(file, remedy), 2)
    ]
    for number, (before, stamp_ns) in enumerate(pairwise(stamps), 3):
        if stamp_ns <= before:
            raise RecordingError(
                f"{file}: line {number}: no later than the line before", "correct the stamps"
            )
    return stamps


def natural(file: Path) -> list[tuple[int, str]]:
    """Sorts img2 before img10."""
    return [
        (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)
    ]


def stamped_files(
    folder: Path,
    files: Sequence[Path],
    given: Path | None,
    rate_hz: float | None,
) -> list[tuple[int, Path]]:
    """Files with their stamps, ns, in order. Raises RecordingError.

    ``given``: the table of stamps, if it is not the folder's own. ``rate_hz``: of images that have
    no stamps.
    """
    table = given or (folder / STAMPS_FILE if (folder / STAMPS_FILE).exists() else None)
    if table is not None:
        stamps = _read_stamps(table)
        missing = [file.name for file in files if file.name not in stamps]
        if missing:
            raise RecordingError(f"{table}: there is no stamp for {missing[0]} ({len(missing)} in all)",
                                 "add a line for each image, or remove the images")  # fmt: skip
        stamped = sorted(((stamps[file.name], file) for file in files), key=lambda pair: pair[0])
    elif rate_hz is not None:
        stamped = [(round(1e9 * number / rate_hz), file) for number, file in enumerate(files)]
    else:
        stamped = sorted(
            ((_time_of(file, folder), file) for file in files), key=lambda pair: pair[0]
        )
    for (before, _), (stamp_ns, file) in pairwise(stamped):
        if stamp_ns <= before:
            raise RecordingError(
                f"{folder}: {file.name} has the stamp of another image", "correct the stamps"
            )
    return stamped


def _time_of(file: Path, folder: Path) -> int:
    """A stamp from a file's name: nanoseconds when it has as many digits, seconds when it has a
    decimal point.
    """
    if file.stem.isdigit() and len(file.stem) >= NS_DIGITS:
        return int(file.stem)
    if re.fullmatch(r"\d+\.\d+", file.stem):
        return round(float(file.stem) * 1e9)
    raise RecordingError(
        f"{folder}: the name of {file.name} is no time, and there is no {STAMPS_FILE}",
        f"give rate_hz, or write {STAMPS_FILE} with the columns file and stamp_ns (or stamp_s)",
    )


def _read_stamps(file: Path) -> Mapping[str, int]:
    remedy = "the columns are file and stamp_ns, or file and stamp_s"
    stamps: dict[str, int] = {}
    for number, row in enumerate(_rows(file, remedy), 2):
        name = row.get("file")
        what = f"{file}: line {number}: {row} has no file and stamp"
        if not isinstance(name, str):
            raise RecordingError(what, remedy)
        stamps[name.strip()] = _stamp_of(what, row, remedy)
    return stamps


def _rows(file: Path, remedy: str) -> list[dict[str, str | None]]:
    try:
        return list(csv.DictReader(read_file(file).decode("utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{file}: {error}", remedy) from error


def _stamp_of(
    without: str,
    row: Mapping[str, str | None],
    remedy: str,
) -> int:
    """A line's stamp, ns. Raises RecordingError, ``without``, when there is none."""
    try:
        stamp = row.get("stamp_ns")
        return round(float(row["stamp_s"] or "") * 1e9) if stamp is None else int(stamp)
    except (KeyError, ValueError, OverflowError) as error:
        raise RecordingError(without, remedy) from error
