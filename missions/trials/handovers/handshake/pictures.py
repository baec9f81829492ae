"""Figures of the handshake."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from missions.look.report.palette import DIM, NEEDED
from missions.trials.handovers.handshake.attempts import FAULT_NAMES, LIMIT_S, Tried
from missions.trials.handovers.handshake.missions import Flown, of_gate, seconds_of
from missions.trials.handovers.judging import GATE_TITLES, GATES, times_s, verdicts_of
from missions.trials.handovers.pictures import COLOURS, draw_shares
from missions.trials.shared.drawing import panels, save
from missions.trials.shared.statistics import wilson

PAPER_S = {"paper, median": 7.20, "paper, 90th percentile": 7.95}
BIN_S = 0.1


def draw_times(
    flown: Flown,
    tried: Tried,
    path: Path,
) -> None:
    """Draw the times to the commit. Raises OSError when it cannot be written."""
    figure, (left, right) = panels(11.0, 4.2, columns=2)
    _missions(left, seconds_of(of_gate(flown, "count")))
    for gate in GATES:
        title = GATE_TITLES[gate]
        attempts = len(verdicts_of(tried, gate))
        draw_shares(right, gate, times_s(tried, gate), attempts, f"Monte-Carlo hand-overs, {title}")
        own = of_gate(flown, gate)
        draw_shares(right, gate, seconds_of(own), len(own), f"missions, {title}", style="--")
    right.set(
        xlabel="time from the first agreeing pair, s",
        ylabel="share of all attempts",
        xlim=(0.0, LIMIT_S),
    )
    right.legend(
        fontsize=7,
        frameon=False,
        handlelength=1.4,
        loc="lower left",
        bbox_to_anchor=(0.14, 0.0),
    )
    save(figure, path)


def _missions(axes: Axes, seconds: Sequence[float]) -> None:
    last = max([9.0, *seconds])
    bins = np.arange(6.9, last + 2.0 * BIN_S, BIN_S)
    axes.hist(
        seconds,
        bins=bins.tolist(),
        color=COLOURS["count"],
        label=f"{len(seconds)} commits, level sim",
    )
    for style, (name, value) in zip(("-", ":"), PAPER_S.items(), strict=True):
        axes.axvline(value, color=NEEDED, ls=style, lw=1.2, label=f"{name} {value:.2f} s")
    axes.set(xlabel="time from the first agreeing pair to the commit, s", ylabel="missions")
    axes.legend(fontsize=8, frameon=False)


def draw_faults(tried: Tried, path: Path) -> None:
    """Draw the shares that committed, by fault and gate. Raises OSError when it cannot be
    written.
    """
    figure, (axes,) = panels(11.0, 4.6)
    rows = np.arange(len(FAULT_NAMES))
    for gate, beside in zip(GATES, (-0.2, 0.2), strict=True):
        shares: list[float] = []
        reach: list[tuple[float, float]] = []
        for name in FAULT_NAMES:
            judged = verdicts_of([each for each in tried if each.fault == name], gate)
            committed = sum(each.committed for each in judged)
            share = committed / len(judged) if judged else 0.0
            low, high = wilson(committed, len(judged))
            shares.append(share)
            reach.append((abs(share - low), abs(high - share)))
        axes.barh(
            rows + beside, shares, 0.38, xerr=np.array(reach).T, color=COLOURS[gate], ecolor=DIM,
            label=GATE_TITLES[gate],
        )  # fmt: skip
    axes.set_yticks(rows.tolist(), [name.replace("_", " ") for name in FAULT_NAMES])
    axes.invert_yaxis()
    axes.set(xlabel="share of attempts that committed", xlim=(0.0, 1.0))
    axes.legend(fontsize=8, frameon=False, ncol=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    save(figure, path)
