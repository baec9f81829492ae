"""Colours of the picture of a run."""

from __future__ import annotations

from path.messages import Role

ROLE = {Role.SENDER: "#1f6fb4", Role.RECEIVER: "#c8620a"}
COUNT = "#7a4fb5"
NEEDED = "#111111"
FAULT = "#cc2222"
DIM = "#777777"

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
