"""The motion of both drones in truth and by their own estimate: holding a place, never quite."""

from __future__ import annotations

import math

import numpy as np

from hil.montecarlo.scene import Drawn
from path.arrays import Array, Flags
from path.compiled import kernel
from path.values import frozen

WAVES = 4
# Standard deviations and frequencies of what wavers; the trial prints them.
WANDER_M = (0.05, 0.05, 0.03)
WANDER_HZ = (0.05, 0.5)
TILT_RAD = math.radians(1.0)
TILT_HZ = (0.2, 1.5)
YAW_RAD = math.radians(1.5)
YAW_HZ = (0.05, 0.5)
TILT_NOISE_RAD = math.radians(0.2)
YAW_NOISE_RAD = math.radians(0.3)
NOISE_HZ = (0.1, 2.0)
# of D1's position estimate
DRIFT_M = 0.02
DRIFT_HZ = (0.05, 0.5)
# of what either vehicle reports
SPEED_NOISE_MPS = 0.03
SPEED_NOISE_HZ = (0.03, 0.3)
P_W_N = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


# What wavers, and its columns.
CHANNELS: tuple[tuple[tuple[float, ...], tuple[float, float]], ...] = (
    (WANDER_M, WANDER_HZ),  # the sender, then the receiver
    (WANDER_M, WANDER_HZ),
    ((TILT_RAD, TILT_RAD), TILT_HZ),
    ((YAW_RAD,), YAW_HZ),
    ((TILT_RAD, TILT_RAD), TILT_HZ),
    ((YAW_RAD,), YAW_HZ),
    ((TILT_NOISE_RAD, TILT_NOISE_RAD), NOISE_HZ),
    ((YAW_NOISE_RAD,), NOISE_HZ),
    ((TILT_NOISE_RAD, TILT_NOISE_RAD), NOISE_HZ),
    ((YAW_NOISE_RAD,), NOISE_HZ),
    ((DRIFT_M,) * 3, DRIFT_HZ),
    ((SPEED_NOISE_MPS,) * 3, SPEED_NOISE_HZ),
    ((SPEED_NOISE_MPS,) * 3, SPEED_NOISE_HZ),
)
WANDER = (slice(0, 3), slice(3, 6))
ATTITUDE = (slice(6, 9), slice(9, 12))
ATTITUDE_NOISE = (slice(12, 15), slice(15, 18))
DRIFT = slice(18, 21)
SPEED_NOISE = (slice(21, 24), slice(24, 27))
EVERYTHING = slice(None)
SENDER = 0
RECEIVER = 1


@kernel
def _waves(waves: Array, times: Array, out: Array) -> None:
    """Sums of sines: ``waves`` (channels, WAVES, 3) with amplitude, rate and phase, ``out`` (n,
    channels) filled.
    """
    for k in range(times.size):
        for c in range(waves.shape[0]):
            total = 0.0
            for w in range(waves.shape[1]):
                total += waves[c, w, 0] * math.sin(waves[c, w, 1] * times[k] + waves[c, w, 2])
            out[k, c] = total


def _drawn(rng: np.random.Generator) -> Array:
    """Sines of random weight, rate and phase for all channels, with their standard deviations."""
    sigma = np.concatenate([np.array(sigmas) for sigmas, _ in CHANNELS])
    low, high = (np.concatenate([np.full(len(s), band[k]) for s, band in CHANNELS]) for k in (0, 1))
    shape = len(sigma), WAVES
    weight = rng.uniform(0.5, 1.5, shape)
    weight *= (math.sqrt(2.0) * sigma / np.linalg.norm(weight, axis=1))[:, None]
    rate = 2.0 * math.pi * np.exp(rng.uniform(np.log(low)[:, None], np.log(high)[:, None], shape))
    return np.stack((weight, rate, rng.uniform(0.0, 2.0 * math.pi, shape)), axis=2)


@frozen
class HandoverPoses:
    """Both drones at some instants, by drone: bodies in NED ``n``; and how far off the attitude
    estimates are.

    ``attitude_error``: rotation vectors in the body. ``drift``: of the sender's position estimate.
    """

    R_n_b: tuple[Array, Array]
    t_n: tuple[Array, Array]
    attitude_error: tuple[Array, Array]
    drift: Array

    def estimated(self, drone: int) -> Array:
        """R_n_b as the drone believes."""
        return self.R_n_b[drone] @ exp_all(self.attitude_error[drone])


