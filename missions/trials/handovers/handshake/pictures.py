"""Figures of the handshake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.report.palette import COUNT, DIM, NEEDED, ROLE
from missions.trials.handovers.handshake.flights import FlightResult
from missions.trials.handovers.handshake.handovers import FAULT_NAMES, GATES, LIMIT_S, HandshakeAttempt, judged_by
from missions.trials.shared.statistics import wilson
from path.config import GateKind
from path.messages import Role

COLOURS: Mapping[GateKind, str] = {"count": ROLE[Role.SENDER], "evidence": COUNT}
NAMES: Mapping[GateKind, str] = {"count": "350 pairs", "evidence": "evidence"}
PAPER_S = (7.20, 7.95)


def draw_times(
    flown: Mapping[GateKind, Sequence[FlightResult]],
    times: Mapping[GateKind, Sequence[float]],
    attempts: Mapping[GateKind, int],
    path: Path,
) -> None:
    """``times``: of the commits in so many ``attempts`` of each gate. Raises OSError when it cannot be written."""
    figure = Figure(figsize=(11.0, 4.2), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    _missions(left, [each.seconds for each in flown["count"] if each.seconds is not None])
    for gate in GATES:
        _shares(right, times[gate], attempts[gate], COLOURS[gate], f"Monte-Carlo hand-overs, {NAMES[gate]}")
        own = [each.seconds for each in flown[gate] if each.seconds is not None]
        _shares(right, own, len(flown[gate]), COLOURS[gate], f"missions, {NAMES[gate]}", dashed=True)
    right.set(xlabel="time from the first agreeing pair, s", ylabel="share of all attempts", xlim=(0.0, LIMIT_S))
    right.set_ylim(0.0, 1.02)
    right.grid(alpha=0.3)
    right.legend(fontsize=7, frameon=False, handlelength=1.4, loc="lower left", bbox_to_anchor=(0.14, 0.0))
    figure.savefig(path, format="png", metadata={"Software": None})


def _missions(axes: Axes, seconds: Sequence[float]) -> None:
    bins = np.arange(6.9, max([9.0, *seconds]) + 0.2, 0.1)
    axes.hist(seconds, bins=bins.tolist(), color=COLOURS["count"], label=f"{len(seconds)} commits, level sim")
    for value, name in zip(PAPER_S, ("paper, median", "paper, 90th percentile"), strict=True):
        axes.axvline(value, color=NEEDED, ls="-" if value == PAPER_S[0] else ":", lw=1.2, label=f"{name} {value:.2f} s")
    axes.set(xlabel="time from the first agreeing pair to the commit, s", ylabel="missions")
    axes.legend(fontsize=8, frameon=False)


def _shares(
    axes: Axes, seconds: Sequence[float], attempts: int, colour: str, label: str, *, dashed: bool = False
) -> None:
    if not seconds:
        return
    ordered = np.sort(np.array(seconds))
    share = np.arange(1, len(ordered) + 1) / attempts
    style = "--" if dashed else "-"
    axes.step(
        ordered, share, where="post", color=colour, ls=style, lw=1.4, label=f"{label} ({len(ordered)} of {attempts})"
    )


def draw_faults(tried: Sequence[HandshakeAttempt], path: Path) -> None:
    """Raises OSError when it cannot be written."""
    figure = Figure(figsize=(11.0, 4.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    rows = np.arange(len(FAULT_NAMES))
    for k, gate in enumerate(GATES):
        of_fault = [judged_by([each for each in tried if each.fault == name], gate) for name in FAULT_NAMES]
        counts = [(sum(j.committed for j in judged), len(judged)) for judged in of_fault]
        share = np.array([done / total if total else 0.0 for done, total in counts])
        ends = np.array([wilson(done, total) for done, total in counts])
        reach = np.abs(np.stack((share - ends[:, 0], ends[:, 1] - share)))
        axes.barh(rows + 0.2 * (2 * k - 1), share, 0.38, xerr=reach, color=COLOURS[gate], ecolor=DIM, label=NAMES[gate])
    axes.set_yticks(rows.tolist(), [name.replace("_", " ") for name in FAULT_NAMES])
    axes.invert_yaxis()
    axes.set(xlabel="share of attempts that committed", xlim=(0.0, 1.0))
    axes.legend(fontsize=8, frameon=False, ncol=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.savefig(path, format="png", metadata={"Software": None})
