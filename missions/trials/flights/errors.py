"""Errors of trajectories as every experiment of this question states and shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from missions.trials.flights.dynamic.judge import SUBJECTS, Compared, HarnessVerdict, SessionErrors
from missions.trials.shared.statistics import blocks_interval, rms
from missions.trials.shared.trial import TrialTable
from path.arrays import Array

NAMES = {"d2": "D2 from D1", "target": "the target from D1"}
OFFSET_GOAL_S = 0.010
NOTHING = {"n": 0, "rmse_m": None, "mean_m": None, "median_m": None, "p95_m": None, "max_m": None}


def spread(errors: Array) -> dict[str, Any]:
    """Return the figures of errors (n,), m."""
    if not len(errors):
        return dict(NOTHING)
    return {
        "n": len(errors),
        "rmse_m": rms(errors),
        "mean_m": float(np.mean(errors)),
        "median_m": float(np.median(errors)),
        "p95_m": float(np.percentile(errors, 95)),
        "max_m": float(np.max(errors)),
    }


def errors_of(compared: Sequence[Compared], rng: np.random.Generator) -> dict[str, Any]:
    """Return the figures of all these errors together.

    Intervals are from a bootstrap over blocks of time, as neighbours are alike.
    """
    errors = np.concatenate([each.error_m for each in compared])
    counts = [int(each.blocks.max(initial=-1)) + 1 for each in compared]
    firsts = np.cumsum([0, *counts[:-1]])
    groups = np.concatenate(
        [each.blocks + first for each, first in zip(compared, firsts, strict=True)]
    )
    mean_interval = blocks_interval(errors, groups, rng)
    low, high = blocks_interval(errors**2, groups, rng)
    return {
        **spread(errors),
        "mean_interval_m": list(mean_interval),
        "rmse_interval_m": [math.sqrt(low), math.sqrt(high)],
    }


def mm(value_m: float | None) -> str:
    """Return a length in mm as text, "-" when it is not known."""
    return "-" if value_m is None or not math.isfinite(value_m) else f"{1e3 * value_m:.1f}"


def between(interval_m: Sequence[float]) -> str:
    """Return an interval in mm as text."""
    low, high = interval_m
    return f"{mm(low)} to {mm(high)}"


COLUMNS = ("n", "rmse", "95 %", "mean", "median", "p95", "max")


def cells(found: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the figures of ``errors_of`` or ``spread`` as a table has them, mm."""
    interval = between(found["rmse_interval_m"]) if "rmse_interval_m" in found else ""
    rest = (mm(found[name]) for name in ("mean_m", "median_m", "p95_m", "max_m"))
    return str(found["n"]), mm(found["rmse_m"]), interval, *rest


def alignments(sessions: Mapping[str, SessionErrors]) -> TrialTable:
    """Return how the records of sessions lie to each other."""
    return TrialTable(
        "Clock and frame of the beacons, estimated from the records",
        (
            "session", "clock offset, s", "its error, ms", "turn of the frame, deg", "its error, deg",
            "shift of D2, mm", "shift of the target, mm", "tilt of a free rotation, deg",
            "noise of a position at rest, mm per axis", "positions refused (jump, poor quality)",
        ),
        tuple((name, *_alignment(each)) for name, each in sessions.items()),
        "± are standard deviations: the offset's from its fit, others from a bootstrap over blocks of 2 s. The turn "
        "contains D1's own heading error, as D1's attitude turns PATH's vectors. The target's shift is the way from "
        "its roof, where the beacon is, to the side that D1 looks at; D2's is what D1's tilt and the warp of the "
        "beacons' frame leave. Errors are judged by the harness, where there is one.",
    )  # fmt: skip


def _alignment(each: SessionErrors) -> tuple[str, ...]:
    clock = each.clock
    frame = each.frame
    offset_error = yaw_error = ""
    if isinstance(each, HarnessVerdict):
        offset_error = f"{1e3 * each.offset_error_s:+.1f}"
        yaw_error = f"{math.degrees(each.yaw_error_rad):+.2f}"
    shifts: list[str] = []
    for k in range(len(SUBJECTS)):
        parts = ", ".join(mm(part) for part in frame.shifts[k].tolist())
        shifts.append(f"{parts} ± {mm(frame.shift_sigma_m[k])}")
    return (
        f"{clock.offset_s:.4f} ± {clock.offset_sigma_s:.4f}",
        offset_error,
        f"{math.degrees(frame.yaw_rad):.2f} ± {math.degrees(frame.yaw_sigma_rad):.2f}",
        yaw_error,
        *shifts,
        f"{math.degrees(tilt_rad(each)):.2f}",
        f"{mm(each.noise_m)} of {each.noise_samples}",
        f"{each.heard.refused} of {each.heard.fixes}",
    )


def tilt_rad(each: SessionErrors) -> float:
    """Return by how much the beacons' frame would lean, were any rotation allowed."""
    return math.acos(min(1.0, float(each.free.R[2, 2])))
