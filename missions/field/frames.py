"""What commands that look at every frame of a recording share: opening it, and what they write."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2

from drivers.interfaces import PartError
from drivers.recordings.recording import Recording, RecordingOptions, open_recording
from path.arrays import Image

UNSTAMPED_HZ = 30.0
"""Of images in a folder that have no stamps."""
OTHER_FOLDER = "name another folder with --out"


def open_frames(frames: Path, rate_hz: float | None) -> Recording:
    """Open a recording. ``rate_hz``: of one without stamps, where it is said. Raises
    RecordingError.
    """
    unstamped_hz = UNSTAMPED_HZ if frames.is_dir() else None
    return open_recording(frames, RecordingOptions(rate_hz=rate_hz or unstamped_hz))


def write_picture(file: Path, picture: Image) -> None:
    """Raises PartError."""
    if not cv2.imwrite(str(file), picture):
        raise PartError(f"cannot write {file}", OTHER_FOLDER)


def write_table(
    file: Path,
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
) -> None:
    """Write a CSV file. Raises PartError."""
    try:
        with file.open("w", newline="", encoding="utf-8") as table:
            writer = csv.writer(table)
            writer.writerow(columns)
            writer.writerows(rows)
    except OSError as error:
        raise PartError(f"cannot write {file}: {error.strerror}", OTHER_FOLDER) from error
