"""The things a program gives up, in order, on a computer that does not keep up; never setpoints,
guard and protocol.

How busy the program is, is seen from inside: a beat that is due at an even pace wakes late whenever
the one thread is at work, so the share of late beats is the share of the time at work, whatever the
reason: a slow core, a share of one, or neighbours. Pure: what is due when is passed in.
"""

from __future__ import annotations

from collections import deque

from path.values import frozen

IN_ORDER = ("picture log", "redetection", "half the frames", "two of three frames")
"""The order in which things go. What went last comes back first."""

BEAT_S = 0.05
LATE_S = 0.003
BEATS = 40  # that are judged together: 2 s
# of the beats late: one thing more goes; one may come back
BUSY = 0.6
CALM = 0.3
# in a row, before anything comes back; twice as long each time that it had to go again
CALM_S = 10.0
LONGEST_S = 160.0
_SEARCHES = 4  # times as rarely the whole image is searched


@frozen
class Shed:
    """One thing given up, or taken up again, and how busy the program was: 0 to 1."""

    what: str
    gone: bool
    busy: float


class Shedding:
    """The things that are given up at present."""

    def __init__(self) -> None:
        self.gone = 0  # of IN_ORDER, from the first on
        self._late: deque[bool] = deque(maxlen=BEATS)
        self._calm_s = 0.0
        self._wait_s = CALM_S
        self._interval_ns = 0
        self._latency_ns = 1 << 62
        self._newest: tuple[int, int] | None = None

    def beat(self, late_s: float) -> Shed | None:
        """Take one beat, ``BEAT_S`` after the last one and so late; returns what changes with
        it.
        """
        self._late.append(late_s > LATE_S)
        if len(self._late) < BEATS:
            return None
        busy = sum(self._late) / BEATS
        self._calm_s = self._calm_s + BEAT_S if busy <= CALM else 0.0
        if busy >= BUSY and self.gone < len(IN_ORDER):
            return self._now(self.gone + 1, busy)
        if self._calm_s >= self._wait_s and self.gone:
            self._wait_s = min(2.0 * self._wait_s, LONGEST_S)
            return self._now(self.gone - 1, busy)
        return None

    def _now(self, gone: int, busy: float) -> Shed:
        changed = Shed(IN_ORDER[min(gone, self.gone)], gone > self.gone, busy)
        self.gone = gone
        self._late.clear()  # what follows shows whether that was enough
        self._calm_s = 0.0
        return changed

    @property
    def pictures(self) -> bool:
        """Return whether pictures are logged as the mission wants them."""
        return self.gone < 1

    @property
    def search_every(self) -> int:
        """Return how many times as rarely the whole image is searched for what was lost."""
        return 1 if self.gone < 2 else _SEARCHES

    @property
    def frames_every(self) -> int:
        """Return of how many frames one is looked at."""
        return max(1, self.gone - 1)

    def took(self, frame_id: int, stamp_ns: int, now_ns: int) -> None:
        """Take a frame that was taken up now. The camera's interval and latency are learned from
        ids and stamps.
        """
        if self._newest is not None and frame_id > self._newest[0]:
            interval_ns = (stamp_ns - self._newest[1]) // (frame_id - self._newest[0])
            self._interval_ns = min(self._interval_ns or interval_ns, interval_ns)
        self._newest = frame_id, stamp_ns
        self._latency_ns = min(self._latency_ns, max(0, now_ns - stamp_ns))

    def until_next_s(self, now_ns: int) -> float:
        """Return how long to wait before the next frame is taken up, so that those between are
        left out.
        """
        if self.frames_every == 1 or self._newest is None:
            return 0.0
        due_ns = self._newest[1] + self.frames_every * self._interval_ns + self._latency_ns
        return max(0.0, (due_ns - now_ns) * 1e-9)
