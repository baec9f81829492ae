"""How often something comes, and how regularly: counted where it arrives, read by the event
loop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from itertools import pairwise

WINDOW_S = 2.0
LEAST_IN_AGE = 2.0  # times within the age that ends a flight: one that is lost is borne


class Arrivals:
    """The newest arrivals of one stream. ``add`` may be called on another thread than the rest."""

    def __init__(self) -> None:
        self._stamps_ns: deque[int] = deque(maxlen=1024)

    def add(self, arrival_ns: int) -> None:
        """Take an arrival; stamps do not fall."""
        self._stamps_ns.append(arrival_ns)

    def lately(self, now_ns: int) -> tuple[float, float]:
        """Return the rate, Hz, and the longest time without one, s, within the last ``WINDOW_S``.

        The longest time counts from the last one before the window, and until now.
        """
        begin_ns = now_ns - round(WINDOW_S * 1e9)
        stamps = list(self._stamps_ns)
        within = [each for each in stamps if each > begin_ns]
        before = [each for each in stamps if each <= begin_ns]
        marks = [before[-1] if before else begin_ns, *within, now_ns]
        longest_ns = max(later - sooner for sooner, later in pairwise(marks))
        return len(within) / WINDOW_S, longest_ns * 1e-9


def too_slow(
    streams: Mapping[str, Arrivals],
    now_ns: int,
    oldest_s: float,
) -> str:
    """Return which streams come too seldom for a flight that ends when one is older than
    ``oldest_s``; else empty.
    """
    needed_hz = LEAST_IN_AGE / oldest_s
    slow: list[str] = []
    for name, arrivals in streams.items():
        rate_hz, longest_s = arrivals.lately(now_ns)
        if rate_hz < needed_hz or longest_s > oldest_s:
            slow.append(f"{name} {rate_hz:.1f} times a second, up to {longest_s:.2f} s apart")
    if not slow:
        return ""
    return (
        f"{'; '.join(slow)}: this flight needs {needed_hz:.1f} a second, never {oldest_s:g} s apart"
    )
