"""Monitors that are told of late: they judge everything in the order of its stamps, with the truth
of then.
"""

from __future__ import annotations

import heapq
from collections import deque
from itertools import count
from typing import Any

from hil.monitors.relay import RelayMonitors, Seen

HINDSIGHT_S = 1.0  # a record is logged, and on its way here, for less
REMEMBERED_S = 3.0


class Hindsight:
    """Has the monitors judge everything in the order of its stamps: what happened last may be told
    of first.
    """

    def __init__(self, monitors: RelayMonitors) -> None:
        self._monitors = monitors
        self._waiting: list[tuple[float, int, tuple[Any, ...]]] = []
        self._numbers = count()
        self._truth: deque[tuple[float, Seen]] = deque()
        monitors.seen = self._seen

    def remember(self, now_s: float, seen: Seen) -> None:
        """The truth at an instant, for records of then."""
        self._truth.append((now_s, seen))
        while now_s - self._truth[0][0] > HINDSIGHT_S + REMEMBERED_S:
            self._truth.popleft()

    def put(self, at_s: float, what: str, *about: Any) -> None:
        """``what``: the name of a method of the monitors, called with ``about`` in its turn."""
        heapq.heappush(self._waiting, (at_s, next(self._numbers), (what, *about)))

    def judge(self, up_to_s: float) -> None:
        while self._waiting and self._waiting[0][0] <= up_to_s:
            _, _, (what, *about) = heapq.heappop(self._waiting)
            getattr(self._monitors, what)(*about)

    def _seen(self, at_s: float) -> Seen:
        return min(self._truth, key=lambda entry: abs(entry[0] - at_s))[1]
