"""Alarms about packets on a link that are not the other drone's: a flood, and its end."""

from __future__ import annotations

from drivers.interfaces import LinkCounters
from drivers.link.wire import Drop

NOT_THE_PEERS = frozenset({"stranger", "flooded", *(drop.value for drop in Drop)})
"""Reasons for which a link does not take what came in. The others drop what was the peer's, or this
side's own.
"""
QUIET_LOOKS = 3  # before it is over: one that comes and goes is told once
FLOOD_HZ = 300  # a link that sends every packet twice and damages a tenth comes to half of it


class LinkAlarm:
    """Looks at the link's counters now and then."""

    def __init__(self) -> None:
        self._before: tuple[int, int] | None = None
        self._flooded = False
        self._quiet = 0  # looks since

    def look(self, counters: LinkCounters, now_ns: int) -> str:
        """Return what the crew has to know since the last look; "" when there is nothing new."""
        foreign = foreign_packets(counters.dropped)
        before = self._before
        self._before = foreign, now_ns
        if before is None or now_ns <= before[1]:
            return ""
        rate_hz = (foreign - before[0]) / ((now_ns - before[1]) * 1e-9)
        self._quiet = 0 if rate_hz > FLOOD_HZ else self._quiet + 1
        if not self._flooded and self._quiet == 0:
            self._flooded = True
            return f"ALARM: {rate_hz:,.0f} packets a second on the link are not the other drone's: who sends them?"
        if self._flooded and self._quiet >= QUIET_LOOKS:
            self._flooded = False
            return "the flood on the link is over"
        return ""


def foreign_packets(dropped: dict[str, int]) -> int:
    """Return how many of the packets that came in were not taken for the peer's."""
    return sum(count for reason, count in dropped.items() if reason in NOT_THE_PEERS)
