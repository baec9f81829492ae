"""The rule on the battery, one for the script, its guard and the checks before a flight."""

from __future__ import annotations

import math

UNTOLD_S = 10.0
"""For so long the last level that was told counts. A vehicle tells it every second, or every five
over a slow radio.
"""
TELL_S = 3.0
"""After so long without news the crew is told that the last level is kept."""


def untold_s(told_ns: int | None, now_ns: int) -> float:
    """Return for how long the level has not been told, s; 0 for a vehicle whose level comes with
    every state.
    """
    return 0.0 if told_ns is None else (now_ns - told_ns) * 1e-9


def battery_trouble(
    level: float,
    told_ns: int | None,
    now_ns: int,
    least: float,
) -> str:
    """Return what is wrong with a battery in flight, in words; empty when nothing is.

    Unknown is neither full nor empty: the last level that was told counts for a while, and then the
    flight ends.

    Args:
        level: 0..1, the newest that was told; NaN when none ever was.
        told_ns: when; before the first level, when the vehicle was first heard. None: with every
            state.
        now_ns: on the same clock.
        least: at which a mission ends, 0..1.
    """
    silent_s = untold_s(told_ns, now_ns)
    known = math.isfinite(level)
    if silent_s > UNTOLD_S:
        last = (
            f"at {100 * level:.0f} % when it was told last"
            if known
            else "of a level that was never told"
        )
        return f"battery {last}, {silent_s:.0f} s ago"
    if not known:
        return "battery of an unknown level" if told_ns is None else ""
    return f"battery at {100 * level:.0f} %" if level < least else ""
