"""The truth at one instant, as values: what the renderer draws and the monitors judge. World frame
``w`` is ENU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from hil.world.clutter import Crate
from hil.world.detector import PERFECT, DetectorConfig
from hil.world.gait import strides_of
from path.geometry.transforms import Pose
from path.messages import Role, Vec3
from path.values import value

TargetKind = Literal["car", "person", "drone"]
"""The things that can be tracked: a robot car, a person who walks, a micro-UAV."""

OWN_SIZE_M: Mapping[TargetKind, Vec3] = {
    "car": (0.32, 0.22, 0.16),
    "person": (0.69, 0.67, 1.75),
    "drone": (0.31, 0.31, 0.10),
}
"""Length, width and height of a body of each kind; of a person with limbs at their longest step."""
AS_IT_IS: Vec3 = (1.0, 1.0, 1.0)


def stretch_of(kind: TargetKind, size_m: Vec3 | None) -> Vec3:
    """Return by how much a body of a stated size is longer, wider and higher than its kind; people
    keep their shape.
    """
    if size_m is None:
        return AS_IT_IS
    own = OWN_SIZE_M[kind]
    if kind == "person":
        taller = size_m[2] / own[2]
        return taller, taller, taller
    return size_m[0] / own[0], size_m[1] / own[1], size_m[2] / own[2]


@value
class DroneTruth:
    """``T_w_b``: body FRD to world ENU. ``rotor_phase_rad`` turns the drawn blades.
    ``rates_b_radps``: its turn.
    """

    T_w_b: Pose
    velocity_w_mps: tuple[float, float, float]
    rotor_phase_rad: float
    armed: bool
    rates_b_radps: Vec3 = (0.0, 0.0, 0.0)

    def T_w_b_after(self, by_s: float) -> Pose:
        """Return the pose some time later or earlier: it moves on with its velocity."""
        return Pose(self.T_w_b.R, self.T_w_b.t + by_s * np.array(self.velocity_w_mps))


@value
class ObjectTruth:
    """The target (``object_id`` 0) or a look-alike.

    Its frame: x forward, z up; on the ground below it, or in the middle of what flies. ``strides``:
    those that a person has made, by which their limbs move.
    """

    object_id: int
    position_w_m: tuple[float, float, float]
    yaw_rad: float  # counter-clockwise from east
    speed_mps: float
    climb_mps: float = 0.0
    strides: float = 0.0

    def position_after(self, by_s: float) -> Vec3:
        """Return the position in ``w`` some time later or earlier: it moves on with its
        velocity.
        """
        (x, y, z), (east, north, up) = self.position_w_m, self.velocity_w_mps
        return x + by_s * east, y + by_s * north, z + by_s * up

    @property
    def velocity_w_mps(self) -> Vec3:
        return (
            self.speed_mps * math.cos(self.yaw_rad),
            self.speed_mps * math.sin(self.yaw_rad),
            self.climb_mps,
        )

    def strides_after(self, by_s: float) -> float:
        """Return the strides that a person has made some time later or earlier."""
        return self.strides + strides_of(by_s * self.speed_mps, self.speed_mps)

    def carried_on(self, by_s: float, kind: TargetKind) -> ObjectTruth:
        """Return the same thing some time later or earlier: it moves on with its velocity."""
        strides = self.strides_after(by_s) if kind == "person" else self.strides
        return replace(self, position_w_m=self.position_after(by_s), strides=strides)


@value
class Snapshot:
    """Everything at one instant.

    ``kind``: of all objects. ``stretch``: times the size that a body of this kind has along x, y
    and z of its frame. ``crates``: what else lies on the ground. ``obstacles``: boxes of what
    stands in the way, which hide what is behind them. ``light``: times what exposures usually take
    in. ``smudge``: share of the image's height that a smudge on each lens is wide.
    """

    time_s: float
    drones: dict[Role, DroneTruth]
    objects: tuple[ObjectTruth, ...]
    marker_hidden: bool = False
    depth_holes: bool = False
    detector: DetectorConfig = PERFECT
    kind: TargetKind = "car"
    stretch: Vec3 = AS_IT_IS
    crates: tuple[Crate, ...] = ()
    obstacles: tuple[Crate, ...] = ()
    light: float = 1.0
    smudge: float = 0.0

    def carried_on(self, by_s: float) -> Snapshot:
        """Return the snapshot some milliseconds later or earlier: everything moves on with its
        velocity.
        """
        drones = {
            role: replace(drone, T_w_b=drone.T_w_b_after(by_s))
            for role, drone in self.drones.items()
        }
        objects = tuple(thing.carried_on(by_s, self.kind) for thing in self.objects)
        return replace(self, time_s=self.time_s + by_s, drones=drones, objects=objects)
