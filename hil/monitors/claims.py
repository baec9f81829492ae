"""The claims of responsibility, and until when, as the drones' records tell them.

A claim that has run out is none, whether or not its program was awake to say so
(``path.protocol.values``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

_INSTANTS = ("lease_end_ns", "until_ns")


def in_world_time(record: Mapping[str, Any], offset_ns: int) -> Mapping[str, Any]:
    """A record with its instants of the drone's clock on the world's. ``offset_ns``: drone's clock
    less the world's.
    """
    moved = {name: record[name] - offset_ns for name in _INSTANTS if record.get(name) is not None}
    return {**record, **moved} if moved else record


class Claims:
    """The newest claim of each. Instants are of the world's clock."""

    def __init__(self) -> None:
        self._until_s: dict[str, float] = {}

    def note(self, who: str, record: Mapping[str, Any]) -> None:
        """A ``/responsibility`` record."""
        self.drop(who)
        if record["responsible"]:
            until_ns = record["until_ns"]
            self._until_s[who] = math.inf if until_ns is None else until_ns * 1e-9

    def drop(self, who: str) -> None:
        self._until_s.pop(who, None)

    def holds(self, who: str, now_s: float) -> bool:
        """True when one's claim holds at an instant."""
        return now_s < self._until_s.get(who, -math.inf)

    def holders(self, now_s: float) -> tuple[str, ...]:
        """Return those whose claim holds at an instant."""
        return tuple(who for who, until_s in self._until_s.items() if now_s < until_s)
