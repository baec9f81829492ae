"""Pictures of the ambiguity trial: outcomes, sweeps, and what went wrong in both views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import ConnectionPatch, Rectangle

from missions.look.report.palette import COUNT, DIM, FAULT, OWN_BOX, PRIOR, ROLE, tidy
from missions.trials.rivals.score import OUTCOMES, FrameTally, Outcome
from missions.trials.shared.drawing import panels, save, sheet
from path.baselines.features import Image
from path.messages import Role
from path.observations import Box, Region
from path.values import frozen

NAMES: dict[Outcome, str] = {
    "tp": "target acquired",
    "tn": "rightly nothing",
    "fn": "target not acquired",
    "fp": "somebody else",
}
SHADES: dict[Outcome, str] = {"tp": "#2a7f5f", "tn": "#9fd0b8", "fn": "#d9d9d9", "fp": FAULT}
ORDER: tuple[Outcome, ...] = ("tp", "tn", "fn", "fp")
METHOD_COLOURS = {"path": ROLE[Role.SENDER], "path_color": "#6ba8d8", "orb": COUNT}
METHOD_COLOURS["xfeat"] = ROLE[Role.RECEIVER]
METHOD_COLOURS["own"] = "#444444"
WRONG = "#ff3030"
RIGHT = OWN_BOX


Sweep = tuple[str, tuple[float, ...], list[dict[str, FrameTally]]]
"""Title of its axis, its values, and at each of them the frames of every method by outcome."""


@frozen
class Example:
    """One pair of frames, and what a method made of it.

    Attributes:
        chosen: what the method chose in D2's image; None: nothing.
        others: D2's other boxes.
        truth: where the target really is in D2's image; None when it is not to be seen.
        lines: (n, 4) matched points: u, v in D1's image, u, v in D2's.
    """

    title: str
    images: tuple[Image, Image]
    tracked: Box
    chosen: Box | None
    right: bool
    others: tuple[Box, ...]
    truth: Box | None
    lines: np.ndarray[tuple[int, int], np.dtype[np.float32]] | None = None
    region: Region | None = None


def draw_outcomes(
    tallies: Mapping[str, FrameTally],
    titles: Mapping[str, str],
    path: Path,
) -> None:
    """One bar a method, frames by outcome."""
    figure, (axes,) = panels(10.0, 0.9 + 0.62 * len(tallies))
    for row, counts in enumerate(tallies.values()):
        left = 0
        for each in ORDER:
            frames = getattr(counts, each)
            axes.barh(
                row,
                frames,
                left=left,
                height=0.66,
                color=SHADES[each],
                label=NAMES[each] if row == 0 else None,
            )
            if frames >= 0.025 * counts.frames:
                colour = "white" if each in ("tp", "fp") else "#222222"
                axes.text(
                    left + frames / 2,
                    row,
                    str(frames),
                    ha="center",
                    va="center",
                    fontsize=9,
                    color=colour,
                )
            left += frames
        axes.text(
            left * 1.008, row, f"{100 * counts.accuracy:.1f} % right, {100 * counts.fp / counts.frames:.1f} % wrong",
            va="center", fontsize=9,
        )  # fmt: skip
        axes.set_xlim(0, left * 1.25)
    axes.set_yticks(range(len(tallies)), [titles[name] for name in tallies], fontsize=10)
    axes.invert_yaxis()
    axes.set_xlabel("frames", fontsize=9)
    tidy(axes)
    figure.legend(loc="outside upper left", ncols=4, fontsize=9, frameon=False)
    save(figure, path)


def draw_sweeps(sweeps: Sequence[Sweep], titles: Mapping[str, str], path: Path) -> None:
    """Accuracy of every method along each sweep; 95 % intervals as bars."""
    figure = sheet(6.2 * len(sweeps), 4.2)
    for column, (title, values, points) in enumerate(sweeps):
        axes = figure.add_subplot(1, len(sweeps), column + 1)
        step = (max(values) - min(values)) / 100.0
        for k, method in enumerate(points[0]):
            tallies = [point[method] for point in points]
            x = np.array(values) + step * (k - 0.5 * (len(points[0]) - 1))
            y = np.array([each.accuracy for each in tallies])
            low, high = np.array([each.interval("tp", "tn") for each in tallies]).T
            axes.errorbar(
                x, 100 * y, 100 * np.maximum(0.0, (y - low, high - y)), color=METHOD_COLOURS[method],
                label=titles[method], marker="o", ms=4, lw=1.5, elinewidth=0.9, capsize=2,
            )  # fmt: skip
        axes.set_ylim(-2, 103)
        axes.set_xlabel(title, fontsize=9)
        axes.set_ylabel("frames with the right answer, %" if column == 0 else "", fontsize=9)
        axes.grid(axis="y", color="#e6e6e6", lw=0.7)
        tidy(axes)
        if column == 0:
            axes.legend(fontsize=9, loc="lower right", framealpha=0.9)
    save(figure, path)


def draw_examples(examples: Sequence[Example], path: Path) -> None:
    """One row an example: D1's view on the left, D2's on the right."""
    figure = sheet(13.0, 3.95 * len(examples))
    rows = figure.subfigures(len(examples), 1, squeeze=False)[:, 0]
    for row, example in zip(rows, examples, strict=True):
        row.suptitle(example.title, x=0.012, ha="left", fontsize=11, fontweight="bold")
        left, right = row.subplots(1, 2)
        _show(left, example.images[0], "D1: the person it tracks")
        _frame(left, example.tracked, RIGHT, 2.2)
        _show(
            right,
            example.images[1],
            "D2: white what its detector found, " + _chosen_words(example),
        )
        for box in example.others:
            _frame(right, box, "white", 0.9)
        if example.truth is not None:
            _frame(right, example.truth, RIGHT, 1.4, "--")
        if example.region is not None:
            area = example.region
            _frame(
                right,
                Box(area.x0, area.y0, area.x1 - area.x0, area.y1 - area.y0),
                PRIOR,
                1.2,
                ":",
            )
        if example.chosen is not None:
            _frame(right, example.chosen, RIGHT if example.right else WRONG, 2.6)
        _join(row, left, right, example)
    save(figure, path)


def _chosen_words(example: Example) -> str:
    dashed = "" if example.truth is None else ", green dashed where the target is"
    if example.chosen is None:
        return "nothing chosen" + dashed
    return ("green chosen" if example.right else "red chosen") + dashed


def _join(
    row: object,
    left: Axes,
    right: Axes,
    example: Example,
) -> None:
    """Lines between matched features of both views."""
    if example.lines is None:
        return
    colour = RIGHT if example.right else WRONG
    step = max(1, math.ceil(len(example.lines) / 25))
    for u1, v1, u2, v2 in example.lines[::step].tolist():
        line = ConnectionPatch(
            (u1, v1),
            (u2, v2),
            "data",
            "data",
            axesA=left,
            axesB=right,
            color=colour,
            lw=0.6,
        )
        row.add_artist(line)  # type: ignore[attr-defined]  # a SubFigure


def _show(
    axes: Axes,
    image: Image,
    title: str,
) -> None:
    axes.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), interpolation="lanczos")
    axes.set_title(title, fontsize=8.5, loc="left", color=DIM)
    axes.set_axis_off()


def _frame(
    axes: Axes,
    box: Box,
    colour: str,
    width: float,
    style: str = "-",
) -> None:
    axes.add_patch(
        Rectangle((box.x, box.y), box.w, box.h, fill=False, ec=colour, lw=width, ls=style)
    )


assert set(ORDER) == set(OUTCOMES)
