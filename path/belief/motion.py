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

from path.compiled import inner, kernel

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
        # whole in memory: kernels are compiled for that
        return self.covariance[:3, :3].copy()

    @property
    def level_sigma_m(self) -> float:
        """Return the standard deviation of the place along the ground, per axis."""
        return math.sqrt(0.5 * float(self.covariance[0, 0] + self.covariance[1, 1]))

    def ahead(self, stamp_ns: int, accel_mps2: float | Array) -> Motion:
        """Return it as it is predicted to be at a later stamp."""
        later = Motion(self.mean.copy(), self.covariance, self.stamp_ns)
        later.advance(stamp_ns, accel_mps2)
        return later

    def advance(self, stamp_ns: int, accel_mps2: float | Array) -> None:
        """Predict to a later stamp; an earlier one changes nothing."""
        t = (stamp_ns - self.stamp_ns) * 1e-9
        if t <= 0.0:
            return
        self.covariance = _grown(self.mean, self.covariance, accel_mps2 * FLYING, t)
        self.stamp_ns = stamp_ns

    def update(self, place_m: Array, noise_m2: Array) -> None:
        """Fuse a measured place, shape (3,), with its covariance (3, 3)."""
        self.mean, self.covariance = _fused(self.mean, self.covariance, place_m, noise_m2)


@kernel
def mahalanobis2(innovation_m: Array, known_m2: Array, noise_m2: Array) -> tuple[float, float]:
    """Return the squared distance of an innovation, in standard deviations, and the determinant of
    its covariance.

    Args:
        known_m2: covariance (3, 3) of the predicted place. noise_m2: of the measurement.
    """
    return _squared(innovation_m, _factors(known_m2, noise_m2, 1.0))


@kernel
def density(innovation_m: Array, known_m2: Array, noise_m2: Array) -> float:
    """Return the probability density per m^3 of an innovation.

    Args:
        known_m2: covariance (3, 3) of the predicted place. noise_m2: of the measurement.
    """
    plain, odd = _densities(innovation_m, known_m2, noise_m2)
    return plain + odd


@kernel
def renewal(covariance_m2: Array, noise_m2: Array, direction: Array) -> float:
    """Return how much of a place a measurement with this noise makes new along a direction (any
    length), 0..1.

    0 for an object whose place is known already, 1 for one that may be anywhere: the Kalman gain
    along that direction.
    """
    length2 = direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2
    if not length2 > 0.0:
        return 0.0
    factors = _factors(covariance_m2, noise_m2, 1.0)
    solved = _solved(factors, direction[0], direction[1], direction[2])
    along = 0.0
    for i in range(3):
        for j in range(3):
            along += direction[i] * covariance_m2[i, j] * solved[j]
    return min(1.0, max(0.0, along / length2))


@kernel
def along_ray(ray: Array, across_m2: float, along_m2: float) -> Array:
    """Return a covariance (3, 3): so much in every direction, and so much more along a ray of any
    length.
    """
    covariance = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            covariance[i, j] = along_m2 * (ray[i] * ray[j])
        covariance[i, i] += across_m2
    return covariance


@kernel
def _grown(mean: Array, covariance: Array, accel_mps2: Array, t: float) -> Array:
    """Return the covariance a time later, and move the mean on in place."""
    grown = np.empty((6, 6))
    for i in range(3):
        mean[i] += t * mean[i + 3]
        for j in range(3):
            pv = covariance[i, j + 3]
            vv = covariance[i + 3, j + 3]
            grown[i, j] = covariance[i, j] + t * (pv + covariance[j, i + 3]) + t * t * vv
            grown[i, j + 3] = pv + t * vv
            grown[i + 3, j + 3] = vv
        density = MANOEUVRE_S * accel_mps2[i] ** 2
        grown[i, i] += density * t**3 / 3.0
        grown[i, i + 3] += density * t * t / 2.0
        grown[i + 3, i + 3] += density * t
    for i in range(3):
        for j in range(3):
            grown[i + 3, j] = grown[j, i + 3]
    return grown


@kernel
def _fused(mean: Array, P: Array, place_m: Array, noise_m2: Array) -> tuple[Array, Array]:
    """Return mean and covariance with a measured place in them."""
    innovation = np.empty(3)
    for k in range(3):
        innovation[k] = place_m[k] - mean[k]
    plain, odd = _densities(innovation, P, noise_m2)
    share = odd / (plain + odd) if plain + odd > 0.0 else 1.0
    factors = _factors(P, noise_m2, 1.0 / (1.0 - share + share / ODD_TIMES**2))
    fused = mean.copy()
    covariance = np.empty((6, 6))
    for i in range(6):
        gain = _solved(factors, P[0, i], P[1, i], P[2, i])
        for k in range(3):
            fused[i] += gain[k] * innovation[k]
        for j in range(6):
            covariance[i, j] = P[i, j] - (gain[0] * P[0, j] + gain[1] * P[1, j] + gain[2] * P[2, j])
    for i in range(6):
        for j in range(i):
            covariance[i, j] = 0.5 * (covariance[i, j] + covariance[j, i])
            covariance[j, i] = covariance[i, j]
    return fused, covariance


@inner
def _densities(innovation_m: Array, known_m2: Array, noise_m2: Array) -> tuple[float, float]:
    """Return the densities of an innovation whose box is as usual, and odd, with their shares."""
    plain = _normal(innovation_m, known_m2, noise_m2, 1.0)
    odd = _normal(innovation_m, known_m2, noise_m2, ODD_TIMES**2)
    return (1.0 - ODD) * plain, ODD * odd


@inner
def _normal(innovation_m: Array, known_m2: Array, noise_m2: Array, times: float) -> float:
    """Return the density per m^3 of a normal distribution with the covariance K + times N."""
    d2, determinant = _squared(innovation_m, _factors(known_m2, noise_m2, times))
    volume = math.sqrt((2.0 * math.pi) ** 3 * max(determinant, 1e-300))
    return math.exp(-0.5 * d2) / volume


@inner
def _squared(x: Array, factors: tuple[float, ...]) -> tuple[float, float]:
    """Return x^T A^-1 x and the determinant of A."""
    d0, d1, d2, l10, l20, l21 = factors
    y1 = x[1] - l10 * x[0]
    y2 = x[2] - l20 * x[0] - l21 * y1
    return x[0] * x[0] / d0 + y1 * y1 / d1 + y2 * y2 / d2, d0 * d1 * d2


@inner
def _solved(factors: tuple[float, ...], x0: float, x1: float, x2: float) -> tuple[float, ...]:
    """Return A^-1 x."""
    d0, d1, d2, l10, l20, l21 = factors
    y1 = x1 - l10 * x0
    y2 = x2 - l20 * x0 - l21 * y1
    z2 = y2 / d2
    z1 = y1 / d1 - l21 * z2
    return x0 / d0 - l10 * z1 - l20 * z2, z1, z2


@inner
def _factors(known: Array, noise: Array, times: float) -> tuple[float, ...]:
    """Return D and L of A = L D L^T, which is the symmetric K + times N: three of D, three of L."""
    a10 = known[1, 0] + times * noise[1, 0]
    a20 = known[2, 0] + times * noise[2, 0]
    d0 = known[0, 0] + times * noise[0, 0]
    l10 = a10 / d0
    l20 = a20 / d0
    d1 = known[1, 1] + times * noise[1, 1] - l10 * a10
    a21 = known[2, 1] + times * noise[2, 1] - l20 * a10
    l21 = a21 / d1
    return d0, d1, known[2, 2] + times * noise[2, 2] - l20 * a20 - l21 * a21, l10, l20, l21
