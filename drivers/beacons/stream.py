"""Positions from the bytes of Marvelmind's serial ports, on the listener's clock: the same live and
from a record.

Nothing here waits or knows a port: bytes with the instant of their arrival go in, positions come
out.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from drivers.beacons.frames import (
    BeaconFramer,
    FrameCounters,
    MobilePosition,
    Packet,
    Power,
    Rating,
    StationaryPositions,
)
from drivers.interfaces import BeaconFix
from path.messages import Vec3

# over which the least delay is taken: at 50 ppm two clocks part by half a ms in it
WINDOW_NS = 10_000_000_000
RATED_WITHIN_NS = 1_000_000_000
RESTART_NS = 2_000_000_000  # stamps that go back by more: the system's clock has begun again


class ClockMap:
    """The map from the clock of a beacon system to the listener's.

    A frame arrives later than its ultrasound by its age, which it says itself, and by a way over
    the wire that is never negative: the least of ``arrival - age - stamp`` in a window is nearest
    to the truth, and late by the fastest way.
    """

    def __init__(self) -> None:
        # (stamp, offset), offsets growing: the first is the least
        self._least: deque[tuple[int, int]] = deque()
        self.restarts = 0

    def add(
        self,
        stamp_ns: int,
        arrival_ns: int,
        age_ns: int,
    ) -> int:
        """The offset at this stamp: add it to a stamp of the system to get the listener's."""
        offset_ns = arrival_ns - age_ns - stamp_ns
        least = self._least
        if least and stamp_ns < least[-1][0] - RESTART_NS:
            least.clear()
            self.restarts += 1
        while least and least[-1][1] >= offset_ns:
            least.pop()
        least.append((stamp_ns, offset_ns))
        while least[0][0] < stamp_ns - WINDOW_NS:
            least.popleft()
        return least[0][1]


@dataclass(slots=True)
class _Hedge:
    """The state of one mobile beacon on one port."""

    clock: ClockMap = field(default_factory=ClockMap)
    wrapped: int = 0
    newest_ms: int = 0
    stamp_ns: int = -1

    def stamp(self, packet: MobilePosition) -> int:
        """Return the packet's stamp in ns, carried on over the wrap of the counter (after 49
        days).
        """
        if packet.bits < 64 and packet.stamp_ms < self.newest_ms - (1 << (packet.bits - 1)):
            self.wrapped += 1 << packet.bits
        self.newest_ms = packet.stamp_ms
        return (self.wrapped + packet.stamp_ms) * 1_000_000


@dataclass(slots=True)
class PortState:
    """The state of one port.

    Attributes:
        newest_ns: arrival of the newest bytes, and of the newest position; None before any.
        unavailable: positions that the system itself said to have none for.
        repeated: positions that came a second time.
    """

    framer: BeaconFramer = field(default_factory=BeaconFramer)
    bytes_read: int = 0
    newest_ns: int | None = None
    newest_fix_ns: int | None = None
    unavailable: int = 0
    repeated: int = 0
    power: Power | None = None
    hedges: dict[int, _Hedge] = field(default_factory=dict[int, _Hedge])
    ratings: dict[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])

    @property
    def counters(self) -> FrameCounters:
        return self.framer.counters


class MarvelmindStream:
    """Bytes in, positions out. One per session; ports by name, any number of beacons on each."""

    def __init__(self, latency_s: float = 0.0) -> None:
        """``latency_s``: of positions whose frame does not say how old it is."""
        self._latency_ns = round(latency_s * 1e9)
        self.ports: dict[str, PortState] = {}
        self.stationary_m: dict[int, Vec3] = {}

    def feed(
        self,
        port: str,
        arrival_ns: int,
        data: bytes,
    ) -> list[BeaconFix]:
        """The positions that are complete with these bytes.

        Args:
            arrival_ns: listener's clock, when they were read.
            data: nothing stands for a port that was lost: what came of a frame so far will not be
                completed.
        """
        state = self.ports.setdefault(port, PortState())
        if not data:
            state.framer.cut()
            return []
        state.bytes_read += len(data)
        state.newest_ns = arrival_ns
        found = (self._take(state, packet, arrival_ns) for packet in state.framer.feed(data))
        fixes = [fix for fix in found if fix is not None]
        if fixes:
            state.newest_fix_ns = arrival_ns
        return fixes

    def _take(
        self,
        state: PortState,
        packet: Packet,
        arrival_ns: int,
    ) -> BeaconFix | None:
        match packet:
            case MobilePosition():
                return self._fix(state, packet, arrival_ns)
            case Rating():
                state.ratings[packet.address] = packet.percent, arrival_ns
            case StationaryPositions():
                self.stationary_m.update(packet.positions_m)
            case Power():
                state.power = packet
            case _:
                pass
        return None

    def _fix(
        self,
        state: PortState,
        packet: MobilePosition,
        arrival_ns: int,
    ) -> BeaconFix | None:
        hedge = state.hedges.setdefault(packet.address, _Hedge())
        stamp_ns = hedge.stamp(packet)
        offset_ns = hedge.clock.add(
            stamp_ns,
            arrival_ns,
            packet.age_ms * 1_000_000 or self._latency_ns,
        )
        if packet.position_m is None:
            state.unavailable += 1
            return None
        if stamp_ns == hedge.stamp_ns:
            state.repeated += 1
            return None
        hedge.stamp_ns = stamp_ns
        percent, rated_ns = state.ratings.get(packet.address, (0, -RATED_WITHIN_NS - 1))
        quality = float(percent) if arrival_ns - rated_ns <= RATED_WITHIN_NS else math.nan
        return BeaconFix(stamp_ns, packet.address, packet.position_m, quality, stamp_ns + offset_ns)
