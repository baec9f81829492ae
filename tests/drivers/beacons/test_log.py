"""A log of beacon positions: read as written, and refused where it is none."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.beacons.log import read_beacons
from drivers.interfaces import BeaconError, BeaconFix
from tests.drivers.beacons.beacon_log import write_beacons

FIXES = [
    BeaconFix(1_520_331_200, 5, (4.102, -1.7334, 1.4985), 92.0),
    BeaconFix(1_562_000_001, 6, (0.0, 0.0, 0.0), 0.0),
]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write_beacons(tmp_path / "beacons.csv", FIXES)
    assert read_beacons(tmp_path / "beacons.csv") == FIXES


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the first line"),
        ("time,x,y,z\n1,2,3,4\n", "the first line"),
        ("stamp_ns,address,x_m,y_m,z_m,quality\n1,5,0,0,0,90\n2,5,0,0\n", "line 3"),
        ("stamp_ns,address,x_m,y_m,z_m,quality\n1.5,5,0,0,0,90\n", "line 2"),
        ("stamp_ns,address,x_m,y_m,z_m,quality\n1,5,nan,0,0,90\n", "not finite"),
    ],
)
def test_what_is_no_beacon_log_is_refused_with_its_line(
    tmp_path: Path, text: str, said: str
) -> None:
    file = tmp_path / "beacons.csv"
    file.write_text(text, "utf-8")
    with pytest.raises(BeaconError, match=said):
        read_beacons(file)


def test_a_position_that_was_not_rated_is_kept_as_such(tmp_path: Path) -> None:
    write_beacons(tmp_path / "beacons.csv", [BeaconFix(1, 5, (0.0, 0.0, 0.0))])
    assert math.isnan(read_beacons(tmp_path / "beacons.csv")[0].quality)
