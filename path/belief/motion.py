"""Where an object is and how it moves: a Gaussian over place and velocity, driven by white
acceleration.

    x = (p, v),  p' = v,  v' = w,   w white with spectral density S = a^2 * MANOEUVRE_S

where ``a`` is the greatest acceleration that the target is stated to have, and MANOEUVRE_S how long
it keeps one up. Over a time t without a measurement the covariance grows by

    Q = S * | t^3/3 I   t^2/2 I |
            | t^2/2 I   t     I |

What does not fly climbs as the ground does, by CLIMBS of its way at most: that share of ``a`` and
of the speeds is along the vertical axis. So a box that shows a part of it does not send it up or
down.

A measurement is of the place, z = p + n. Detectors err more than a Gaussian has it, at times: a
share ODD of the boxes has errors ODD_TIMES as large,

    n ~ (1 - ODD) N(0, R) + ODD N(0, ODD_TIMES^2 R)

and a track is updated with the mean of both, weighed by how likely either is after all. Motion has
no such tails: its accelerations are bounded by what was stated.

No length is stated here: R and a come from the rig, so that a world k times as large has the same
distances d2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MANOEUVRE_S = 0.5
ODD = 0.05
ODD_TIMES = 5.0
CLIMBS = 0.1
FLYING = np.ones(3)
ON_GROUND = np.array([1.0, 1.0, CLIMBS])
"""The share of each axis (north, east, down) in what an object can do."""


@dataclass(slots=True)
class Motion:
    """Place and velocity of one object.

    Attributes:
        mean: shape (6,), place in m and velocity in m/s, both in the local frame.
        covariance: shape (6, 6).
        stamp_ns: of what it is at.
    """

    mean: Array
    covariance: Array
    stamp_ns: int

    @classmethod
    def at(
        cls,
        place_m: Array,
        covariance_m2: Array,
        accel_mps2: float | Array,
        stamp_ns: int,
    ) -> Motion:
        """Return an object first seen at a place: it may move as fast as it gets within one
        second.

        Args:
            accel_mps2: its greatest acceleration, or of each axis, shape (3,).
        """
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = covariance_m2
        covariance[3:, 3:] = np.diag(accel_mps2**2 * FLYING)
        return cls(np.concatenate((place_m, np.zeros(3))), covariance, stamp_ns)

    @property
    def place_m(self) -> Array:
        return self.mean[:3]

    @property
    def place_covariance_m2(self) -> Array:
        return self.covariance[:3, :3]

    def advance(self, stamp_ns: int, accel_mps2: float | Array) -> None:
        """Predict to a later stamp; an earlier one changes nothing."""
        t = (stamp_ns - self.stamp_ns) * 1e-9
        if t <= 0.0:
            return
        density = MANOEUVRE_S * np.diag(accel_mps2**2 * FLYING)
        P = self.covariance
        pp = P[:3, :3]
        pv = P[:3, 3:]
        vv = P[3:, 3:]
        grown = np.empty((6, 6))
        grown[:3, :3] = pp + t * (pv + pv.T) + t * t * vv + density * t**3 / 3.0
        grown[:3, 3:] = pv + t * vv + density * t * t / 2.0
        grown[3:, :3] = grown[:3, 3:].T
        grown[3:, 3:] = vv + density * t
        self.mean[:3] += t * self.mean[3:]
        self.covariance = grown
        self.stamp_ns = stamp_ns

    def update(self, place_m: Array, noise_m2: Array) -> None:
        """Fuse a measured place, shape (3,), with its covariance (3, 3)."""
        innovation = place_m - self.mean[:3]
        known = self.covariance[:3, :3]
        plain = (1.0 - ODD) * normal(innovation, known + noise_m2)
        odd = ODD * normal(innovation, known + ODD_TIMES**2 * noise_m2)
        share = odd / (plain + odd) if plain + odd > 0.0 else 1.0
        doubted = noise_m2 / (1.0 - share + share / ODD_TIMES**2)
        gain = np.linalg.solve(known + doubted, self.covariance[:3, :]).T
        self.mean = self.mean + gain @ innovation
        covariance = self.covariance - gain @ self.covariance[:3, :]
        self.covariance = 0.5 * (covariance + covariance.T)


def mahalanobis2(innovation_m: Array, covariance_m2: Array) -> float:
    """Return the squared distance of an innovation, in standard deviations."""
    return float(innovation_m @ np.linalg.solve(covariance_m2, innovation_m))


def normal(innovation_m: Array, covariance_m2: Array) -> float:
    """Return the density per m^3 of a normal distribution about zero with that covariance (3,
    3).
    """
    d2 = mahalanobis2(innovation_m, covariance_m2)
    volume = math.sqrt((2.0 * math.pi) ** 3 * max(float(np.linalg.det(covariance_m2)), 1e-300))
    return math.exp(-0.5 * d2) / volume


def density(innovation_m: Array, known_m2: Array, noise_m2: Array) -> float:
    """Return the probability density per m^3 of an innovation.

    Args:
        known_m2: covariance (3, 3) of the predicted place. noise_m2: of the measurement.
    """
    plain = normal(innovation_m, known_m2 + noise_m2)
    odd = normal(innovation_m, known_m2 + ODD_TIMES**2 * noise_m2)
    return (1.0 - ODD) * plain + ODD * odd


def renewal(covariance_m2: Array, noise_m2: Array, direction: Array) -> float:
    """Return how much of a place a measurement with this noise makes new along a direction (any
    length), 0..1.

    0 for an object whose place is known already, 1 for one that may be anywhere: the Kalman gain
    along that direction.
    """
    length2 = float(direction @ direction)
    if not length2 > 0.0:
        return 0.0
    moved = covariance_m2 @ np.linalg.solve(covariance_m2 + noise_m2, direction)
    return min(1.0, max(0.0, float(direction @ moved) / length2))
