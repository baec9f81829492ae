"""The beacon trial's segments, tables and findings: from the records alone, judged beside where a
harness can.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from missions.look.report.records import RunRecords, phase_changes
from missions.trials.flights.dynamic.judge import SUBJECTS, Compared, SessionErrors
from missions.trials.flights.errors import (
    COLUMNS,
    NAMES,
    OFFSET_GOAL_S,
    between,
    cells,
    errors_of,
    mm,
)
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict

LEAST = 10  # errors that a segment must have
LENGTHS = ("rmse_m", "rmse_low_m", "rmse_high_m", "mean_m", "median_m", "p95_m", "max_m")

Row = Mapping[str, Any]
"""Errors of one trajectory in one segment, as ``summary.json`` has them; the interval is 95 %, over
blocks of time.
"""


def rows_of(
    run: RunRecords,
    measured: SessionErrors,
    seed: int,
) -> list[Row]:
    """Return the errors of all, and of those phases of the receiver in which there was something to
    compare.
    """
    rows: list[Row] = []
    for segment, start_s, end_s in _segments(run):
        for name in SUBJECTS:
            part = _within(measured.beacons[name], start_s, end_s)
            if len(part.t) >= LEAST:
                rng = np.random.default_rng([seed, len(rows)])
                rows.append({"segment": segment, "subject": name, **errors_of([part], rng)})
    return rows


def _segments(run: RunRecords) -> list[tuple[str, float, float]]:
    """Return the whole and the receiver's phases: name, and from when to when, s of its clock."""
    changes = phase_changes(run.receiver)
    begins = [change.stamp_ns * 1e-9 for change in changes]
    names = [str(change.record["phase"]) for change in changes]
    phases = zip(names, begins, [*begins[1:], math.inf], strict=True)
    return [("all", -math.inf, math.inf), *phases]


def _within(
    own: Compared,
    start_s: float,
    end_s: float,
) -> Compared:
    at = (own.t >= start_s) & (own.t < end_s)
    return replace(own, t=own.t[at], error_m=own.error_m[at])


def write_errors(file: Path, rows: Sequence[Row]) -> None:
    """Write the table as CSV. The same records give the same bytes. Raises OSError."""
    with file.open("w", newline="", encoding="utf-8") as out:
        table = csv.writer(out)
        table.writerow(
            ("segment", "trajectory", "n", *(name.replace("_m", "_mm") for name in LENGTHS))
        )
        for row in rows:
            low, high = row["rmse_interval_m"]
            lengths = {**row, "rmse_low_m": low, "rmse_high_m": high}
            texts = (f"{1e3 * lengths[name]:.2f}" for name in LENGTHS)
            table.writerow((row["segment"], row["subject"], row["n"], *texts))


def findings(
    measured: SessionErrors,
    rows: Sequence[Row],
    offset_error_s: float | None,
) -> list[TrialFinding]:
    clock = measured.clock
    half_ms = 1e3 * 1.96 * clock.offset_sigma_s
    offset_ms = 1e3 * clock.offset_s
    known = offset_error_s is not None
    judged = (
        f"; off by {1e3 * offset_error_s:+.1f} ms, judged by the harness"
        if offset_error_s is not None
        else ""
    )
    found = [
        TrialFinding(
            "receiver's clock minus the listener's, ms",
            f"{offset_ms:.1f}",
            f"{offset_ms - half_ms:.1f} to {offset_ms + half_ms:.1f}",
            goal="known to 10" if known else "",
            verdict="measured"
            if offset_error_s is None
            else verdict(abs(offset_error_s) <= OFFSET_GOAL_S),
            note=f"from both vehicles' own records; what delays all telemetry or all positions alike is in it{judged}",
        )
    ]
    for row in rows:
        if row["segment"] == "all":
            expected_m = measured.beacons[row["subject"]].expected_m
            found.append(
                TrialFinding(
                    f"{NAMES[row['subject']]} against the beacons, rms, mm",
                    mm(row["rmse_m"]),
                    between(row["rmse_interval_m"]),
                    note=f"the beacons' noise alone makes {mm(expected_m)}; the paper gives no number for its dynamic "
                    "part",
                )
            )
    return found


def table(rows: Sequence[Row]) -> TrialTable:
    return TrialTable(
        "Errors by segment, mm",
        ("segment", "trajectory", *COLUMNS),
        tuple((row["segment"], NAMES[row["subject"]], *cells(row)) for row in rows),
        "Segments are the receiver's phases. Intervals: bootstrap over blocks of 2 s. errors.csv has the same.",
    )


def summary(
    measured: SessionErrors,
    rows: Sequence[Row],
    offset_error_s: float | None,
) -> dict[str, Any]:
    clock = measured.clock
    frame = measured.frame
    return {
        "time_offset_s": clock.offset_s,
        "time_offset_sigma_s": clock.offset_sigma_s,
        "time_offset_error_s": offset_error_s,
        "yaw_rad": frame.yaw_rad,
        "yaw_sigma_rad": frame.yaw_sigma_rad,
        "shift_m": {name: frame.shifts[k].tolist() for k, name in enumerate(SUBJECTS)},
        "beacon_noise_m": measured.noise_m,
        "positions": measured.heard.fixes,
        "refused": measured.heard.refused,
        "errors": list(rows),
    }
