"""Figures of the thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.report.palette import COUNT, DIM, FAULT, NEEDED, ROLE
from missions.trials.thresholds.choice import PAPER_N, RocCurve, Shares
from missions.trials.thresholds.grid import FRAMES, MAPPINGS, TAUS, grid
from missions.trials.thresholds.series import Rolled
from path.config import BoxMapping
from path.messages import Role

COLOURS: Mapping[BoxMapping, str] = {"center": ROLE[Role.SENDER], "corner": ROLE[Role.RECEIVER]}
MARKED = (0.25, 0.35, 0.45, 0.55)


def draw_roc(
    curves: Sequence[RocCurve], shares: Shares, rolled: Sequence[Rolled], default: int, chosen: int, path: Path
) -> None:
    """Raises OSError when it cannot be written."""
    figure = Figure(figsize=(13.5, 4.4), dpi=110, layout="constrained")
    pairs, handed, turned = figure.subplots(1, 3)
    for each in curves:
        colour = COLOURS[each.mapping]
        pairs.plot(each.false, each.true, color=colour, label=f"{each.mapping}: area {each.auc:.4f}")
        for tau in MARKED:
            k = round(tau * len(each.tau))
            pairs.plot(each.false[k], each.true[k], "o", ms=4, color=colour)
            pairs.annotate(f"{tau:g}", (each.false[k], each.true[k]), (5, -9), textcoords="offset points", fontsize=7)
    pairs.set(xlabel="pairs of something else that agree", ylabel="pairs of the target that agree", title="one pair")
    pairs.grid(alpha=0.3)
    pairs.legend(fontsize=8, loc="lower right")
    _handed(handed, shares, default, chosen)
    _turned(turned, rolled)
    figure.savefig(path, format="png", metadata={"Software": None})


def _handed(axes: Axes, shares: Shares, default: int, chosen: int) -> None:
    for mapping in MAPPINGS:
        rows = [k for k, setting in enumerate(grid()) if setting.mapping == mapping]
        x, y = shares.wrong[rows, PAPER_N], shares.right[rows, PAPER_N]
        axes.plot(x, y, ".", ms=4, color=COLOURS[mapping], label=f"{mapping}, 350 pairs")
    x, y = shares.wrong[default], shares.right[default]
    axes.plot(x, y, "-", color=COUNT, lw=1.0, label="default thresholds, other windows")
    for k in range(len(FRAMES)):
        axes.annotate(str(FRAMES[k]), (x[k], y[k]), (3, 4), textcoords="offset points", fontsize=7, color=COUNT)
    _mark(axes, shares.wrong[:, PAPER_N], shares.right[:, PAPER_N], default, chosen)
    axes.set(xlabel="forced wrong attempts handed over", ylabel="true attempts handed over in time", title="hand-overs")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower right")


def _mark(axes: Axes, x: np.ndarray, y: np.ndarray, default: int, chosen: int) -> None:
    axes.plot(x[default], y[default], "o", ms=9, mfc="none", mec=NEEDED, label="default")
    axes.plot(x[chosen], y[chosen], "s", ms=9, mfc="none", mec=FAULT, label="chosen by the rule")


def _turned(axes: Axes, rolled: Sequence[Rolled]) -> None:
    for k, mapping in enumerate(MAPPINGS):
        known = [(each.roll_deg, each.iou[k]) for each in rolled if each.iou is not None]
        angles = sorted({angle for angle, _ in known})
        middles = [float(np.median([iou for angle, iou in known if angle == each])) for each in angles]
        axes.plot([angle for angle, _ in known], [iou for _, iou in known], ".", ms=4, color=COLOURS[mapping])
        axes.plot(angles, middles, color=COLOURS[mapping], label=mapping)
    axes.set(xlabel="D2's camera rolled on its mount, degrees", ylabel="overlap, median of an attempt", ylim=(0.0, 1.0))
    axes.set_title("the same target under relative roll")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def draw_map(shares: Shares, default: int, chosen: int, path: Path) -> None:
    """Draws both shares over tau_min and tau_max, z0 and mapping as by default.

    Raises OSError when it cannot be written.
    """
    own = grid()[default]
    figure = Figure(figsize=(11.0, 4.6), dpi=110, layout="constrained")
    panels = figure.subplots(1, 2)
    titles = "true attempts handed over in time", "forced wrong attempts handed over"
    for axes, values, title in zip(panels, (shares.right, shares.wrong), titles, strict=True):
        table = np.full((len(TAUS), len(TAUS)), np.nan)
        for k, setting in enumerate(grid()):
            same = setting.tau_min == setting.tau_max or setting.z0_m == own.z0_m
            if setting.mapping == own.mapping and same and setting.tau_min in TAUS and setting.tau_max in TAUS:
                table[TAUS.index(setting.tau_max), TAUS.index(setting.tau_min)] = values[k, PAPER_N]
        step = 0.5 * (TAUS[1] - TAUS[0])
        edges = (TAUS[0] - step, TAUS[-1] + step)
        image = axes.imshow(table, origin="lower", extent=(*edges, *edges), cmap="viridis", aspect="equal")
        figure.colorbar(image, ax=axes, shrink=0.85)
        bright = 0.5 * (np.nanmin(table) + np.nanmax(table))
        for row, column in zip(*np.nonzero(np.isfinite(table)), strict=True):
            value = table[row, column]
            axes.text(TAUS[column], TAUS[row], f"{100 * value:.0f}", ha="center", va="center", fontsize=6,
                      color=NEEDED if value > bright else "white")  # fmt: skip
        axes.plot(own.tau_min, own.tau_max, "o", ms=15, mfc="none", mec=FAULT, label="default")
        picked = grid()[chosen]
        axes.plot(
            picked.tau_min, picked.tau_max, "s", ms=15, mfc="none", mec=NEEDED, label=f"chosen (z0 {picked.z0_m:g} m)"
        )
        axes.set(xlabel="tau_min", ylabel="tau_max", title=f"{title}, %")
    panels[0].legend(fontsize=8, loc="lower right")
    figure.suptitle(f"350 pairs, mapping {own.mapping}, z0 {own.z0_m:g} m", fontsize=10, color=DIM)
    figure.savefig(path, format="png", metadata={"Software": None})
