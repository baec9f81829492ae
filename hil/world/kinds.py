"""The kinds of objects that can be tracked."""

from __future__ import annotations

from typing import Literal

TargetKind = Literal["car", "person", "drone"]
"""A robot car, a person who walks, a micro-UAV."""
