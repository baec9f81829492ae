"""The time that a battery still carries a drone, from what it was seen to lose. Pure."""

from __future__ import annotations

import math
from collections import deque

STEP_S = 10.0
STEPS = 12  # a jump among so many steps changes nothing: what is left counts, not how it was lost


class Gauge:
    """Time until the reserve is reached.

    Args:
        endurance_s: of a full battery, as far as is known; one that is seen to run down quicker
            does.
        reserve: 0..1.
    """

    def __init__(self, endurance_s: float, reserve: float) -> None:
        self._usual = 1.0 / endurance_s
        self._reserve = reserve
        self._newest = 1.0
        self._begun: tuple[float, float] | None = None
        self._rates: deque[float] = deque(maxlen=STEPS)

    def note(self, now_s: float, battery: float) -> None:
        """Take the charge, 0..1, while flying; one that is not known (NaN) changes nothing."""
        if math.isnan(battery):
            return
        self._newest = battery
        if self._begun is None:
            self._begun = now_s, battery
        since_s = now_s - self._begun[0]
        if since_s >= STEP_S:
            self._rates.append((self._begun[1] - battery) / since_s)
            self._begun = now_s, battery

    @property
    def rate_per_s(self) -> float:
        """The middle one of the newest steps, and no less than usual."""
        middle = sorted(self._rates)[len(self._rates) // 2] if self._rates else 0.0
        return max(self._usual, middle)

    @property
    def left_s(self) -> float:
        return (self._newest - self._reserve) / self.rate_per_s
