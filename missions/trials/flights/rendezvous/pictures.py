"""The receiver's ways to its viewpoint, and how near they led."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from flight.config import SeparationConfig
from missions.look.report.palette import COUNT, DIM, NEEDED, ROLE
from missions.trials.flights.rendezvous.flights import RendezvousResult, separations_m
from missions.trials.shared.drawing import panels, save
from path.messages import Role

WAYS = 150  # drawn at most


def draw(flown: Sequence[RendezvousResult], separation: SeparationConfig, path: Path) -> None:
    """Raise OSError when it cannot be written."""
    figure, (left, right) = panels(11.0, 5.0, columns=2)
    _ways(left, flown[:WAYS], separation)
    together_m = separations_m(flown)
    bins = np.arange(0.5, max(together_m, default=0.5) + 0.1, 0.05)
    right.hist(together_m, bins=bins.tolist(), color=ROLE[Role.RECEIVER])
    right.axvline(
        separation.minimum_m, color=NEEDED, lw=1.2, label=f"limit {separation.minimum_m:.2f} m"
    )
    right.set(xlabel="smallest true separation, m", ylabel="missions")
    right.legend(fontsize=8, frameon=False)
    save(figure, path)


def _ways(axes: Axes, flown: Sequence[RendezvousResult], separation: SeparationConfig) -> None:
    for one in flown:
        if len(one.way_h_m) > 1:
            ahead = np.array(one.way_h_m)[:, 0]
            right = np.array(one.way_h_m)[:, 1]
            axes.plot(right, ahead, color=COUNT if one.arrived else NEEDED, lw=0.6, alpha=0.5)
            axes.plot(right[-1:], ahead[-1:], ".", color=ROLE[Role.RECEIVER], ms=3)
    width = 2.0 * separation.horizontal_m
    axes.add_patch(Ellipse((0.0, 0.0), width, width, fill=False, color=NEEDED, lw=1.2))
    axes.annotate("D1", (0.0, 0.0), color=ROLE[Role.SENDER], ha="center", va="center")
    axes.set(xlabel="right of the sender, m", ylabel="ahead of it, m", aspect="equal")
    axes.grid(alpha=0.3, color=DIM)
