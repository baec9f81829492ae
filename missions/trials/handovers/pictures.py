"""How soon a gate commits, as every experiment of this question draws it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from missions.look.report.palette import COUNT, ROLE
from path.config import GateKind
from path.messages import Role

COLOURS: Mapping[GateKind, str] = {"count": ROLE[Role.SENDER], "evidence": COUNT}


def draw_shares(
    axes: Axes,
    gate: GateKind,
    seconds: Sequence[float],
    attempts: int,
    label: str,
    style: str = "-",
) -> None:
    """Draw the share of the attempts that have committed by a time. ``seconds``: of those that
    did.
    """
    if not seconds:
        return
    share = np.arange(1, len(seconds) + 1) / attempts
    named = f"{label} ({len(seconds)} of {attempts})"
    axes.step(
        np.sort(seconds),
        share,
        where="post",
        color=COLOURS[gate],
        ls=style,
        lw=1.4,
        label=named,
    )
    axes.set_ylim(0.0, 1.02)
    axes.grid(alpha=0.3)
