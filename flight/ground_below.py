"""The ground below a drone, in the drone's own frame: by a rangefinder, and by its own height where
that says nothing.

The state is one number, ``g``, how far down the ground is in the frame in which the drone tells its
position, with its variance ``p``. It is 0 by definition where the drone stood before take-off, and
changes only as the drone's own height drifts, a random walk: ``p`` grows by ``drift^2`` a minute.
With a distance ``d`` along the body's down axis, whose part along gravity is ``c``, a measurement
is ``z = down + c d``, with the variance ``r`` of the distance.

    k = p / (p + r),   g <- g + k (z - g),   p <- (1 - k) p

A measurement with ``(z - g)^2 > 10.8 (p + r)``, one in a thousand, contradicts the drone's own
height: a roof, a table, a body below it, or a height that is wrong. It is not believed, and that is
told once. It is believed again when it fits again, at the latest when the drift could explain it.
Pure.
"""

from __future__ import annotations

import math

from drivers.interfaces import VehicleState
from drivers.rig.facts import HeightFacts
from flight.tracking.ranging import Ground
from path.geometry.rotation import R_from_quat
from path.observations import RangeSource

CHI2 = 10.83  # one in a thousand, one degree of freedom
# of the body's down axis along gravity: beyond 45 degrees it looks at the scenery
LEAST_UPRIGHT = 0.7
MINUTE_NS = 60_000_000_000
BELIEVED_NS = 1_000_000_000  # for so long after a measurement the ground is by it


class GroundBelow:
    """What a drone knows of the ground below it.

    Attributes:
        doubted: the newest distance contradicts the drone's own height.
    """

    def __init__(self, facts: HeightFacts) -> None:
        self._facts = facts
        self._down_m = 0.0
        self._variance = facts.rangefinder_sigma_m**2
        self._stamp_ns: int | None = None
        self._measured_ns: int | None = None  # the newest distance that was believed
        self._taken_ns: int | None = None  # the newest one at all
        self.doubted = False

    @property
    def ground(self) -> Ground:
        """Return where the ground is that a target stands on nearby, with how uneven it is."""
        sigma_m = math.sqrt(self._variance + self._facts.uneven_m**2)
        now_ns = self._stamp_ns
        measured_ns = self._measured_ns
        if now_ns is None or measured_ns is None or now_ns - measured_ns > BELIEVED_NS:
            return Ground(self._down_m, sigma_m)
        return Ground(self._down_m, sigma_m, RangeSource.RANGEFINDER)

    def note(self, state: VehicleState) -> str:
        """Take a state of the vehicle. Return what to tell the crew: empty, as a rule."""
        self._drift(state.stamp_ns)
        if not state.in_air:
            # where it stands is the ground
            self._down_m = state.position_n_m[2]
            self._variance = self._facts.rangefinder_sigma_m**2
            return ""
        below = state.below
        if below is None or below.stamp_ns == self._taken_ns or not self._facts.has_rangefinder:
            return ""
        self._taken_ns = below.stamp_ns
        upright = float(R_from_quat(state.q_n_b)[2, 2])
        within = self._facts.rangefinder_min_m < below.distance_m < self._facts.rangefinder_max_m
        if upright < LEAST_UPRIGHT or not within:
            return ""
        return self._measure(state.position_n_m[2], upright * below.distance_m, below.sigma_m)

    def _measure(
        self,
        down_m: float,
        height_m: float,
        told_sigma_m: float | None,
    ) -> str:
        sigma_m = max(told_sigma_m or 0.0, self._facts.rangefinder_sigma_m)
        noise = sigma_m**2
        off_m = down_m + height_m - self._down_m
        was = self.doubted
        self.doubted = off_m**2 > CHI2 * (self._variance + noise)
        if self.doubted:
            if was:
                return ""
            own_m = self._down_m - down_m
            return f"the rangefinder says {height_m:.2f} m above the ground, its own height {own_m:.2f} m: not believed"
        gain = self._variance / (self._variance + noise)
        self._down_m += gain * off_m
        self._variance *= 1.0 - gain
        self._measured_ns = self._stamp_ns
        return "the rangefinder agrees with its own height again" if was else ""

    def _drift(self, stamp_ns: int) -> None:
        if self._stamp_ns is not None:
            minutes = max(0, stamp_ns - self._stamp_ns) / MINUTE_NS
            self._variance += self._facts.drift_m**2 * minutes
        self._stamp_ns = stamp_ns
