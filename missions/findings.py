"""What ``doctor`` says of one thing it looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "note", "fault"]


@dataclass(frozen=True, slots=True)
class Finding:
    """``note``: a flight is possible, something else is not."""

    state: State
    name: str
    detail: str
    fix: str = ""
