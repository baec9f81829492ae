"""A camera's own time stamps in the clock of the role.

Two kinds of clock stamp the frames of a RealSense. Its own counts from some zero and drifts: a
frame never arrives before it was taken, so the quickest arrivals bound the offset, and the bound is
let go at the rate at which such clocks may drift. The computer's wall clock (``global_time``, to
which librealsense converts by asking the camera for its time, and ``system_time``) is compared with
the role's clock at each frame; what would come from the future or from long ago is refused, because
then the wall clock was set.
"""

from __future__ import annotations

from enum import Enum

from path.values import frozen

# the counter of a D400 has 32 bits of microseconds: it begins anew every 71.6 minutes
WRAP_NS = (1 << 32) * 1000


class Domain(Enum):
    """The clock that stamped a frame; the values are librealsense's names."""

    HARDWARE = "hardware_clock"
    SYSTEM = "system_time"
    GLOBAL = "global_time"


class StampRefused(Enum):
    """The reason why a stamp is not used."""

    OLD = "repeats or goes back"
    CLOCK = "is not of this computer's time"


@frozen
class StampConfig:
    """
    Attributes:
        latency_ns: shortest time from the middle of the exposure to the arrival; for
            ``hardware_clock`` only, where it cannot be seen and would else be missing in every
            stamp.
        max_drift_ppm: largest rate by which the camera's clock and the role's may part.
        max_age_ns: a frame is no older than this when it arrives, by the wall clock.
        max_ahead_ns: nor is it from further in the future than this.
        follow: False takes one offset from the first frame: the distances between stamps stay those
            of a recording.
    """

    latency_ns: int = 0
    max_drift_ppm: float = 100.0
    max_age_ns: int = 1_000_000_000
    max_ahead_ns: int = 5_000_000
    follow: bool = True


class StampLine:
    """The stamps of one stream, without the new beginnings of a hardware counter."""

    def __init__(self) -> None:
        self._wrapped_ns = 0
        self._newest_ns: int | None = None

    def next(self, stamp_ns: int, domain: Domain) -> int | None:
        """The stamp where it belongs; None when it repeats or goes back."""
        newest_ns = self._newest_ns
        if domain is Domain.HARDWARE:
            if newest_ns is not None and stamp_ns + self._wrapped_ns < newest_ns - WRAP_NS // 2:
                self._wrapped_ns += WRAP_NS
            stamp_ns += self._wrapped_ns
        if newest_ns is not None and stamp_ns <= newest_ns:
            return None
        self._newest_ns = stamp_ns
        return stamp_ns


class StampClock:
    """Maps the stamps of a ``StampLine``. No I/O and no clock of its own."""

    def __init__(self, config: StampConfig | None = None) -> None:
        self._config = config or StampConfig()
        self._offset_ns: int | None = None
        self._arrival_ns = 0
        self._mapped_ns: int | None = None

    def to_role(
        self,
        stamp_ns: int,
        domain: Domain,
        arrival_ns: int,
        wall_offset_ns: int,
    ) -> int | StampRefused:
        """The stamp in the role's clock, always later than the one before; never after the arrival
        while it follows.

        Args:
            stamp_ns: mid-exposure, in the clock of ``domain``; grows.
            arrival_ns: when the frame arrived, role clock.
            wall_offset_ns: wall clock minus role clock, now.
        """
        if domain is Domain.HARDWARE or not self._config.follow:
            mapped = stamp_ns + self._bound(stamp_ns, arrival_ns) - self._config.latency_ns
        else:
            mapped = stamp_ns - wall_offset_ns
            if not -self._config.max_ahead_ns <= arrival_ns - mapped <= self._config.max_age_ns:
                return StampRefused.CLOCK
            mapped = min(mapped, arrival_ns)
        if self._mapped_ns is not None and mapped <= self._mapped_ns:
            return StampRefused.OLD
        self._mapped_ns = mapped
        return mapped

    def _bound(self, stamp_ns: int, arrival_ns: int) -> int:
        """Role clock minus camera clock, from above."""
        if self._offset_ns is not None and not self._config.follow:
            return self._offset_ns
        offset = arrival_ns - stamp_ns
        if self._offset_ns is not None:
            drift = round((arrival_ns - self._arrival_ns) * self._config.max_drift_ppm * 1e-6)
            offset = min(offset, self._offset_ns + drift)
        self._offset_ns = offset
        self._arrival_ns = arrival_ns
        return offset
