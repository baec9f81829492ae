"""A relay's world in real time: what its cameras look at, and how its monitors judge what they are told of late."""

from __future__ import annotations

import heapq
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from hil.harness.relay_world import RelayWorld
from hil.monitors.relay import RelayMonitors, Seen
from hil.world.snapshot import Snapshot

HINDSIGHT_S = 1.0  # a record is logged, and on its way here, for less
REMEMBERED_S = 3.0


def run_of(run: str, name: str) -> str:
    """Returns the name of a drone's camera frames, for its program and the world."""
    return f"{run}-{name}"


@dataclass(slots=True)
class LiveRelay:
    """The world in real time. ``lock`` guards it: the cameras' threads look at it while physics steps it."""

    world: RelayWorld
    start_s: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)
    others: dict[str, str] = field(default_factory=dict[str, str])
    frozen: set[str] = field(default_factory=set[str])

    def now_s(self) -> float:
        return time.monotonic() - self.start_s


@dataclass(frozen=True, slots=True)
class RelayScene:
    """A ``live_world.CameraScene``: the field as one drone's camera sees it, the other drone of its leg in it."""

    live: LiveRelay
    name: str

    def now_s(self) -> float:
        return self.live.now_s()

    def look(self) -> tuple[int, Snapshot] | None:
        live = self.live
        if self.name in live.frozen:
            return None
        with live.lock:
            live.world.advance(max(live.now_s(), live.world.time_s))
            seen = live.world.view(self.name, live.others.get(self.name))
        return round((live.start_s + seen.time_s) * 1e9), seen


class Hindsight:
    """Has the monitors judge everything in the order of its stamps: what happened last may be told of first."""

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
