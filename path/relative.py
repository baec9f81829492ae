"""The way from D2's camera to D1's marker between and beyond marker measurements.

A Kalman filter on each axis of NED with two states: position, and the error of the velocity that both vehicles report.
That error hardly changes over seconds, so marker measurements correct it, and a coast is flown on the corrected
velocity. While no velocity is reported the second state is the velocity itself, which may change as fast as drones can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from path.messages import Vec3

GATE = 16.0  # squared Mahalanobis distance per axis a measurement may have
REPLACE_AFTER = 10  # gated measurements in a row: the filter is wrong, not they
FREE_SPEED_MPS, FREE_WALK_MPS = 0.7, 1.0  # of an unreported velocity: its deviation, and its change in a second


@dataclass(frozen=True, slots=True)
class Relative:
    """From D2's camera to D1's marker, in ``n``; its velocity; standard deviation of the position per axis."""

    marker_n_m: Vec3
    velocity_n_mps: Vec3
    sigma_m: float


@dataclass(frozen=True, slots=True)
class _Axis:
    """Position and velocity error with their covariance."""

    p: float
    e: float
    pp: float
    pe: float
    ee: float

    def ahead(self, dt: float, velocity: float, walk: float) -> _Axis:
        """After ``dt`` seconds; ``walk`` is the variance of the velocity's error that a second adds."""
        return _Axis(
            self.p + (velocity + self.e) * dt,
            self.e,
            self.pp + dt * (2.0 * self.pe + dt * (self.ee + walk * dt / 3.0)),
            self.pe + dt * (self.ee + 0.5 * walk * dt),
            self.ee + walk * dt,
        )

    def fused(self, measured: float, variance: float) -> _Axis:
        """With a measurement of the position."""
        gain_p, gain_e = self.pp / (self.pp + variance), self.pe / (self.pp + variance)
        innovation = measured - self.p
        return _Axis(
            self.p + gain_p * innovation,
            self.e + gain_e * innovation,
            (1.0 - gain_p) * self.pp,
            (1.0 - gain_p) * self.pe,
            self.ee - gain_e * self.pe,
        )


_Axes = tuple[_Axis, _Axis, _Axis]


class RelativeFilter:
    """Position of the marker relative to the camera. Stamps are of one clock.

    Args:
        velocity_sigma_mps: error of the relative velocity that the two vehicles report, per axis.
        velocity_walk_mps: how much that error changes in a second.
        coast_s: without a measurement for longer, there is no prediction.
    """

    def __init__(self, velocity_sigma_mps: float = 0.12, velocity_walk_mps: float = 0.1, coast_s: float = 1.0) -> None:
        self._reported_variance = velocity_sigma_mps**2
        self._reported_walk = velocity_walk_mps**2
        self._coast_ns = round(coast_s * 1e9)
        self._velocity: Vec3 | None = None
        self._axes: _Axes | None = None
        self._stamp_ns = 0
        self._gated = 0

    def set_velocity(self, velocity_n_mps: Vec3) -> None:
        """The reported velocity of the marker's drone minus the own one, from the newest measurement on."""
        if self._velocity is None and self._axes is not None:
            a, b, c = (
                _Axis(axis.p, axis.e - reported, axis.pp, axis.pe, axis.ee)
                for axis, reported in zip(self._axes, velocity_n_mps, strict=True)
            )
            self._axes = a, b, c
        self._velocity = velocity_n_mps

    def unseen_s(self, stamp_ns: int) -> float:
        """Time since the newest accepted measurement; infinite before the first."""
        return math.inf if self._axes is None else (stamp_ns - self._stamp_ns) * 1e-9

    def predict(self, stamp_ns: int) -> Relative | None:
        """The state at an instant; None before the first measurement and after too long a coast."""
        axes = self._ahead(stamp_ns)
        if axes is None:
            return None
        a, b, c = axes
        vx, vy, vz = self._velocity or (0.0, 0.0, 0.0)
        return Relative((a.p, b.p, c.p), (vx + a.e, vy + b.e, vz + c.e), math.sqrt((a.pp + b.pp + c.pp) / 3.0))

    def update(self, stamp_ns: int, marker_n_m: Vec3, variance_m2: Vec3) -> bool:
        """Fuse a measurement; False when it lies outside the gate and is not used (or is no newer than the newest)."""
        axes = self._ahead(stamp_ns)
        if axes is None:
            self._restart(stamp_ns, marker_n_m, variance_m2)
            return True
        if stamp_ns <= self._stamp_ns:
            return False
        if any((m - a.p) ** 2 > GATE * (a.pp + r) for a, m, r in zip(axes, marker_n_m, variance_m2, strict=True)):
            self._gated += 1
            if self._gated < REPLACE_AFTER:
                return False
            self._restart(stamp_ns, marker_n_m, variance_m2)
            return True
        a, b, c = (axis.fused(m, r) for axis, m, r in zip(axes, marker_n_m, variance_m2, strict=True))
        self._axes, self._stamp_ns, self._gated = (a, b, c), stamp_ns, 0
        return True

    def _restart(self, stamp_ns: int, marker_n_m: Vec3, variance_m2: Vec3) -> None:
        spread = FREE_SPEED_MPS**2 if self._velocity is None else self._reported_variance
        a, b, c = (_Axis(m, 0.0, r, 0.0, spread) for m, r in zip(marker_n_m, variance_m2, strict=True))
        self._axes, self._stamp_ns, self._gated = (a, b, c), stamp_ns, 0

    def _ahead(self, stamp_ns: int) -> _Axes | None:
        """The axes carried to an instant; None when there is nothing to carry, or too far."""
        if self._axes is None or stamp_ns - self._stamp_ns > self._coast_ns:
            return None
        dt = max(0.0, (stamp_ns - self._stamp_ns) * 1e-9)
        walk = FREE_WALK_MPS**2 if self._velocity is None else self._reported_walk
        x, y, z = self._velocity or (0.0, 0.0, 0.0)
        a, b, c = self._axes
        return a.ahead(dt, x, walk), b.ahead(dt, y, walk), c.ahead(dt, z, walk)
