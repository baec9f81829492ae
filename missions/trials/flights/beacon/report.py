"""The beacon trial's segments, tables and findings: from the records alone, judged beside where a harness can."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missions.report.records import RunRecords, phase_changes
from missions.trials.flights.dynamic.judge import SUBJECTS, Compared, SessionErrors
from missions.trials.flights.dynamic.report import NAMES
from missions.trials.shared.statistics import Interval, blocks_interval
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict

Array = NDArray[np.float64]

OFFSET_GOAL_S = 0.010
LEAST = 10  # errors that a segment must have
COLUMNS = (
    "segment",
    "trajectory",
    "n",
    "rmse_mm",
    "rmse_low_mm",
    "rmse_high_mm",
    "mean_mm",
    "median_mm",
    "p95_mm",
    "max_mm",
)


@dataclass(frozen=True, slots=True)
class SessionPart:
    """A part of the session, s of the receiver's clock."""

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One row: errors of one trajectory in one segment, m; ``interval`` of the rms is 95 %, over blocks of time."""

    segment: str
    subject: str
    n: int
    rmse_m: float
    interval: Interval
    mean_m: float
    median_m: float
    p95_m: float
    max_m: float


def segments_of(run: RunRecords, measured: SessionErrors) -> list[SessionPart]:
    """The phases of the receiver in which there was something to compare, after the whole."""
    times = np.concatenate([measured.beacons[name].t for name in SUBJECTS])
    found = [SessionPart("all", float(times.min()), float(times.max()) + 1e-6)]
    changes = phase_changes(run.receiver)
    for begin, end in zip(changes, [*changes[1:], None], strict=True):
        start_s, end_s = begin.stamp_ns * 1e-9, math.inf if end is None else end.stamp_ns * 1e-9
        if np.count_nonzero((times >= start_s) & (times < end_s)) >= LEAST:
            found.append(SessionPart(begin.record["phase"], start_s, end_s))
    return found


def errors_of(measured: SessionErrors, segments: Sequence[SessionPart], seed: int) -> list[ErrorRow]:
    rows = list[ErrorRow]()
    for segment in segments:
        for name in SUBJECTS:
            own = measured.beacons[name]
            at = (own.t >= segment.start_s) & (own.t < segment.end_s)
            if np.count_nonzero(at) >= LEAST:
                rows.append(_errors(segment.name, name, own, at, np.random.default_rng([seed, len(rows)])))
    return rows


def _errors(segment: str, name: str, own: Compared, at: NDArray[np.bool_], rng: np.random.Generator) -> ErrorRow:
    error_m = own.error_m[at]
    low, high = blocks_interval(error_m**2, own.blocks[at], rng)
    return ErrorRow(
        segment, name, len(error_m), math.sqrt(float(np.mean(error_m**2))), (math.sqrt(low), math.sqrt(high)),
        float(np.mean(error_m)), float(np.median(error_m)), float(np.percentile(error_m, 95)), float(np.max(error_m)),
    )  # fmt: skip


def write_errors(file: Path, rows: Sequence[ErrorRow]) -> None:
    """The table as CSV. The same records give the same bytes. Raises OSError."""
    with file.open("w", newline="", encoding="utf-8") as out:
        table = csv.writer(out)
        table.writerow(COLUMNS)
        table.writerows(_texts(row) for row in rows)


def _texts(row: ErrorRow) -> tuple[str, ...]:
    lengths = (row.rmse_m, *row.interval, row.mean_m, row.median_m, row.p95_m, row.max_m)
    return row.segment, row.subject, str(row.n), *(f"{1e3 * length_m:.2f}" for length_m in lengths)


def findings(
    measured: SessionErrors, rows: Sequence[ErrorRow], offset_error_s: float | None
) -> tuple[TrialFinding, ...]:
    clock = measured.clock
    half_ms = 1e3 * 1.96 * clock.offset_sigma_s
    offset_ms = 1e3 * clock.offset_s
    found = [
        TrialFinding(
            "receiver's clock minus the listener's, ms",
            f"{offset_ms:.1f}",
            f"{offset_ms - half_ms:.1f} to {offset_ms + half_ms:.1f}",
            goal="known to 10" if offset_error_s is not None else "",
            verdict="measured" if offset_error_s is None else verdict(abs(offset_error_s) <= OFFSET_GOAL_S),
            note="from both vehicles' own records; what delays all telemetry or all positions alike is in it"
            + ("" if offset_error_s is None else f"; off by {1e3 * offset_error_s:+.1f} ms, judged by the harness"),
        )
    ]
    for row in rows:
        if row.segment == "all":
            found.append(
                TrialFinding(
                    f"{NAMES[row.subject]} against the beacons, rms, mm",
                    f"{1e3 * row.rmse_m:.1f}",
                    f"{1e3 * row.interval[0]:.1f} to {1e3 * row.interval[1]:.1f}",
                    note=f"the beacons' noise alone makes {1e3 * measured.beacons[row.subject].expected_m:.1f}; the "
                    "paper gives no number for its dynamic part",
                )
            )
    return tuple(found)


def table(rows: Sequence[ErrorRow]) -> TrialTable:
    return TrialTable(
        "Errors by segment, mm",
        ("segment", "trajectory", "n", "rms", "95 %", "", "mean", "median", "p95", "max"),
        tuple(_texts(row) for row in rows),
        "Segments are the receiver's phases. Intervals: bootstrap over blocks of 2 s. errors.csv has the same.",
    )


def alignment(measured: SessionErrors) -> TrialTable:
    clock, frame, heard = measured.clock, measured.frame, measured.heard
    tilt_deg = math.degrees(math.acos(min(1.0, float(measured.free.R[2, 2]))))
    rows = [
        ("receiver's clock minus the listener's", f"{clock.offset_s:.4f} s", f"± {1e3 * clock.offset_sigma_s:.1f} ms"),
        ("turn of the beacons' frame", f"{math.degrees(frame.yaw_rad):.2f} deg",
         f"± {math.degrees(frame.yaw_sigma_rad):.2f} deg"),
        *((f"shift of {NAMES[name]}", ", ".join(f"{1e3 * x:.0f}" for x in frame.shifts[k].tolist()) + " mm",
           f"± {1e3 * frame.shift_sigma_m[k]:.0f} mm") for k, name in enumerate(SUBJECTS)),
        ("tilt, were any rotation allowed", f"{tilt_deg:.2f} deg", ""),
        ("noise of a position at rest", f"{1e3 * measured.noise_m:.1f} mm per axis", f"of {measured.noise_samples}"),
        ("positions refused (jump, poor quality)", f"{heard.refused} of {heard.fixes}", ""),
    ]  # fmt: skip
    return TrialTable("How the records lie to each other", ("what", "value", "one sigma"), tuple(rows))


def summary(measured: SessionErrors, rows: Sequence[ErrorRow], offset_error_s: float | None) -> dict[str, Any]:
    clock, frame = measured.clock, measured.frame
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
        "errors": [
            {"segment": row.segment, "subject": row.subject, "n": row.n, "rmse_m": row.rmse_m,
             "rmse_interval_m": list(row.interval), "mean_m": row.mean_m, "median_m": row.median_m, "p95_m": row.p95_m,
             "max_m": row.max_m}
            for row in rows
        ],
    }  # fmt: skip
