"""Picture of a calibration: where the corners were, their residuals, and how the board was held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drivers.rig.calibration_file import MADE_BY
from missions.field.calibrate.collect import Collected
from missions.look.report.palette import COUNT, DIM, FAULT
from path.calibration.intrinsics import Intrinsics
from path.calibration.judge import GRID, coverage, tilts_deg

WIDTH_IN = 13.0
HEIGHT_IN = 5.2
DPI = 100
LONGEST_SHARE = 0.06  # of the image's width: length of the longest error as drawn


def draw_calibration(
    collected: Collected,
    solution: Intrinsics | None,
    file: Path,
) -> None:
    """Draw as PNG; without a solution what can be drawn without it. Raises OSError when it cannot
    be written.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI, layout="constrained")
    cover, errors, tilts = figure.subplots(1, 3)
    _draw_coverage(cover, collected)
    if solution is not None:
        _draw_errors(errors, solution)
        _draw_tilts(tilts, solution)
    else:
        errors.set_axis_off()
        tilts.set_axis_off()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, format="png", metadata={"Software": MADE_BY})


def _draw_coverage(axes: Axes, collected: Collected) -> None:
    views = [look.view for look in collected.looks if look.view is not None]
    width, height = collected.looks[0].size if collected.looks else (4, 3)
    if collected.sample is not None:
        axes.imshow(
            collected.sample,
            cmap="gray",
            alpha=0.35,
            extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        )
    for row, counts in enumerate(coverage(views, (width, height))):
        for column, count in enumerate(counts):
            x = (column + 0.5) / GRID[0] * width
            y = (row + 0.5) / GRID[1] * height
            axes.text(
                x,
                y,
                str(count),
                ha="center",
                va="center",
                fontsize=8,
                color=DIM if count else FAULT,
            )
    if views:
        corners = np.concatenate([view.corners_px for view in views])
        axes.scatter(corners[:, 0], corners[:, 1], s=2, color=COUNT, linewidths=0)
    axes.set(title="Corners of all views, and how many in each cell", xlim=(-0.5, width - 0.5),
             ylim=(height - 0.5, -0.5), xlabel="u, px", ylabel="v, px")  # fmt: skip
    axes.set_aspect("equal")


def _draw_errors(axes: Axes, solution: Intrinsics) -> None:
    corners = np.concatenate([view.corners_px for view in solution.views])
    errors = np.concatenate([view.errors_px for view in solution.views])
    width, height = solution.size
    longest = float(np.percentile(np.linalg.norm(errors, axis=1), 99))
    scale = LONGEST_SHARE * width / max(longest, 1e-6)
    axes.quiver(corners[:, 0], corners[:, 1], *(scale * errors.T), angles="xy", scale_units="xy", scale=1.0,
                width=0.0015, color=COUNT)  # fmt: skip
    axes.set(title=f"Errors, {scale:.0f} times enlarged: rms {solution.rms_px:.3f} px, "
                   f"left out {solution.held_out_px:.3f} px",
             xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u, px")  # fmt: skip
    axes.set_aspect("equal")


def _draw_tilts(axes: Axes, solution: Intrinsics) -> None:
    tilts = tilts_deg(solution)
    rms = np.array([view.rms_px for view in solution.views])
    distances = np.array([view.distance_m for view in solution.views])
    drawn = axes.scatter(
        tilts[:, 1],
        tilts[:, 0],
        c=distances,
        s=30.0 + 120.0 * rms / rms.max(),
        cmap="viridis",
    )
    axes.figure.colorbar(drawn, ax=axes, label="distance, m")
    reach = max(45.0, float(np.abs(tilts).max()) + 5.0)
    axes.set(title="Tilt of the board; the larger, the worse it fits", xlim=(-reach, reach), ylim=(-reach, reach),
             xlabel="turned, deg", ylabel="nodded, deg")  # fmt: skip
    axes.axhline(0.0, color=DIM, linewidth=0.5)
    axes.axvline(0.0, color=DIM, linewidth=0.5)
    axes.set_aspect("equal")
