"""plan.png: both drones and the target to scale, from the side and from above, with what each
camera sees.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from flight.plan.facts import Eye
from flight.plan.flown import Flown
from flight.plan.geometry import Floats
from missions.look.report.palette import COUNT, DIM, ROLE, tidy
from path.geometry.transforms import Pose
from path.messages import Role

FORWARD = 0
RIGHT = 1
DOWN = 2
SIZE_IN = (12.0, 5.6)
DPI = 110


def draw_plan(of: Flown, path: Path) -> None:
    """Draw the geometry of a plan as PNG. Raises OSError when it cannot be written."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
    side, above = figure.subplots(1, 2)
    _draw(side, of, DOWN, "height over the ground, m")
    _draw(above, of, RIGHT, "to the right, m")
    side.set_title("from the side", loc="left", fontsize=10)
    above.set_title("from above", loc="left", fontsize=10)
    figure.savefig(path, format="png", metadata={"Software": None})


def _draw(
    axes: Axes,
    of: Flown,
    across: int,
    label: str,
) -> None:
    """Draw one view. ``across``: the axis of ``h`` that goes up the page."""
    facts = of.facts
    mission = of.mission
    height_m = mission.follow.height_m

    def flat(point_h: Floats) -> tuple[float, float]:
        up = height_m - float(point_h[DOWN]) if across == DOWN else float(point_h[RIGHT])
        return float(point_h[FORWARD]), up

    radius_m = 0.5 * facts.drone.diameter_m
    views = [(Role.SENDER, facts.sender, facts.sender.mount.T_b_c, np.zeros(3))]
    if of.placed.T_h_c2 is not None:
        T_h_b2 = of.placed.T_h_c2 @ facts.receiver.mount.T_b_c.inverse()
        views.append((Role.RECEIVER, facts.receiver, of.placed.T_h_c2, T_h_b2.t))
    reach_m = 1.15 * max(of.range_m, float(np.nan_to_num(of.placed.receiver_range_m)))
    for role, eye, T_h_c, body_h in views:
        rim = _rim(eye, T_h_c, reach_m, across)
        axes.add_patch(
            Polygon([flat(point) for point in rim], color=ROLE[role], alpha=0.10, linewidth=0)
        )
        axes.add_patch(Circle(flat(body_h), radius_m, fill=False, color=ROLE[role], linewidth=1.6))
        name = "D1" if role is Role.SENDER else "D2"
        axes.annotate(name, flat(body_h), color=ROLE[role], ha="center", va="center", fontsize=10)
        ends = [flat(T_h_c.t), flat(of.placed.target_h)]
        axes.plot(*zip(*ends, strict=True), color=ROLE[role], linewidth=0.8)
    _draw_target(axes, of, flat(of.placed.target_h), across)
    marker = flat(facts.sender.mount.T_b_v.t)
    axes.plot(*marker, marker="s", markersize=5, color=COUNT)
    axes.annotate(
        "marker",
        marker,
        xytext=(4, 6),
        textcoords="offset points",
        color=COUNT,
        fontsize=8,
    )
    if across == DOWN:
        axes.axhline(0.0, color=DIM, linewidth=1.0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set_xlabel("ahead of D1, m")
    axes.set_ylabel(label)
    tidy(axes)


def _draw_target(
    axes: Axes,
    of: Flown,
    middle: tuple[float, float],
    across: int,
) -> None:
    target = of.facts.target
    high_m = target.height_m if across == DOWN else target.span_m
    corner = middle[0] - 0.5 * target.span_m, middle[1] - 0.5 * high_m
    axes.add_patch(Rectangle(corner, target.span_m, high_m, color="#e07b00", alpha=0.8))
    axes.annotate("target", middle, xytext=(6, -14), textcoords="offset points", fontsize=8)


def _rim(
    eye: Eye,
    T_h_c: Pose,
    reach_m: float,
    across: int,
) -> list[Floats]:
    """Return the outline of what a camera sees, out to a reach, in the plane that is drawn."""
    camera = eye.camera
    angles = np.linspace(-1.0, 1.0, 21)
    if across == DOWN:
        half = 0.5 * camera.height / camera.fy
        rays = [np.array([0.0, half * share, 1.0]) for share in angles]
    else:
        half = 0.5 * camera.width / camera.fx
        rays = [np.array([half * share, 0.0, 1.0]) for share in angles]
    ends = [T_h_c.t + reach_m * (T_h_c.R @ (ray / math.hypot(*ray))) for ray in rays]
    return [T_h_c.t, *ends]
