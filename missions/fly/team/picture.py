"""The picture of a team: who observed what, when nobody did, and how the batteries ran down."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.fly.relay.picture import COLOURS, HOUR_S, MANY, MINUTE_S, draw_batteries
from missions.look.report.palette import DIM, FAULT, tidy


def draw_team(record: Mapping[str, Any], summary: Mapping[str, Any], path: Path) -> None:
    """Write a PNG. ``record`` is ``team.json``, ``summary`` the team's ``summary.json``."""
    targets = len(record["targets"])
    drones = len(record["drones"])
    figure = Figure(
        figsize=(12.0, min(30.0, 3.6 + 0.42 * min(targets, 40) + 1.6)),
        dpi=110,
        layout="constrained",
    )
    who, batteries = figure.subplots(
        2, 1, sharex=True, height_ratios=(max(1.0, 0.35 * min(targets, 40)), 1.6)
    )
    unit_s, unit = (HOUR_S, "h") if summary["simulated_s"] >= HOUR_S else (MINUTE_S, "min")
    percent = summary["observed_percent"]["all"]
    figure.suptitle(
        f"{drones} drones, {targets} targets, {summary['simulated_s'] / unit_s:.1f} {unit}, seed {summary['seed']}: "
        f"{summary['outcome'].replace('_', ' ')}, {summary['legs_handed_over']} hand-overs, "
        + ("nothing observed" if percent is None else f"{percent:.2f} % observed"),
        fontsize=12,
    )
    _draw_targets(who, record, summary["simulated_s"], unit_s)
    draw_batteries(batteries, record, unit_s)
    batteries.set_xlabel(unit)
    figure.savefig(path)


def _draw_targets(axes: Axes, record: Mapping[str, Any], end_s: float, unit_s: float) -> None:
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
                middle, row, spell["drone"], ha="center", va="center", fontsize=8, color="white"
            )
    for name, spells in record["unobserved"].items():
        bars = [(since_s / unit_s, (to_s - since_s) / unit_s) for since_s, to_s in spells]
        axes.broken_barh(bars, (rows[name] - 0.46, 0.1), color=FAULT, ec=FAULT)
    axes.set_yticks(range(len(rows)) if few else [], list(rows) if few else [])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_title(
        "who has which target (red above: nobody truly looked at it)", loc="left", fontsize=10
    )
    tidy(axes, DIM)
