"""The log of Marvelmind's Dashboard: read in its documented columns, and refused with the line that
is none.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.beacons.record import read_any
from drivers.interfaces import BeaconError, BeaconFix
from tests.drivers.beacons.beacon_log import write_beacons

LOG = """\
T2025_11_23__114505_120,1763898305120
1763898305120,63,48211,5,4.102,1.733,1.498,1,3.912,2,4.877
1763898305183,63,48274,6,-0.250,1.5,0,1,3.1,2,4.2,3,5.019,4,6.2

1763898305246,63,48337,5,4.110,1.731,1.502
"""
MS = 1_000_000
FIXES = [
    BeaconFix(1_763_898_305_120 * MS, 5, (4.102, 1.733, 1.498)),
    BeaconFix(1_763_898_305_183 * MS, 6, (-0.25, 1.5, 0.0)),
    BeaconFix(1_763_898_305_246 * MS, 5, (4.11, 1.731, 1.502)),
]


def written(folder: Path, text: str) -> Path:
    file = folder / "beacons.csv"
    file.write_text(text, "utf-8", newline="")
    return file


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_positions_are_read_whatever_follows_them(tmp_path: Path, end: str) -> None:
    fixes = read_any(written(tmp_path, LOG.replace("\n", end)))
    assert all(math.isnan(fix.quality) and fix.host_ns is None for fix in fixes)  # it does not say
    assert [(fix.stamp_ns, fix.address, fix.position_m) for fix in fixes] == [
        (fix.stamp_ns, fix.address, fix.position_m) for fix in FIXES
    ]


@pytest.mark.parametrize("cut", range(1, 28))
def test_a_last_line_that_was_cut_is_left_out(tmp_path: Path, cut: int) -> None:
    """Wherever the Dashboard was killed: a cut number would be another number."""
    assert len(read_any(written(tmp_path, LOG[:-cut]))) == 2


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1763898305309,63,48400,5,4.1,1.7", "line 6: .* is no position"),
        ("1763898305309,63,48400,five,4.1,1.7,1.5", "line 6: .* is no position"),
        ("1763898305309,63,48400,5,4,1,2", ""),
        ("1,7638983E+12,63,48400,5,4.1,1.7,1.5", "line 6: .* is no position"),
        (
            "1.7638983E+12,63,48400,5,4.1,1.7,1.5",
            "line 6: .* time that a spreadsheet has shortened",
        ),
        ("1763898305309;63;48400;5;4.1;1.7;1.5", "line 6: .* is no position"),
        ("63,48400,5,4,1,1,1,3.9", "line 6: .* no Unix time"),
        ("1763898305309,63,48400,300,4.1,1.7,1.5", "line 6: .* address 300"),
        ("1763898305309,63,48400,5,nan,1.7,1.5", "line 6: .* not finite"),
        ("1763898305309,63,48400,5,4102,1733,1498", "line 6: .* millimetres"),
    ],
)
def test_a_line_that_is_none_is_named(tmp_path: Path, line: str, said: str) -> None:
    file = written(tmp_path, f"{LOG}{line}\n")
    if not said:
        assert len(read_any(file)) == 4
        return
    with pytest.raises(BeaconError, match=said) as caught:
        read_any(file)
    assert "ms since the start" in caught.value.remedy


@pytest.mark.parametrize(
    ("text", "said"), [("T2025_11_23,1\n", "no position"), ("x,y,z\n", "the first line")]
)
def test_a_file_without_positions_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(BeaconError, match=said):
        read_any(written(tmp_path, text))


def test_a_list_with_its_header_is_read_as_such(tmp_path: Path) -> None:
    write_beacons(tmp_path / "beacons.csv", FIXES)
    assert [fix.stamp_ns for fix in read_any(tmp_path / "beacons.csv")] == [
        fix.stamp_ns for fix in FIXES
    ]


ROWS = [
    (1763898305120 + 125 * k, 125, 5000 + 125 * k, 5, 4.102 + k, 1.733, 1.498, 1, 3.912)
    for k in range(3)
]
READ = [(4.102 + k, 1.733, 1.498) for k in range(3)]


def with_points(separator: str = ",", quote: str = "") -> str:
    return "".join(
        separator.join(f"{quote}{number}{quote}" for number in row) + "\n" for row in ROWS
    )


def with_commas(separator: str = ",", quote: str = "") -> str:
    return with_points("|", quote).replace(".", ",").replace("|", separator)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    "content",
    [
        with_commas(";").encode(),
        with_commas("\t").encode(),
        with_points(";").encode(),
        with_points(quote='"').encode(),
        with_commas(quote='"').encode(),
        with_points().encode("utf-8-sig"),
        with_commas(";").encode("utf-8-sig"),
        with_commas("\t").encode("utf-16"),
    ],
    ids=[
        "semicolons",
        "tabs",
        "semicolons and points",
        "quoted",
        "quoted commas",
        "mark",
        "mark and semicolons",
        "utf-16",
    ],
)
def test_a_log_that_a_spreadsheet_saved_again_is_read_as_it_was(
    tmp_path: Path, content: bytes, end: str
) -> None:
    file = tmp_path / "beacons.csv"
    coding = "utf-16" if content[:2] == b"\xff\xfe" else "utf-8"
    file.write_bytes(content.decode(coding).replace("\n", end).encode(coding))
    assert [fix.position_m for fix in read_any(file)] == [
        pytest.approx(position) for position in READ
    ]


@pytest.mark.parametrize("shorter", [0, 2], ids=["with distances", "without"])
def test_decimal_commas_between_commas_are_refused_and_never_read_as_other_numbers(
    tmp_path: Path, shorter: int
) -> None:
    text = "".join(
        ",".join(str(n) for n in row[: len(row) - shorter]).replace(".", ",") + "\n" for row in ROWS
    )
    with pytest.raises(
        BeaconError, match=r"line 1: .* decimal commas .* 4,102 may be one number or two"
    ) as caught:
        read_any(written(tmp_path, text))
    assert "decimal points" in caught.value.remedy


def test_one_line_with_decimal_commas_is_enough(tmp_path: Path) -> None:
    with pytest.raises(
        BeaconError, match=r"line 6: .* decimal commas .* 4,1 may be one number or two"
    ):
        read_any(written(tmp_path, f"{LOG}1763898305309,63,48400,5,4,1,1,7,1,5\n"))


def test_a_list_of_ones_own_is_read_with_a_byte_order_mark(tmp_path: Path) -> None:
    write_beacons(tmp_path / "beacons.csv", FIXES)
    marked = b"\xef\xbb\xbf" + (tmp_path / "beacons.csv").read_bytes()
    (tmp_path / "beacons.csv").write_bytes(marked)
    assert len(read_any(tmp_path / "beacons.csv")) == len(FIXES)
