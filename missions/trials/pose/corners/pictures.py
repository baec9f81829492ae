"""Figures of the trial of the corners: error by condition and method, and what the conditions look
like.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
from matplotlib.axes import Axes

from missions.look.report.palette import COUNT, DIM, FAULT, MARKER, OWN_BOX, ROLE, tidy
from missions.trials.pose.corners.conditions import CONDITIONS
from missions.trials.pose.corners.methods import METHODS, TITLES
from missions.trials.pose.corners.score import Score
from missions.trials.pose.corners.shots import CornerShot
from missions.trials.shared.drawing import save, sheet
from path.messages import Role

COLOURS = {
    "subpix": FAULT,
    "contour": DIM,
    "apriltag": COUNT,
    "edges": ROLE[Role.RECEIVER],
    "photometric": ROLE[Role.SENDER],
    "expected": MARKER,
}
STRIP_COLUMNS = 6
SHOWN_METHODS = {"subpix": FAULT, "photometric": MARKER}

Scores = Mapping[tuple[str, str, str], Score | None]
"""By camera, condition and method."""


def draw_errors(
    scores: Scores,
    cameras: Sequence[str],
    path: Path,
) -> None:
    """Error of every method in every condition, a panel for each camera."""
    figure = sheet(12.0, 0.6 + 2.9 * len(cameras))
    panels = figure.subplots(len(cameras), 1, sharex=True, squeeze=False)[:, 0]
    for axes, camera in zip(panels, cameras, strict=True):
        _draw_camera(axes, scores, camera)
    panels[0].legend(fontsize=8, loc="upper left", ncols=len(METHODS), framealpha=0.9)
    panels[-1].set_xticks(
        range(len(CONDITIONS)),
        [c.title for c in CONDITIONS.values()],
        rotation=35,
        ha="right",
    )
    save(figure, path)


def _draw_camera(
    axes: Axes,
    scores: Scores,
    camera: str,
) -> None:
    step = 0.7 / len(METHODS)
    for number, method in enumerate(METHODS):
        shown = [
            (k, s)
            for k, name in enumerate(CONDITIONS)
            if (s := scores[camera, name, method]) is not None
        ]
        x = [k + step * (number - 0.5 * (len(METHODS) - 1)) for k, _ in shown]
        y = [s.rms_px for _, s in shown]
        low, high = ([abs(s.interval_px[end] - s.rms_px) for _, s in shown] for end in (0, 1))
        axes.errorbar(
            x,
            y,
            (low, high),
            fmt="o",
            ms=4,
            lw=1.2,
            color=COLOURS[method],
            label=TITLES[method],
        )
    axes.set_yscale("log")
    axes.set_ylim(0.006, 1.5)
    axes.set_yticks(
        [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0], ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]
    )
    axes.grid(axis="y", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlim(-0.5, len(CONDITIONS) - 0.5)
    axes.set_title(camera, loc="left", fontsize=10)
    axes.set_ylabel("px RMS per axis", fontsize=9)
    tidy(axes)


def draw_strip(samples: Sequence[CornerShot], path: Path) -> None:
    """The shown view in every condition, with true and found corners."""
    shown = [sample for sample in samples if sample.picture is not None]
    rows = math.ceil(len(shown) / STRIP_COLUMNS)
    figure = sheet(2.0 * STRIP_COLUMNS, 2.2 * rows + 0.3)
    panels = figure.subplots(rows, STRIP_COLUMNS, squeeze=False).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, sample in zip(panels, shown, strict=False):
        _draw_sample(axes, sample)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=len(labels),
        fontsize=9,
        frameon=False,
    )
    save(figure, path)


def _draw_sample(axes: Axes, sample: CornerShot) -> None:
    if sample.picture is None:
        return
    height, width = sample.picture.shape[:2]
    u0, v0 = sample.corner_px
    extent = (u0 - 0.5, u0 + width - 0.5, v0 + height - 0.5, v0 - 0.5)
    axes.imshow(
        cv2.cvtColor(sample.picture, cv2.COLOR_BGR2RGB),
        extent=extent,
        interpolation="nearest",
    )
    u, v = sample.true_px.T
    axes.plot(u, v, "+", ms=11, mew=1.4, color=OWN_BOX, label="true")
    for method, color in SHOWN_METHODS.items():
        found = sample.found[method]
        if found is not None:
            axes.plot(*found.corners_px.T, "x", ms=5, mew=1.2, color=color, label=TITLES[method])
    axes.set_title(CONDITIONS[sample.condition].title, fontsize=9)
