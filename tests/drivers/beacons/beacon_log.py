"""A log of beacons' positions, as a recorder leaves it."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

from drivers.beacons.log import COLUMNS
from drivers.interfaces import BeaconFix


def write_beacons(file: Path, fixes: Iterable[BeaconFix]) -> None:
    with file.open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        rows.writerow(COLUMNS)
        for fix in fixes:
            x, y, z = fix.position_m
            quality = "" if math.isnan(fix.quality) else f"{fix.quality:.0f}"
            rows.writerow((fix.stamp_ns, fix.address, f"{x:.4f}", f"{y:.4f}", f"{z:.4f}", quality))
