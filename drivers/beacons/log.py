"""Positions of ultrasonic beacons, as a log: one line for each position the system gave, in CSV.

    stamp_ns,address,x_m,y_m,z_m,quality
    1520331200,5,4.102,1.733,1.498,92

Stamps are of the beacon system's own clock, positions in its own frame (z up, rotated about the
vertical and shifted against any other); no quality: the system did not rate it.
``drivers.beacons.marvelmind`` gives the same values live.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated

import msgspec

from drivers.interfaces import BeaconError, BeaconFix
from path.bounds import Bounds
from path.messages import Vec3
from path.values import frozen

TRUTH_FILE = "beacons.truth.json"
COLUMNS = ("stamp_ns", "address", "x_m", "y_m", "z_m", "quality")


@frozen
class Mounted:
    """A beacon on a body: its address, and where it sits in the body's frame, as measured with a
    ruler.
    """

    address: Annotated[int, Bounds(0, 255, "(an address)")]
    lever_m: Annotated[Vec3, Bounds(-3.0, 3.0)]


@frozen
class BeaconTruth:
    """The truth of a harness that makes beacons up, for judging how a trial did; no trial may
    estimate with it.

    Attributes:
        offset_s: world clock minus the listener's at the middle of the log; that the way over the
            wire makes stamps late is not in it.
        yaw_rad, origin_m: a point of the world is ``Rz(yaw) p + origin`` in the beacons' frame.
        noise: what is wrong with the beacons, in words: (quantity, value).
    """

    offset_s: float
    yaw_rad: float
    origin_m: Vec3
    noise: tuple[tuple[str, str], ...]


def write_truth(file: Path, truth: BeaconTruth) -> None:
    """Raise OSError."""
    file.write_bytes(msgspec.json.format(msgspec.json.encode(truth)))


def read_truth(file: Path) -> BeaconTruth | None:
    """None when there is no such file: nobody knows. Raises BeaconError for one that is something
    else, OSError.
    """
    try:
        return msgspec.json.decode(file.read_bytes(), type=BeaconTruth)
    except FileNotFoundError:
        return None
    except msgspec.MsgspecError as error:
        raise BeaconError(
            f"{file}: {error}", "it is the harness's own file: leave it as it was written"
        ) from error


def read_beacons(file: Path) -> list[BeaconFix]:
    """All positions of a log, in its order. Raises BeaconError naming the line, OSError."""
    with file.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        rows = csv.reader(lines)
        header = next(rows, [])
        if tuple(name.strip() for name in header) != COLUMNS:
            raise BeaconError(
                f"{file}: the first line is {','.join(header)!r}", f"it must be {','.join(COLUMNS)}"
            )
        return [_fix(file, number, row) for number, row in enumerate(rows, 2) if row]


def _fix(
    file: Path,
    number: int,
    row: list[str],
) -> BeaconFix:
    try:
        stamp, address, *rest, quality = row
        x, y, z = map(float, rest)
        rated = float(quality) if quality.strip() else None
        fix = BeaconFix(int(stamp), int(address), (x, y, z), math.nan if rated is None else rated)
    except ValueError as error:
        raise BeaconError(
            f"{file}, line {number}: {','.join(row)!r} is no position of a beacon",
            f"write {','.join(COLUMNS)}",
        ) from error
    if not math.isfinite(x + y + z + (rated or 0.0)):
        raise BeaconError(f"{file}, line {number}: a number is not finite", "leave such lines out")
    return fix
