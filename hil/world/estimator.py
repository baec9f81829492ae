"""Wind, and what the drones' estimators get wrong: constant biases, slow wander and noise, by seed.

Everything that wanders is an Ornstein-Uhlenbeck process (for the wind a first-order Dryden
spectrum), advanced once a tick for all drones. One row is one drone; the columns of ``drift`` are
the slices below.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Annotated

import numpy as np

from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.world.errors import ErrorSizes, level_of, sizes_of
from path.arrays import Array
from path.bounds import Bounds
from path.compiled import kernel
from path.values import frozen

GUST = slice(0, 3)  # NED, m/s
WANDER = slice(3, 6)  # position, slowly, m
JITTER = slice(6, 9)  # position noise, m
VELOCITY_ERROR = slice(9, 12)  # m/s
TILT_ERROR = slice(12, 15)  # attitude noise, rotation vector in the body, rad
CHANNELS = 15
ESTIMATE_SIZE = 10  # position 3, velocity 3, attitude 4
BLOCK = 256  # ticks of random numbers drawn at once


@frozen
class WindConfig:
    """Mean wind and gusts; vertical gusts are half as strong."""

    speed_mps: Annotated[float, Bounds(0.0, 30.0)] = 1.5
    from_deg: Annotated[float, Bounds(-360.0, 360.0)] = 250.0
    gust_mps: Annotated[float, Bounds(0.0, 20.0)] = 0.4
    gust_time_s: Annotated[float, Bounds(0.0, 600.0, above=True)] = 2.0

    @property
    def mean_n_mps(self) -> tuple[float, float, float]:
        angle = math.radians(self.from_deg)
        return -self.speed_mps * math.cos(angle), -self.speed_mps * math.sin(angle), 0.0


@frozen
class EstimatorConfig:
    """Standard deviations of a GPS-aided estimator's errors, by seed. The attitude's biases are
    constant over a run; positions wander as slowly as ``position_time_s`` says, always by as
    much."""

    position_m: Annotated[float, Bounds(0.0, 50.0)] = 0.5  # per horizontal axis
    height_m: Annotated[float, Bounds(0.0, 50.0)] = 1.0
    position_time_s: Annotated[float, Bounds(0.0, 36000.0)] = 1200.0
    position_noise_m: Annotated[float, Bounds(0.0, 10.0)] = 0.02
    position_noise_time_s: Annotated[float, Bounds(0.0, 600.0)] = 0.5
    velocity_error_mps: Annotated[float, Bounds(0.0, 5.0)] = 0.03
    climb_error_mps: Annotated[float, Bounds(0.0, 5.0)] = 0.05
    velocity_error_time_s: Annotated[float, Bounds(0.0, 600.0)] = 3.0
    tilt_bias_deg: Annotated[float, Bounds(0.0, 30.0)] = 0.5
    tilt_noise_deg: Annotated[float, Bounds(0.0, 30.0)] = 0.2
    yaw_bias_deg: Annotated[float, Bounds(0.0, 90.0)] = 2.0
    yaw_noise_deg: Annotated[float, Bounds(0.0, 90.0)] = 0.3
    attitude_noise_time_s: Annotated[float, Bounds(0.0, 600.0)] = 0.5

    def times(self, sizes: ErrorSizes) -> EstimatorConfig:
        """Return the estimator with its attitude as much worse or better as the table of errors
        says.
        """
        return replace(
            self,
            tilt_bias_deg=sizes.tilt_bias * self.tilt_bias_deg,
            yaw_bias_deg=sizes.yaw_bias * self.yaw_bias_deg,
            tilt_noise_deg=sizes.attitude_noise * self.tilt_noise_deg,
            yaw_noise_deg=sizes.attitude_noise * self.yaw_noise_deg,
        )


def reported(rig: Rig) -> dict[str, str | float]:
    """The level of a rig's errors and every size, as a report has them, and of positions where the
    world draws them.
    """
    level = level_of(rig)
    sizes: dict[str, str | float] = {"level": level, **asdict(sizes_of(level))}
    if "sender_simulator" in rig.world:
        return sizes
    own = decode_table(
        rig.world.get("estimator", {}), EstimatorConfig, rig.where("world.estimator")
    )
    return {**sizes, "position_m": own.position_m, "height_m": own.height_m}


@kernel
def sense(
    states: Array, position_bias: Array, attitude_bias: Array, drift: Array, decay: Array, drive: Array, normals: Array,
    velocity_errors: Array, attitude_errors: Array, estimates: Array,
) -> None:  # fmt: skip
    """Advance all drift by one tick, then write every drone's errors and estimate.

    Args:
        states: (n, STATE_SIZE) of ``hil.world.dynamics``.
        position_bias, attitude_bias, velocity_errors, attitude_errors: (n, 3).
        drift, normals: (n, CHANNELS); decay, drive: (CHANNELS,).
        estimates: (n, ESTIMATE_SIZE).
    """
    for i in range(states.shape[0]):
        for k in range(drift.shape[1]):
            drift[i, k] = decay[k] * drift[i, k] + drive[k] * normals[i, k]
        s = states[i]
        out = estimates[i]
        for k in range(3):
            attitude_errors[i, k] = attitude_bias[i, k] + drift[i, 12 + k]
            out[k] = s[k] + position_bias[i, k] + drift[i, 3 + k] + drift[i, 6 + k]
            velocity_errors[i, k] = drift[i, 9 + k]
            out[3 + k] = s[3 + k] + velocity_errors[i, k]
        hx = 0.5 * attitude_errors[i, 0]
        hy = 0.5 * attitude_errors[i, 1]
        hz = 0.5 * attitude_errors[i, 2]
        w = s[6]
        x = s[7]
        y = s[8]
        z = s[9]
        scale = 1.0 / math.sqrt(1.0 + hx * hx + hy * hy + hz * hz)
        out[6] = (w - x * hx - y * hy - z * hz) * scale
        out[7] = (x + w * hx + y * hz - z * hy) * scale
        out[8] = (y + w * hy + z * hx - x * hz) * scale
        out[9] = (z + w * hz + x * hy - y * hx) * scale


class Sensors:
    """The errors and the wind of every drone, advanced tick by tick.

    Attributes:
        position_bias: (n, 3), constant: nothing unless positions are told to be apart;
            ``attitude_bias`` likewise, but drawn.
        attitude_errors: (n, 3) rad; ``velocity_errors`` and ``winds`` likewise, NED m/s.
        estimates: (n, ESTIMATE_SIZE).
    """

    def __init__(
        self,
        wind: WindConfig,
        config: EstimatorConfig,
        tick_s: float,
        seeds: list[np.random.SeedSequence],
    ) -> None:
        """``seeds``: one per drone; gusts and errors get streams of their own from each."""
        sigmas, times = _channels(wind, config)
        self._mean_wind = np.array(wind.mean_n_mps)
        self._decay = np.exp(-tick_s / times)
        self._drive = sigmas * np.sqrt(1.0 - self._decay**2)
        streams = [[np.random.default_rng(child) for child in seed.spawn(2)] for seed in seeds]
        self._streams = streams
        self.position_bias = np.zeros((len(seeds), 3))
        tilt = math.radians(config.tilt_bias_deg)
        yaw = math.radians(config.yaw_bias_deg)
        drawn = np.array([own.standard_normal(6) for _, own in streams])
        self.attitude_bias = drawn[:, 3:] * np.array([tilt, tilt, yaw])
        start = np.array(
            [
                np.concatenate((gusts.standard_normal(3), own.standard_normal(12)))
                for gusts, own in streams
            ]
        )
        self._drift = start * sigmas
        self._drift[:, WANDER] = drawn[:, :3] * sigmas[WANDER]
        self._normals = np.empty((BLOCK, len(seeds), CHANNELS))
        self._used = BLOCK
        self.velocity_errors = np.zeros((len(seeds), 3))
        self.attitude_errors = np.zeros((len(seeds), 3))
        self.estimates = np.zeros((len(seeds), ESTIMATE_SIZE))
        self.winds = self._mean_wind + self._drift[:, GUST]

    def begin_anew(self, row: int, config: EstimatorConfig) -> None:
        """One drone's estimator is started again: a position solution of its own."""
        sizes = np.array([config.position_m, config.position_m, config.height_m])
        self._drift[row, WANDER] = self._streams[row][1].standard_normal(3) * sizes

    def tick(self, states: Array) -> Array:
        """One tick later: new wind, new errors, and the estimates (n, ESTIMATE_SIZE) of these
        states.
        """
        if self._used == BLOCK:
            for i, (gusts, own) in enumerate(self._streams):
                self._normals[:, i, :3] = gusts.standard_normal((BLOCK, 3))
                self._normals[:, i, 3:] = own.standard_normal((BLOCK, CHANNELS - 3))
            self._used = 0
        sense(
            states, self.position_bias, self.attitude_bias, self._drift, self._decay, self._drive,
            self._normals[self._used], self.velocity_errors, self.attitude_errors, self.estimates,
        )  # fmt: skip
        self._used += 1
        np.add(self._drift[:, GUST], self._mean_wind, out=self.winds)
        return self.estimates


def _channels(wind: WindConfig, config: EstimatorConfig) -> tuple[Array, Array]:
    """Stationary standard deviation and correlation time of every column of ``drift``."""
    tilt = math.radians(config.tilt_noise_deg)
    yaw = math.radians(config.yaw_noise_deg)
    groups = (
        ((wind.gust_mps, wind.gust_mps, 0.5 * wind.gust_mps), wind.gust_time_s),
        ((config.position_m, config.position_m, config.height_m), config.position_time_s),
        ((config.position_noise_m,) * 3, config.position_noise_time_s),
        (
            (config.velocity_error_mps, config.velocity_error_mps, config.climb_error_mps),
            config.velocity_error_time_s,
        ),
        ((tilt, tilt, yaw), config.attitude_noise_time_s),
    )
    sigmas = np.array([sigma for group, _ in groups for sigma in group])
    times = np.array([max(time, 1e-6) for _, time in groups for _ in range(3)])
    return sigmas, times
