"""Figure of the sets of photographs: a view of each, corners by method, D2's error by what the pose
rests on.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from missions.look.report.palette import COUNT, DIM, FAULT, MARKER, NEEDED, tidy
from missions.trials.real.corners import METHOD_TITLES
from missions.trials.real.results import Figure95, SetScore
from missions.trials.shared.drawing import save, sheet

SHOWN = {"subpix": FAULT, "apriltag": COUNT, "photometric": MARKER}
POSES = {
    "single": ("one marker", MARKER),
    "plate": ("two markers", COUNT),
    "perfect_corners": ("board's corners", DIM),
}
SHIFT = 0.18  # between the marks of one row


def draw_sets(scores: Sequence[SetScore], path: Path) -> None:
    figure = sheet(13.0, 1.2 + 1.9 * len(scores))
    grid = figure.add_gridspec(len(scores), 3, width_ratios=(1.6, 1.4, 1.4))
    for row, score in enumerate(scores):
        axes = figure.add_subplot(grid[row, 0])
        both = [score.example] if score.twin is None else [score.example, score.twin.score.example]
        axes.imshow(np.concatenate(both, axis=1), cmap="gray", vmin=0, vmax=255)
        twin = "" if score.twin is None else "; its twin"
        axes.set_title(f"{score.name}: {score.views} views{twin}", loc="left", fontsize=9)
        axes.set_axis_off()
    corners = figure.add_subplot(grid[:, 1])
    poses = figure.add_subplot(grid[:, 2])
    for number, (method, colour) in enumerate(SHOWN.items()):
        own = [
            (row, s.corners[method].robust_px)
            for row, s in enumerate(scores)
            if method in s.corners
        ]
        _marks(corners, own, (number - 1) * SHIFT, 1.0, colour, METHOD_TITLES[method])
    for number, (kind, (title, colour)) in enumerate(POSES.items()):
        own = [(row, s.poses[kind].d2_mean_m) for row, s in enumerate(scores) if kind in s.poses]
        _marks(poses, own, (number - 1) * SHIFT, 1e3, colour, title)
    _finish(corners, scores, "corners, px robust per axis, 95 %")
    _finish(poses, scores, "D2's error, mean, mm, 95 %")
    save(figure, path)


def _marks(
    axes: Axes,
    own: Sequence[tuple[int, Figure95]],
    shift: float,
    scale: float,
    colour: str,
    title: str,
) -> None:
    if not own:
        return
    rows = np.array([row for row, _ in own]) + shift
    values = scale * np.array([figure.value for _, figure in own])
    ends = scale * np.array([figure.interval for _, figure in own]).T
    spread = np.maximum(np.stack([values - ends[0], ends[1] - values]), 0.0)
    axes.errorbar(
        values,
        rows,
        xerr=spread,
        fmt="o",
        ms=6,
        color=colour,
        mec=NEEDED,
        mew=0.5,
        ecolor=DIM,
        label=title,
    )


def _finish(
    axes: Axes,
    scores: Sequence[SetScore],
    label: str,
) -> None:
    axes.set_ylim(len(scores) - 0.5, -0.5)
    axes.set_yticks(range(len(scores)), [score.name for score in scores], fontsize=8)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(label, fontsize=9)
    axes.grid(axis="x", color="#dddddd", lw=0.6)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    tidy(axes)