class HandoverMotion:
    """Both drones of one attempt."""

    def __init__(self, drawn: Drawn, rng: np.random.Generator) -> None:
        self._drawn = drawn
        self._waves = _drawn(rng)

    def poses(self, times_s: Array, target: Array) -> HandoverPoses:
        """Return the poses at instants; ``target``: (n, 2) north and east of it then."""
        drawn = self._drawn
        errors = self._drawn.errors
        values = self._at(times_s)
        yaws = 0.0, drawn.place.receiver_yaw_rad
        sender_t = drawn.place.sender_n_m + values[:, WANDER[SENDER]]
        sender_t[:, :2] += target
        receiver_t = sender_t + drawn.place.receiver_n_m + values[:, WANDER[RECEIVER]]
        R = [
            _attitude(values[:, ATTITUDE[i]] + errors.mean_tilt[i], yaws[i])
            for i in (SENDER, RECEIVER)
        ]
        noise = [errors.attitude_noise * values[:, ATTITUDE_NOISE[i]] for i in (SENDER, RECEIVER)]
        off = [noise[i] + errors.tilt_bias[i] + self._jump(times_s, i) for i in (SENDER, RECEIVER)]
        return HandoverPoses(
            (R[0], R[1]), (sender_t, receiver_t), (off[0], off[1]), values[:, DRIFT]
        )

    def reported(self, times_s: Array, drone: int) -> Array:
        """Velocities that a vehicle reports, NED (n, 3)."""
        step = 1e-3
        count = len(times_s)
        around_s = np.concatenate((times_s - step, times_s + step))
        places = self._at(around_s, WANDER[SENDER])
        if drone == RECEIVER:
            places += self._at(around_s, WANDER[RECEIVER])
        places[:, :2] += self._drawn.things.at(around_s)[0][:, 0]
        return (places[count:] - places[:count]) / (2.0 * step) + self._at(
            times_s, SPEED_NOISE[drone]
        )

    def yaw(self, times_s: Array) -> Array:
        """The sender's, as it reports it."""
        errors = self._drawn.errors
        own = self._at(times_s, ATTITUDE[SENDER])[:, 2] + errors.mean_tilt[SENDER, 2]
        noise = errors.attitude_noise * self._at(times_s, ATTITUDE_NOISE[SENDER])[:, 2]
        return own + noise + errors.tilt_bias[SENDER, 2]

    def _at(self, times_s: Array, channels: slice = EVERYTHING) -> Array:
        waves = self._waves[channels]
        out = np.empty((len(times_s), len(waves)))
        _waves(waves, times_s, out)
        return out

    def _jump(self, times_s: Array, drone: int) -> Array:
        faults = self._drawn.faults
        return within(times_s, faults.jump[drone])[:, None] * faults.jump_vector


def _attitude(angles: Array, yaw_rad: float) -> Array:
    """R_n_b, (n, 3, 3), of tilts in the body and a yaw, (n, 3)."""
    tilt = angles.copy()
    tilt[:, 2] = 0.0
    return _turned_about_down(angles[:, 2] + yaw_rad) @ exp_all(tilt)


def within(times_s: Array, spells: Array) -> Flags:
    """Return whether each time is in one of the spells, rows (from, to)."""
    inside = (times_s[:, None] >= spells[:, 0]) & (times_s[:, None] < spells[:, 1])
    return np.any(inside, axis=1)


def exp_all(vectors: Array) -> Array:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    a = np.sinc(angle / math.pi)
    b = 0.5 * np.sinc(0.5 * angle / math.pi) ** 2
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    K = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    return np.eye(3) + a[:, None, None] * K + b[:, None, None] * (K @ K)


def _turned_about_down(yaw: Array) -> Array:
    c = np.cos(yaw)
    s = np.sin(yaw)
    zero = np.zeros_like(yaw)
    one = np.ones_like(yaw)
    return np.stack((c, -s, zero, s, c, zero, zero, zero, one), axis=1).reshape(-1, 3, 3)
