"""Pictures of the static experiment: the seven configurations, the errors of each method, and a
view of D2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

from missions.look.report.palette import COUNT, DIM, FAULT, MARKER, NEEDED, PRIOR, ROLE, tidy
from missions.trials.pose.static.methods import METHODS, Method, Results
from missions.trials.pose.static.report import GOAL_MEAN_M, HEADLINE, METHOD_TITLES, SEVEN
from missions.trials.pose.static.stage import CONFIGURATIONS, HEIGHT_M, PLACES_M, Mounts, nominal
from missions.trials.shared.drawing import save, sheet
from path.arrays import Array, Image
from path.cycle.prior import Prior
from path.geometry.transforms import Pose
from path.messages import Role

COLOURS: dict[Method, str] = {
    "ippe": FAULT,
    "gravity_subpix": ROLE[Role.RECEIVER],
    "photometric": COUNT,
    "gravity_photometric": ROLE[Role.SENDER],
}
SIGMAS = 3.0  # of the ellipse around the prior


def draw_configurations(mounts: Mounts, path: Path) -> None:
    """Seen from above and from the side."""
    figure = sheet(11.0, 5.6)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1.0))
    above = figure.add_subplot(grid[0, 0])
    side = figure.add_subplot(grid[0, 1])
    D1, _, _ = nominal(CONFIGURATIONS[0], mounts)
    marker_w = (D1 @ mounts.T_b_v).t
    camera_w = (D1 @ mounts.T_b_c1).t
    for axes, up in ((above, 1), (side, 2)):
        axes.plot(
            [marker_w[0], camera_w[0]],
            [marker_w[up], camera_w[up]],
            color=ROLE[Role.SENDER],
            lw=5,
            zorder=3,
        )
        axes.plot(marker_w[0], marker_w[up], "s", ms=7, color=NEEDED, zorder=4)
    above.annotate(
        "D1",
        (camera_w[0], camera_w[1]),
        (4, 6),
        textcoords="offset points",
        color=ROLE[Role.SENDER],
    )
    above.annotate(
        "marker",
        (marker_w[0], marker_w[1]),
        (-4, -16),
        textcoords="offset points",
        fontsize=8,
    )
    for number, (x, y) in enumerate(PLACES_M, 1):
        above.plot(x, y, "*", ms=13, color="#e0760f")
        above.annotate(f"target {number}", (x, y), (8, -3), textcoords="offset points", fontsize=8)
        side.plot(x, 0.0, "*", ms=13, color="#e0760f")
    for c in CONFIGURATIONS:
        colour = ROLE[Role.RECEIVER] if c.facing else COUNT
        _, D2, _ = nominal(c, mounts)
        T_w_c = D2 @ mounts.T_b_c2
        for axes, up in ((above, 1), (side, 2)):
            x = float(T_w_c.t[0])
            y = float(T_w_c.t[up])
            dx = 0.22 * T_w_c.R[0, 2]
            dy = 0.22 * T_w_c.R[up, 2]
            axes.plot([x, marker_w[0]], [y, marker_w[up]], color=colour, lw=0.6, alpha=0.5)
            axes.annotate(
                "",
                (x + dx, y + dy),
                (x, y),
                arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6},
            )
            axes.plot(x, y, "o", ms=6, color=colour)
            name = f"{c.name} {c.range_m:.2f} m" if axes is above else c.name
            axes.annotate(name, (x, y), (-9, 6), textcoords="offset points", fontsize=8)
    above.plot([], [], "o", color=COUNT, label="D2 heads as D1 does")
    above.plot([], [], "o", color=ROLE[Role.RECEIVER], label="D2 faces D1")
    above.legend(fontsize=8, loc="lower right")
    side.axhline(0.0, color=DIM, lw=0.8)
    for axes, title in ((above, "from above"), (side, f"from the side; D1 at {HEIGHT_M} m")):
        axes.set_aspect("equal")
        axes.set_title(title, loc="left", fontsize=10)
        axes.set_xlabel("ahead of D1, m", fontsize=8)
        tidy(axes)
        axes.margins(0.12)
    above.set_ylabel("to D1's left, m", fontsize=8)
    side.set_ylabel("height, m", fontsize=8)
    save(figure, path)


def draw_errors(results: Mapping[str, Mapping[Method, Results]], path: Path) -> None:
    """Share of the measurements with at most a given error: D2 and target, measured and ideal
    camera.
    """
    figure = sheet(11.0, 4.6)
    axes = figure.subplots(1, 2, sharey=True)
    for axis, title, field in zip(
        axes,
        ("D2's position", "target's position"),
        ("d2_m", "target_m"),
        strict=True,
    ):
        for method in METHODS:
            for pipeline, line in ((HEADLINE, "-"), ("ideal", ":")):
                errors = getattr(results[pipeline][method], field)[:, SEVEN]
                label = METHOD_TITLES[method] if pipeline == HEADLINE else None
                _shares(axis, errors, COLOURS[method], line, label)
        axis.axvline(1e3 * GOAL_MEAN_M, color=DIM, lw=0.8, ls="--")
        axis.set_xscale("log")
        axis.set_xlim(0.5, 3000.0)
        axis.set_ylim(0.0, 1.0)
        axis.set_title(f"{title}, error in mm (line: goal of the mean)", loc="left", fontsize=10)
        axis.grid(alpha=0.25, which="both", lw=0.4)
        tidy(axis)
    axes[0].set_ylabel("share of measurements\nsolid: measured, dotted: ideal camera", fontsize=8)
    axes[1].legend(fontsize=8, loc="lower right")
    save(figure, path)


def _shares(
    axis: Axes,
    errors: Array,
    colour: str,
    line: str,
    label: str | None,
) -> None:
    """A measurement without a pose never reaches its share."""
    given = np.sort(errors[~np.isnan(errors)])
    share = np.arange(1, len(given) + 1) / errors.size
    axis.step(1e3 * given, share, color=colour, ls=line, lw=1.6, where="post", label=label)


def draw_view(
    image: Image,
    corners_px: Array,
    prior: Prior,
    target_px: Sequence[float],
    path: Path,
) -> None:
    """D2's image with the marker, and where it is told to look for the target."""
    figure = sheet(11.0, 6.2)
    axes = figure.add_subplot()
    axes.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    axes.plot(*np.vstack([corners_px, corners_px[:1]]).T, color=MARKER, lw=1.2)
    uu, uv, vv = prior.covariance_px2
    spread, axes_of = np.linalg.eigh(np.array([[uu, uv], [uv, vv]]))
    turn = math.degrees(math.atan2(axes_of[1, 1], axes_of[0, 1]))
    width = 2.0 * SIGMAS * math.sqrt(spread[1])
    height = 2.0 * SIGMAS * math.sqrt(spread[0])
    axes.add_patch(Ellipse(prior.pixel, width, height, angle=turn, fill=False, color=PRIOR, lw=1.4))
    region = prior.region
    sides = region.x1 - region.x0, region.y1 - region.y0
    axes.add_patch(
        Rectangle((region.x0, region.y0), *sides, fill=False, color=PRIOR, lw=0.7, ls="--")
    )
    axes.plot(*prior.pixel, "+", ms=12, color=PRIOR, mew=1.5)
    axes.plot(*target_px, "x", ms=8, color=FAULT, mew=1.5)
    axes.set_axis_off()
    _inset(axes, image, corners_px)
    save(figure, path)


def _inset(
    axes: Axes,
    image: Image,
    corners_px: Array,
) -> None:
    """The marker enlarged."""
    u, v = corners_px.mean(axis=0)
    half = 0.9 * float(np.ptp(corners_px, axis=0).max())
    inset = axes.inset_axes((0.79, 0.62, 0.2, 0.36))
    inset.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), interpolation="nearest")
    inset.plot(*np.vstack([corners_px, corners_px[:1]]).T, color=MARKER, lw=1.2)
    inset.set_xlim(u - half, u + half)
    inset.set_ylim(v + half, v - half)
    inset.set_xticks([])
    inset.set_yticks([])


def incidence(T_c2_v: Pose) -> float:
    """Between the marker's normal and the line of sight, rad."""
    toward = -T_c2_v.R.T @ T_c2_v.t
    return math.acos(float(toward[2]) / float(np.linalg.norm(toward)))
