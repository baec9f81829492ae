"""The way from D2's camera to D1's marker between and beyond marker measurements.

A Kalman filter on each axis of NED. Its motion input is the velocity both vehicles report; what is unknown is the error
of that, which stays the same over seconds, so that the variance of a coast grows with the square of time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from path.messages import Vec3

GATE = 16.0  # squared Mahalanobis distance per axis a measurement may have
REPLACE_AFTER = 10  # gated measurements in a row: the filter is wrong, not they


@dataclass(frozen=True, slots=True)
class Relative:
    """From D2's camera to D1's marker, in ``n``; its velocity; standard deviation of the position per axis."""

    marker_n_m: Vec3
    velocity_n_mps: Vec3
    sigma_m: float


class RelativeFilter:
    """Position of the marker relative to the camera.

    Args:
        velocity_sigma_mps: error of the relative velocity that the two vehicles report, per axis.
        coast_s: without a measurement for longer, there is no prediction.
    """

    def __init__(self, velocity_sigma_mps: float = 0.12, coast_s: float = 1.0) -> None:
        self._velocity_variance = velocity_sigma_mps**2
        self._coast_ns = round(coast_s * 1e9)
        self._position: Vec3 = (0.0, 0.0, 0.0)
        self._variance: Vec3 = (0.0, 0.0, 0.0)
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._stamp_ns: int | None = None
        self._gated = 0

    def set_velocity(self, velocity_n_mps: Vec3) -> None:
        """The reported velocity of the marker's drone minus the own one."""
        self._velocity = velocity_n_mps

    def unseen_s(self, stamp_ns: int) -> float:
        """Time since the newest accepted measurement; infinite before the first."""
        return math.inf if self._stamp_ns is None else (stamp_ns - self._stamp_ns) * 1e-9

    def predict(self, stamp_ns: int) -> Relative | None:
        """The state at an instant; None before the first measurement and after too long a coast."""
        if self._stamp_ns is None or stamp_ns - self._stamp_ns > self._coast_ns:
            return None
        position, variance = self._ahead(stamp_ns, self._stamp_ns)
        return Relative(position, self._velocity, math.sqrt(sum(variance) / 3.0))

    def update(self, stamp_ns: int, marker_n_m: Vec3, variance_m2: Vec3) -> bool:
        """Fuse a measurement; False when it lies outside the gate and is not used (or is older than the newest)."""
        if self.predict(stamp_ns) is None or self._stamp_ns is None:
            self._restart(stamp_ns, marker_n_m, variance_m2)
            return True
        if stamp_ns <= self._stamp_ns:
            return False
        position, variance = self._ahead(stamp_ns, self._stamp_ns)
        innovation = [m - p for m, p in zip(marker_n_m, position, strict=True)]
        spread = [a + b for a, b in zip(variance, variance_m2, strict=True)]
        if any(i * i > GATE * s for i, s in zip(innovation, spread, strict=True)):
            self._gated += 1
            if self._gated < REPLACE_AFTER:
                return False
            self._restart(stamp_ns, marker_n_m, variance_m2)
            return True
        gains = [v / s for v, s in zip(variance, spread, strict=True)]
        px, py, pz = (p + g * i for p, g, i in zip(position, gains, innovation, strict=True))
        vx, vy, vz = ((1.0 - g) * v for g, v in zip(gains, variance, strict=True))
        self._position, self._variance, self._stamp_ns, self._gated = (px, py, pz), (vx, vy, vz), stamp_ns, 0
        return True

    def _restart(self, stamp_ns: int, marker_n_m: Vec3, variance_m2: Vec3) -> None:
        self._position, self._variance, self._stamp_ns, self._gated = marker_n_m, variance_m2, stamp_ns, 0

    def _ahead(self, stamp_ns: int, since_ns: int) -> tuple[Vec3, Vec3]:
        dt = max(0.0, (stamp_ns - since_ns) * 1e-9)
        x, y, z = self._position
        vx, vy, vz = self._velocity
        grown = self._velocity_variance * dt * dt + (0.02 * dt) ** 2
        a, b, c = self._variance
        return (x + vx * dt, y + vy * dt, z + vz * dt), (a + grown, b + grown, c + grown)
