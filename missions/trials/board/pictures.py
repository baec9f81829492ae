"""Figure of the photograph of a board: where the corners of two methods are off, and how the methods compare."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missions.report.palette import FAULT, MARKER
from missions.trials.board.file import BoardPhotograph
from missions.trials.board.trial import BOARD_GOAL_PX, BOARD_TITLES, OnBoard

DPI = 110
ARROW = 60.0  # px drawn for a pixel of error
SHOWN = {"subpix": FAULT, "photometric": MARKER}


def draw_board(board: BoardPhotograph, scores: Mapping[str, OnBoard], path: Path) -> None:
    figure = Figure(figsize=(12.0, 5.2), dpi=DPI, layout="constrained")
    photograph, spread = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_errors(photograph, board, scores)
    _draw_spread(spread, scores)
    figure.savefig(path, format="png", metadata={"Software": None})


def _draw_errors(axes: Axes, board: BoardPhotograph, scores: Mapping[str, OnBoard]) -> None:
    axes.imshow(board.grey, cmap="gray", vmin=-80, vmax=300)
    for name, colour in SHOWN.items():
        if name in scores:
            u, v = scores[name].corners_px.reshape(-1, 2).T
            du, dv = ARROW * scores[name].left.errors_px.reshape(-1, 2).T
            title = BOARD_TITLES[name]
            axes.quiver(u, v, du, dv, angles="xy", scale_units="xy", scale=1.0, color=colour, width=0.003, label=title)
    axes.set_axis_off()
    axes.set_title(f"errors of corners, {ARROW:.0f} times larger", loc="left", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _draw_spread(axes: Axes, scores: Mapping[str, OnBoard]) -> None:
    names = list(scores)
    middle = np.array([scores[name].robust_px for name in names])
    ends = np.array([scores[name].interval_px for name in names]).T
    y = np.arange(len(names))
    axes.errorbar(middle, y, xerr=np.abs(ends - middle), fmt="o", ms=5, color="#333333", label="robust, 95 %")
    axes.plot([scores[name].rms_px for name in names], y, "x", ms=6, color="#999999", label="rms")
    axes.axvline(BOARD_GOAL_PX, color="#999999", lw=1.0, ls="--")
    axes.set_yticks(y, [BOARD_TITLES[name] for name in names], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("px per axis", fontsize=9)
    axes.legend(fontsize=8)
    axes.grid(axis="x", color="#dddddd", lw=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
