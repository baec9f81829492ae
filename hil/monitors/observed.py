"""For how much of the time each target was truly observed: by somebody who is responsible for it,
and looks at it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from flight.harness.relay import TargetWatch

# a look is worth that long: frames come 12 times a second, and one in the half second is judged
LOOKED_S = 1.0


@dataclass(slots=True)
class ObservedTime:
    """Of one target. ``look`` and ``tick`` are told of in the order of time, ``tick`` more often
    than ``LOOKED_S``.
    """

    first_s: float | None = None
    observed_s: float = 0.0
    of_s: float = 0.0
    spells: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    _looked_s: float = -LOOKED_S
    _ticked_s: float | None = None

    def acquired(self, now_s: float) -> None:
        """Somebody is responsible for it."""
        if self.first_s is None:
            self.first_s = self._ticked_s = self._looked_s = now_s

    def look(self, now_s: float) -> None:
        """A drone that is responsible for it, or has been until this very hand-over, had it in its
        box, in truth.
        """
        self._looked_s = max(self._looked_s, now_s)

    def tick(self, now_s: float) -> None:
        """The time since the last one counts as observed when it was looked at a moment ago."""
        if self._ticked_s is None or now_s <= self._ticked_s:
            return
        since_s = now_s - self._ticked_s
        began_s = self._ticked_s
        self._ticked_s = now_s
        self.of_s = self.of_s + since_s
        if now_s - self._looked_s <= LOOKED_S:
            self.observed_s += since_s
        elif self.spells and self.spells[-1][1] == began_s:
            self.spells[-1] = self.spells[-1][0], now_s
        else:
            self.spells.append((began_s, now_s))

    def watched(self) -> TargetWatch:
        return TargetWatch(self.first_s, self.observed_s, self.of_s, tuple(self.spells))
