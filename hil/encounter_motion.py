"""How the two drones of an encounter move, in truth and by their own estimate: holding a place, never quite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.encounter_scene import Drawn

Array = NDArray[np.float64]

WAVES = 5
# Standard deviations and frequencies of what wavers; the trial prints them.
WANDER_M, WANDER_HZ = (0.05, 0.05, 0.03), (0.05, 0.5)
TILT_RAD, TILT_HZ = math.radians(1.0), (0.2, 1.5)
YAW_RAD, YAW_HZ = math.radians(1.5), (0.05, 0.5)
TILT_NOISE_RAD, YAW_NOISE_RAD, NOISE_HZ = math.radians(0.2), math.radians(0.3), (0.1, 2.0)
DRIFT_M, DRIFT_HZ = 0.02, (0.05, 0.5)  # of D1's position estimate
SPEED_NOISE_MPS, SPEED_NOISE_HZ = 0.03, (0.03, 0.3)  # of what either vehicle reports
P_W_N = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, slots=True)
class Channel:
    """Sums of sines of random phase for several axes: smooth, with a standard deviation and a band of frequencies."""

    amplitude: Array  # (axes, WAVES)
    rate: Array
    phase: Array

    @classmethod
    def of(cls, sigmas: tuple[float, ...], band_hz: tuple[float, float], rng: np.random.Generator) -> Channel:
        shape = len(sigmas), WAVES
        weight = rng.uniform(0.5, 1.5, shape)
        weight *= math.sqrt(2.0) / np.linalg.norm(weight, axis=1)[:, None]
        rate = 2.0 * math.pi * np.exp(rng.uniform(math.log(band_hz[0]), math.log(band_hz[1]), shape))
        return cls(weight * np.array(sigmas)[:, None], rate, rng.uniform(0.0, 2.0 * math.pi, shape))

    def rate_at(self, times_s: Array) -> Array:
        """Derivative, (n, axes)."""
        wave = np.cos(self.rate * times_s[:, None, None] + self.phase)
        return np.sum(self.amplitude * self.rate * wave, axis=2)

    def at(self, times_s: Array) -> Array:
        """(n, axes)."""
        return np.sum(self.amplitude * np.sin(self.rate * times_s[:, None, None] + self.phase), axis=2)


@dataclass(frozen=True, slots=True)
class Drone:
    wander: Channel
    tilt: Channel
    yaw: Channel
    tilt_noise: Channel
    yaw_noise: Channel

    @classmethod
    def of(cls, rng: np.random.Generator) -> Drone:
        return cls(
            Channel.of(WANDER_M, WANDER_HZ, rng),
            Channel.of((TILT_RAD, TILT_RAD), TILT_HZ, rng),
            Channel.of((YAW_RAD,), YAW_HZ, rng),
            Channel.of((TILT_NOISE_RAD, TILT_NOISE_RAD), NOISE_HZ, rng),
            Channel.of((YAW_NOISE_RAD,), NOISE_HZ, rng),
        )

    def attitude(self, times_s: Array, lean: Array, yaw_rad: float) -> Array:
        """R_n_b, (n, 3, 3)."""
        tilt = self.tilt.at(times_s) + lean[:2]
        yaw = self.yaw.at(times_s)[:, 0] + (lean[2] + yaw_rad)
        return _turned_about_down(yaw) @ exp_all(np.concatenate((tilt, np.zeros((len(tilt), 1))), axis=1))

    def attitude_error(self, times_s: Array, bias: Array) -> Array:
        """Rotation vector in the body, (n, 3)."""
        return np.concatenate((self.tilt_noise.at(times_s), self.yaw_noise.at(times_s)), axis=1) + bias


@dataclass(frozen=True, slots=True)
class Poses:
    """At the frames of one camera: bodies in NED ``n`` and the drone's own estimate of its attitude."""

    R_n_b: Array
    t_n: Array
    R_estimated: Array


class Motion:
    """Both drones of one attempt."""

    def __init__(self, drawn: Drawn, rng: np.random.Generator) -> None:
        self._drawn = drawn
        self._sender, self._receiver = Drone.of(rng), Drone.of(rng)
        self._drift = Channel.of((DRIFT_M,) * 3, DRIFT_HZ, rng)
        self._speed_errors = [Channel.of((SPEED_NOISE_MPS,) * 3, SPEED_NOISE_HZ, rng) for _ in range(2)]

    def drift(self, times_s: Array) -> Array:
        """Error of D1's position estimate, (n, 3); a constant one would change nothing."""
        return self._drift.at(times_s)

    def sender(self, times_s: Array) -> Poses:
        drawn, errors = self._drawn, self._drawn.errors
        R = self._sender.attitude(times_s, errors.lean[0], 0.0)
        error = self._sender.attitude_error(times_s, errors.tilt_bias[0]) + self._jump(times_s, 0)
        target = drawn.things.at(times_s)[0][:, 0]
        t = drawn.place.sender_n_m + self._sender.wander.at(times_s)
        t[:, :2] += target
        return Poses(R, t, R @ exp_all(error))

    def receiver(self, times_s: Array) -> Poses:
        drawn, errors = self._drawn, self._drawn.errors
        R = self._receiver.attitude(times_s, errors.lean[1], drawn.place.receiver_yaw_rad)
        error = self._receiver.attitude_error(times_s, errors.tilt_bias[1]) + self._jump(times_s, 1)
        t = self.sender(times_s).t_n + drawn.place.receiver_n_m + self._receiver.wander.at(times_s)
        return Poses(R, t, R @ exp_all(error))

    def speeds(self, times_s: Array, drone: int) -> Array:
        """What a vehicle reports of its own velocity, NED (n, 3)."""
        step = 1e-3
        around = self._drawn.things.at(np.concatenate((times_s - step, times_s + step)))[0][:, 0]
        out = self._sender.wander.rate_at(times_s) + self._speed_errors[drone].at(times_s)
        out[:, :2] += (around[len(times_s) :] - around[: len(times_s)]) / (2.0 * step)
        return out + self._receiver.wander.rate_at(times_s) if drone else out

    def _jump(self, times_s: Array, drone: int) -> Array:
        faults = self._drawn.faults
        return within(times_s, faults.jump[drone])[:, None] * faults.jump_vector


def within(times_s: Array, spells: Array) -> NDArray[np.bool_]:
    """Whether each time is in one of the spells, rows (from, to)."""
    inside = (times_s[:, None] >= spells[:, 0]) & (times_s[:, None] < spells[:, 1])
    return np.any(inside, axis=1)


def exp_all(vectors: Array) -> Array:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    a, b = np.sinc(angle / math.pi), 0.5 * np.sinc(0.5 * angle / math.pi) ** 2
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    K = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    return np.eye(3) + a[:, None, None] * K + b[:, None, None] * (K @ K)


def _turned_about_down(yaw: Array) -> Array:
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    return np.stack((c, -s, zero, s, c, zero, zero, zero, one), axis=1).reshape(-1, 3, 3)
