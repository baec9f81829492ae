"""A drone's rangefinder that looks down: over flat ground, with the errors of a small lidar.

Its scale is drawn once a flight, its noise with each measurement. What is beyond its reach is not
measured.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from path.bounds import Bounds
from path.geometry.rotation import R_from_quat
from path.messages import Quat
from path.values import frozen

EVERY_S = 0.05


@frozen
class RangefinderConfig:
    """The ``[world.rangefinder]`` table: taken from ``[height]`` where a rig has that.

    Attributes:
        max_m, min_m: what it measures between; with a ``max_m`` of 0 there is none.
        sigma_m: of one measurement. scale_sigma: of its scale.
    """

    max_m: Annotated[float, Bounds(0.0, 200.0)] = 0.0
    min_m: Annotated[float, Bounds(0.0, 10.0)] = 0.1
    sigma_m: Annotated[float, Bounds(0.0, 2.0)] = 0.03
    scale_sigma: Annotated[float, Bounds(0.0, 0.2, "of 1")] = 0.005


class SimRangefinder:
    """One drone's."""

    def __init__(
        self,
        config: RangefinderConfig,
        seed: int,
        number: int,
    ) -> None:
        self.config = config
        self._random = np.random.default_rng([seed, 0x72616E6765, number])
        self._scale = 1.0 + config.scale_sigma * self._random.standard_normal()
        self._next_s = 0.0
        self.below_m: float | None = None
        self.stamp_s = 0.0

    def sense(
        self,
        time_s: float,
        up_m: float,
        q_n_b: Quat,
    ) -> None:
        """Measure, when it is time. ``up_m``: the true height over the ground."""
        if time_s < self._next_s:
            return
        self._next_s = time_s + EVERY_S
        self.stamp_s = time_s
        config = self.config
        upright = float(R_from_quat(q_n_b)[2, 2])
        noise_m = config.sigma_m * self._random.standard_normal()
        along_m = up_m / upright if upright > 0.1 else math.inf
        measured_m = self._scale * along_m + noise_m
        self.below_m = measured_m if config.min_m < measured_m < config.max_m else None
