"""Pairs for the gate "evidence"."""

from __future__ import annotations

from path.gate.window import FramePair, Offsets

MS = 1_000_000
PERIOD = 20 * MS
TAU = 0.4
ON_TARGET = Offsets((0.0, 0.0))


def pair_of(index: int, period_ns: int = PERIOD) -> FramePair:
    """The index-th pair of a steady stream; the sequence wraps on the way."""
    own = (index, index * period_ns), (index + 1, (index + 1) * period_ns)
    return FramePair((65_500 + index) % 65_536, index * period_ns + 3 * MS, own, ON_TARGET)
