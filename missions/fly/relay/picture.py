"""The picture of a relay: who was responsible, and how the batteries ran down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.look.report.palette import DIM, FAULT, tidy

COLOURS = ("#1f6fb4", "#c8620a", "#3a8f4d", "#7a4fb5", "#b0487a", "#5f6b76")
HOUR_S = 3600.0
MINUTE_S = 60.0
MANY = 16  # drones or targets: more have no names at the axis


def draw_relay(record: Mapping[str, Any], summary: Mapping[str, Any], path: Path) -> None:
    """Write a PNG. ``record`` is ``relay.json``, ``summary`` the relay's ``summary.json``."""
    figure = Figure(figsize=(12.0, 6.4), dpi=120, layout="constrained")
    who, batteries, gaps = figure.subplots(3, 1, sharex=True, height_ratios=(1.1, 2.2, 1.0))
    unit_s, unit = (HOUR_S, "h") if summary["simulated_s"] >= HOUR_S else (MINUTE_S, "min")
    figure.suptitle(
        f"relay of {summary['drones']} drones, {summary['simulated_s'] / unit_s:.1f} {unit}, seed {summary['seed']}: "
        f"{summary['outcome'].replace('_', ' ')}, {summary['legs_handed_over']} hand-overs",
        fontsize=12,
    )
    _draw_flights(who, record, unit_s)
    draw_batteries(batteries, record, unit_s)
    _draw_gaps(gaps, record, summary["gap_bound_s"], unit_s)
    gaps.set_xlabel(unit)
    figure.savefig(path)


def _draw_flights(axes: Axes, record: Mapping[str, Any], unit_s: float) -> None:
    """A thin line in the air, a thick bar while responsible."""
    names: Sequence[str] = record["drones"]
    for row, name in enumerate(names):
        aloft, holds = (_spans(record["samples"], column, name, unit_s) for column in (3, 1))
        colour = COLOURS[row % len(COLOURS)]
        axes.broken_barh(aloft, (row - 0.08, 0.16), color=colour, alpha=0.5)
        axes.broken_barh(holds, (row - 0.36, 0.72), color=colour)
    failed = [
        leg["called_s"] / unit_s
        for leg in record["legs"]
        if leg["outcome"] not in ("", "committed")
    ]
    alarms = [event["time_s"] / unit_s for event in record["events"] if event["what"] == "alarm"]
    for times, marker, label in ((failed, "x", "leg failed"), (alarms, "v", "no relief ready")):
        if times:
            axes.plot(
                times, [-0.62] * len(times), marker, color=FAULT, ms=6, label=label, ls="none"
            )
    if failed or alarms:
        axes.legend(fontsize=8, loc="upper right", framealpha=0.9, ncols=2)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.9)
    axes.set_title("responsible for the target (thin: in the air)", loc="left", fontsize=10)
    tidy(axes, DIM)


def draw_batteries(axes: Axes, record: Mapping[str, Any], unit_s: float) -> None:
    """The charge of each drone over time, in units of ``unit_s``, and the reserve."""
    times = [sample[0] / unit_s for sample in record["samples"]]
    names = record["drones"]
    for row, name in enumerate(names):
        charge = [100.0 * sample[2][row] for sample in record["samples"]]
        axes.plot(
            times,
            charge,
            color=COLOURS[row % len(COLOURS)],
            lw=1.1 if len(names) <= MANY else 0.4,
            label=name,
        )
    axes.axhline(100.0 * record["reserve"], color=FAULT, lw=1.2, ls="--", label="reserve")
    axes.set_ylim(0.0, 103.0)
    axes.set_ylabel("battery, %", fontsize=9)
    if len(names) <= MANY:
        axes.legend(fontsize=8, loc="lower left", ncols=8, framealpha=0.9)
    tidy(axes, DIM)


def _draw_gaps(axes: Axes, record: Mapping[str, Any], bound_s: float, unit_s: float) -> None:
    legs = [leg for leg in record["legs"] if leg["gap_s"] is not None and leg["held_s"] is not None]
    axes.plot(
        [leg["held_s"] / unit_s for leg in legs],
        [max(leg["gap_s"], 1e-4) for leg in legs],
        ".",
        color="#333333",
    )
    axes.axhline(bound_s, color=FAULT, lw=1.2, ls="--", label="bound")
    axes.set_yscale("log")
    axes.set_ylim(5e-4, 4.0)
    axes.set_ylabel("nobody, s", fontsize=9)
    axes.legend(fontsize=8, loc="center right", framealpha=0.9)
    tidy(axes, DIM)


def _spans(
    samples: Sequence[Any], column: int, name: str, unit_s: float
) -> list[tuple[float, float]]:
    """(begin, length) in units of time from each sample that names a drone in a column to the next
    one.
    """
    spans: list[tuple[float, float]] = []
    for sample, following in pairwise(samples):
        if name in sample[column]:
            spans.append((sample[0] / unit_s, (following[0] - sample[0]) / unit_s))
    return spans
