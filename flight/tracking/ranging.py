"""The range of an object that stands on the ground, by a drone's height and tilt: for cameras without depth.

A range by the object's size is off by as much as its headings differ, a fifth and more. Where the ray through its box
comes down to the height at which it stands is another range, which no heading moves. Each counts by its variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from flight.config import MissionConfig
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth

MIN_DESCENT = 0.2  # of a ray, per metre along the optical axis


@dataclass(frozen=True, slots=True)
class OverGround:
    """A drone's knowledge of its height above the ground that the object stands on, and of its tilt: one sigma each."""

    height_sigma_m: float
    tilt_sigma_rad: float

    @classmethod
    def of(cls, mission: MissionConfig) -> Self | None:
        """None where the mission does not state the height's, or the object flies."""
        if mission.target.flies or not mission.height_sigma_m > 0.0:
            return None
        return cls(mission.height_sigma_m, math.radians(mission.attitude_sigma_deg))

    def bettered(self, depth: Depth, box: Box, camera: CameraModel, T_n_c: Pose, down_m: float) -> Depth:
        """A depth with what the ground says of it; as it is for a ray that hardly comes down.

        Args:
            down_m: of the object's middle.
        """
        x, y = camera.ray(*box.center)
        north, east, sinking = (T_n_c.R @ (x, y, 1.0)).tolist()
        fall_m = down_m - float(T_n_c.t[2])
        if sinking < MIN_DESCENT or not fall_m > 0.0:
            return depth
        z_m = fall_m / sinking
        of_tilt_m = z_m * math.hypot(north, east) / sinking * self.tilt_sigma_rad
        by_ground = 1.0 / (of_tilt_m**2 + (self.height_sigma_m / sinking) ** 2)
        by_itself = 1.0 / max(depth.sigma_m**2, 1e-12)
        total = by_ground + by_itself
        return Depth((by_ground * z_m + by_itself * depth.z_m) / total, 1.0 / math.sqrt(total))
