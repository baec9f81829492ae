"""The longest row of agreeing pairs, from records alone: what ends one, and when it would have been
enough.
"""

from __future__ import annotations

from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord
from missions.look.report.in_a_row import longest_row
from missions.look.report.records import RunRecords

MS = 1_000_000
METHOD = {"hold_frames": 10, "hold_s": 0.15, "max_gap_s": 0.1}


def run_of(pairs: dict[int, Any], own_misses: tuple[int, ...] = ()) -> RunRecords:
    """Judged pairs by their capture in ms: "a" agreed, "m" missed, "i" ignored."""
    judged = [
        LogRecord(
            "/agreement",
            at * MS,
            {"capture_ns": at * MS, "agreed": kind == "a", "counted": kind != "i"},
        )
        for at, kind in pairs.items()
    ]
    frames = [
        LogRecord("/target", at * MS, {"capture_ns": at * MS, "reason": "no_target"})
        for at in own_misses
    ]
    setup = [LogRecord("/setup", 0, {"method": METHOD})]
    return RunRecords(None, {"/setup": setup, "/agreement": judged, "/target": frames}, {}, {})


def row_of(*args: Any) -> tuple[int, Any, bool]:
    row = longest_row(run_of(*args))
    assert row is not None
    return row["pairs"], pytest.approx(row["seconds"]), row["complete"]


STEADY = {20 * k: "a" for k in range(12)}


def test_a_long_row_is_enough() -> None:
    assert row_of(STEADY) == (12, 0.22, True)


def test_a_miss_of_either_drone_ends_it() -> None:
    assert row_of({**STEADY, 100: "m"}) == (6, 0.10, False)
    assert row_of(STEADY, (90,)) == (7, 0.12, False)


def test_what_is_no_evidence_does_not() -> None:
    assert row_of({**STEADY, 105: "i"}) == (12, 0.22, True)


def test_a_gap_does() -> None:
    assert row_of({**{20 * k: "a" for k in range(5)}, **{300 + 20 * k: "a" for k in range(6)}}) == (
        6,
        0.10,
        False,
    )


def test_pairs_without_the_time_are_not_enough() -> None:
    assert row_of({10 * k: "a" for k in range(12)}) == (12, 0.11, False)


def test_nothing_judged_is_no_row() -> None:
    assert longest_row(run_of({})) is None
