"""replay.png: how the two views agreed in a run, as it was flown and with other settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.look.report.palette import COUNT, FAULT, NEEDED, ROLE
from path.messages import Role

if TYPE_CHECKING:
    from missions.look.replay.command import Replayed


def draw_replay(columns: Mapping[str, Sequence[Replayed]], path: Path) -> None:
    """A row for each drone that judged answers, a column by its title. Raises OSError when it
    cannot be written.
    """
    rows = [
        row for row in zip(*columns.values(), strict=True) if any(drone.verdicts for drone in row)
    ]
    figure = Figure(figsize=(12.0, 1.0 + 3.2 * max(1, len(rows))), dpi=110, layout="constrained")
    axes = figure.subplots(max(1, len(rows)), len(columns), squeeze=False, sharey=True)
    for panels, row in zip(axes, rows, strict=False):
        for panel, drone, title in zip(panels, row, columns, strict=True):
            _draw(panel, drone, f"{drone.drone}, {title}")
    figure.savefig(path, format="png", metadata={"Software": None})


def _draw(
    axes: Axes,
    drone: Replayed,
    title: str,
) -> None:
    verdicts = drone.verdicts
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_ylim(0.0, 1.02)
    axes.set_ylabel("IoU", fontsize=9)
    if not verdicts:
        return
    begin_ns = verdicts[0]["capture_ns"]
    seconds = np.array([(verdict["capture_ns"] - begin_ns) * 1e-9 for verdict in verdicts])
    iou, tau = (
        np.array([np.nan if v[name] is None else v[name] for v in verdicts])
        for name in ("iou", "tau")
    )
    agreed = np.array([bool(verdict["agreed"]) for verdict in verdicts])
    lines = [
        *axes.plot(seconds, tau, color=NEEDED, lw=1.4, label="needed (τ)"),
        *axes.plot(
            seconds[agreed],
            iou[agreed],
            ".",
            ms=3,
            color=ROLE[Role.SENDER],
            label="agreed",
        ),
        *axes.plot(seconds[~agreed], iou[~agreed], "x", ms=5, color=FAULT, label="does not count"),
    ]
    share = [_share(verdict["count"], verdict["needed"]) for verdict in verdicts]
    if verdicts[0]["evidence_needed"] is not None:
        share = [
            _share(verdict["evidence"] or 0.0, verdict["evidence_needed"]) for verdict in verdicts
        ]
    lines += axes.plot(seconds, share, color=COUNT, lw=1.2, label="share of what the gate needs")
    for complete in drone.complete:
        axes.axvline((complete.stamp_ns - begin_ns) * 1e-9, color="#2a9d3a", lw=1.5)
    axes.set_xlabel("s    (green line: the gate is complete)", fontsize=8)
    axes.legend(
        handles=lines,
        fontsize=8,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.2),
        ncols=4,
        frameon=False,
    )


def _share(value: float, needed: float) -> float:
    return min(value / needed, 1.0)
