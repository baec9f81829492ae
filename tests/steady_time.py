"""The time of an emulated vehicle that lives in a thread of a test's own process."""

from __future__ import annotations

import time

LONGEST_S = 0.05


class SteadyTime:
    """Passes ``speed`` times as fast as ours, and stands still while this process does.

    A vehicle whose time went on meanwhile would have missed seconds of setpoints when both go on,
    and be on its own.
    """

    def __init__(self, speed: float = 1.0, begin_s: float = 0.0) -> None:
        self._speed, self._now_s = speed, begin_s
        self._last_s = time.monotonic()

    def now_s(self) -> float:
        """Returns the vehicle's time by now; to be asked at every step."""
        last_s, self._last_s = self._last_s, time.monotonic()
        self._now_s += self._speed * min(self._last_s - last_s, LONGEST_S)
        return self._now_s
