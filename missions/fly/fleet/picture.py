"""The picture of a relay or a team: who had which target, how the batteries ran down, and for how
long nobody was responsible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.fly.fleet.report import HOUR_S, MANY, size_text
from missions.look.report.palette import DIM, FAULT, tidy

COLOURS = ("#1f6fb4", "#c8620a", "#3a8f4d", "#7a4fb5", "#b0487a", "#5f6b76")
MINUTE_S = 60.0
MOST_ROWS = 40  # that make the picture higher


def draw(
    record: Mapping[str, Any],
    summary: Mapping[str, Any],
    path: Path,
) -> None:
    """Write a PNG of what ``relay.json`` or ``team.json`` and the run's ``summary.json`` say."""
    one_target = len(record["targets"]) == 1
    rows = min(len(record["drones" if one_target else "targets"]), MOST_ROWS)
    height_in = min(30.0, 6.4 + 0.42 * max(0, rows - 3))
    figure = Figure(figsize=(12.0, height_in), dpi=110, layout="constrained")
    who, batteries, gaps = figure.subplots(
        3,
        1,
        sharex=True,
        height_ratios=(max(1.1, 0.35 * rows), 2.0, 1.0),
    )
    unit_s, unit = (HOUR_S, "h") if summary["simulated_s"] >= HOUR_S else (MINUTE_S, "min")
    percent = summary["observed_percent"]["all"]
    observed = "nothing observed" if percent is None else f"{percent:.2f} % observed"
    figure.suptitle(
        f"{size_text(summary)}, {summary['simulated_s'] / unit_s:.1f} {unit}, seed {summary['seed']}: "
        f"{summary['outcome'].replace('_', ' ')}, {summary['legs_handed_over']} hand-overs, {observed}",
        fontsize=12,
    )
    if one_target:
        _draw_flights(who, record, unit_s)
    else:
        _draw_targets(who, record, summary["simulated_s"], unit_s)
    tidy(who, DIM)
    _draw_batteries(batteries, record, unit_s)
    _draw_gaps(gaps, record, summary["gap_bound_s"], unit_s)
    gaps.set_xlabel(unit)
    figure.savefig(path)


def _draw_flights(
    axes: Axes,
    record: Mapping[str, Any],
    unit_s: float,
) -> None:
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
                times,
                [-0.62] * len(times),
                marker,
                color=FAULT,
                ms=6,
                label=label,
                ls="none",
            )
    if failed or alarms:
        axes.legend(fontsize=8, loc="upper right", framealpha=0.9, ncols=2)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.9)
    axes.set_title("responsible for the target (thin: in the air)", loc="left", fontsize=10)


def _spans(
    samples: Sequence[Any],
    column: int,
    name: str,
    unit_s: float,
) -> list[tuple[float, float]]:
    """(begin, length) in units of time from each sample that names a drone in a column to the next
    one.
    """
    spans: list[tuple[float, float]] = []
    for sample, following in pairwise(samples):
        if name in sample[column]:
            spans.append((sample[0] / unit_s, (following[0] - sample[0]) / unit_s))
    return spans


def _draw_targets(
    axes: Axes,
    record: Mapping[str, Any],
    end_s: float,
    unit_s: float,
) -> None:
    """A bar for each drone while it has the target; red above it, when nobody truly looked."""
    rows = {name: row for row, name in enumerate(record["targets"])}
    colours = {name: COLOURS[row % len(COLOURS)] for row, name in enumerate(record["drones"])}
    few = len(rows) <= MANY
    for spell in record["spells"]:
        row = rows[spell["target"]]
        since_s = spell["from_s"]
        to_s = end_s if spell["to_s"] is None else spell["to_s"]
        long = (to_s - since_s) / unit_s
        axes.broken_barh(
            [(since_s / unit_s, long)],
            (row - 0.34, 0.68),
            color=colours[spell["drone"]],
            ec="white",
        )
        if few and to_s - since_s > 0.03 * end_s:
            middle = since_s / unit_s + 0.5 * long
            axes.text(
                middle,
                row,
                spell["drone"],
                ha="center",
                va="center",
                fontsize=8,
                color="white",
            )
    for name, spells in record["unobserved"].items():
        bars = [(since_s / unit_s, (to_s - since_s) / unit_s) for since_s, to_s in spells]
        axes.broken_barh(bars, (rows[name] - 0.46, 0.1), color=FAULT, ec=FAULT)
    axes.set_yticks(range(len(rows)) if few else [], list(rows) if few else [])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_title(
        "who has which target (red above: nobody truly looked at it)",
        loc="left",
        fontsize=10,
    )


def _draw_batteries(
    axes: Axes,
    record: Mapping[str, Any],
    unit_s: float,
) -> None:
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


def _draw_gaps(
    axes: Axes,
    record: Mapping[str, Any],
    bound_s: float,
    unit_s: float,
) -> None:
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
