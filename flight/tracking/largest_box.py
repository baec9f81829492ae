"""The largest box that the target alone can have: a detector takes two that touch in its image for
one.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np

from flight.guidance import Vec3
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.rigid import rigid
from path.geometry.transforms import Pose
from path.observations import Box, Depth
from path.target.cylinder import reach_m

_AT_THE_CAMERA = rigid(Pose(np.eye(3), np.zeros(3)))


class LargestBox:
    """By the rule of ``path.target.size`` for what the target is: an upright cylinder, whichever
    way it heads.
    """

    def __init__(self, camera: CameraModel, method: MethodConfig) -> None:
        self._camera = camera
        self._method = method

    @classmethod
    def of(
        cls,
        camera: CameraModel,
        method: MethodConfig,
    ) -> Self | None:
        """The rule, where the method states how large the target is."""
        return cls(camera, method) if method.evidence.span_m > 0.0 else None

    def holds(
        self,
        box: Box,
        z_m: float,
        sigma_m: float,
        T_n_c: Pose,
    ) -> bool:
        """Return whether a box is no larger than the target alone can be at a depth, known to a
        standard deviation.
        """
        own = self._method.evidence
        gx, gy, gz = T_n_c.R[2].tolist()
        x, y = self._camera.ray(*box.center)
        place_c: Vec3 = (x * z_m, y * z_m, z_m)
        wide_m, high_m = reach_m(_AT_THE_CAMERA, place_c, (gx, gy, gz), own.span_m, own.height_m)
        larger = max(box.w * z_m / self._camera.fx / wide_m, box.h * z_m / self._camera.fy / high_m)
        pixels = 2.0 * self._method.pixel_sigma_px / max(1.0, min(box.w, box.h))
        sigma = math.hypot(pixels, sigma_m / z_m, own.size_sigma)
        return math.log(max(larger, 1e-9)) <= own.size_sigmas * sigma

    def most_m(
        self,
        box: Box,
        z_m: float,
        T_n_c: Pose,
    ) -> tuple[float, float]:
        """Return the largest width and height in m that a box of the target alone can have at a
        depth.
        """
        own = self._method.evidence
        gx, gy, gz = T_n_c.R[2].tolist()
        x, y = self._camera.ray(*box.center)
        wide_m, high_m = reach_m(
            _AT_THE_CAMERA,
            (x * z_m, y * z_m, z_m),
            (gx, gy, gz),
            own.span_m,
            own.height_m,
        )
        spread = math.exp(own.size_sigmas * own.size_sigma)
        return spread * wide_m, spread * high_m

    def apart(self, one: Depth, other: Depth) -> bool:
        """Return whether two depths are farther apart than the middle of such a body is from any
        place on it.
        """
        own = self._method.evidence
        least_m = 0.5 * math.hypot(own.span_m, own.height_m)
        return abs(one.z_m - other.z_m) > least_m + own.size_sigmas * math.hypot(
            one.sigma_m, other.sigma_m
        )
