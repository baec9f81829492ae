"""Every range that a drone has of the object that it follows, asked for where it has something to
say.

What they are and how they count is ``path.target.range``. Here is when they are asked. Where the
depth camera has depth, that counts, and the ground betters it. Where it has none within its reach
the frame stays a miss, since a hole says nothing of how far away the object is. Beyond its reach,
and for cameras without depth, the object's size and the ground stand in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from flight.config import MissionConfig
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, RangeSource
from path.target.range import (
    UNKNOWN,
    Body,
    Ranged,
    Sight,
    by_ground,
    by_size,
    together,
)
from path.values import value

COARSE = 0.058  # of a range: one that is known no better is estimated, not measured


@value
class Ground:
    """The ground that the object stands on: how far down it is in this drone's own frame, and by
    what that is known.
    """

    down_m: float
    sigma_m: float
    source: RangeSource = RangeSource.GROUND


@dataclass(slots=True)
class Ranging:
    """What a drone knows for ranging its object, besides depth.

    Attributes:
        height_m: of the object's middle above the ground.
        angle_sigma_rad: of a line of sight against gravity.
        body: 0 where its size is not known.
        ground: None where it is not known, or where the object flies. Kept up by whoever measures
            it.
        reach_m: as far as the depth camera can be trusted.
    """

    height_m: float
    angle_sigma_rad: float
    pixel_sigma_px: float
    body: Body = UNKNOWN
    ground: Ground | None = None
    reach_m: float = math.inf

    @classmethod
    def of(
        cls,
        mission: MissionConfig,
        method: MethodConfig,
    ) -> Self:
        """Take what mission and method state; the ground is where it took off, where the height's
        error is stated.
        """
        known = mission.height_sigma_m > 0.0 and not mission.target.flies
        return cls(
            mission.target.height_m,
            math.radians(mission.attitude_sigma_deg),
            method.pixel_sigma_px,
            Body(method.evidence.span_m, method.evidence.height_m),
            Ground(0.0, mission.height_sigma_m) if known else None,
            method.max_depth_m,
        )

    def ranged(
        self,
        depth: Depth | None,
        box: Box,
        camera: CameraModel,
        T_n_c: Pose,
        expected_z_m: float,
    ) -> Ranged | None:
        """Return what all ranges of a box say; None where there is none.

        Args:
            depth: what the camera itself has.
            expected_z_m: about how far away the object is, along the optical axis.
        """
        if depth is None and expected_z_m <= self.reach_m:
            return None
        if depth is not None and self.ground is None and depth.sigma_m <= COARSE * depth.z_m:
            return together([depth])
        sight = _sight(box, camera, T_n_c)
        ranges = [
            depth,
            self._by_size(depth, box, camera, sight),
            self._by_ground(camera, T_n_c, sight),
        ]
        return together([each for each in ranges if each is not None])

    def _by_size(
        self,
        depth: Depth | None,
        box: Box,
        camera: CameraModel,
        sight: Sight,
    ) -> Depth | None:
        """Ask the size only where depth is none or coarse: what hides a part of an object makes it
        seem farther off.
        """
        if depth is not None and (
            depth.source is RangeSource.SIZE or depth.sigma_m <= COARSE * depth.z_m
        ):
            return None
        return by_size(box, camera, sight, self.body, self.pixel_sigma_px)

    def _by_ground(
        self,
        camera: CameraModel,
        T_n_c: Pose,
        sight: Sight,
    ) -> Depth | None:
        ground = self.ground
        if ground is None:
            return None
        above_m = ground.down_m - self.height_m - float(T_n_c.t[2])
        angle_rad = math.hypot(self.angle_sigma_rad, self.pixel_sigma_px / camera.fy)
        return by_ground(above_m, ground.sigma_m, angle_rad, sight, self.body, ground.source)


def _sight(
    box: Box,
    camera: CameraModel,
    T_n_c: Pose,
) -> Sight:
    x, y = camera.ray(*box.center)
    gx, gy, gz = T_n_c.R[2].tolist()
    return Sight((x, y, 1.0), (gx, gy, gz))
