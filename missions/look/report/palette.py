"""Colours of the picture of a run, and the plain axes of all pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from path.messages import Role

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROLE = {Role.SENDER: "#1f6fb4", Role.RECEIVER: "#c8620a"}
INK = {Role.SENDER: "#00408f", Role.RECEIVER: "#7a3300"}
"""Dark enough to be read on white in the sun, and told apart by the colour-blind, as on the live
page."""
COUNT = "#7a4fb5"
NEEDED = "#111111"
FAULT = "#8c0000"
DIM = "#4a4a4a"

MARKER = "#00e5ff"
OWN_BOX = "#00ff66"
MAPPED_BOX = "#ff2bd6"
PRIOR = "#fff200"

PHASES = {
    "preflight": "#e3e3e3",
    "waiting": "#efefef",
    "take-off": "#cfd8dc",
    "acquire": "#bcdcf5",
    "follow": "#9cc9ee",
    "stand-off": "#f7dcb9",
    "search": "#f3c992",
    "approach": "#eeb46a",
    "verify": "#c9b5ea",
    "depart": "#cfe8cf",
    "land": "#b4d8b4",
    "done": "#eeeeee",
}


def tidy(axes: Axes, numbers: str = "black") -> None:
    """Small numbers, of a colour, and no frame but two axes."""
    axes.tick_params(labelsize=8, colors=numbers)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
