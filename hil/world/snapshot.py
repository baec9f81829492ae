"""The truth at one instant, as values: what the renderer draws and the monitors judge. World frame ``w`` is ENU."""

from __future__ import annotations

from dataclasses import dataclass

from path.geometry import Pose
from path.messages import Role


@dataclass(frozen=True, slots=True)
class DroneTruth:
    """``T_w_b``: body FRD to world ENU. ``rotor_phase_rad`` turns the drawn blades."""

    T_w_b: Pose
    velocity_w_mps: tuple[float, float, float]
    rotor_phase_rad: float
    armed: bool


@dataclass(frozen=True, slots=True)
class ObjectTruth:
    """A ground vehicle: the target (``object_id`` 0) or a look-alike. Its frame: x forward, z up, on the ground."""

    object_id: int
    position_w_m: tuple[float, float, float]
    yaw_rad: float  # counter-clockwise from east
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Snapshot:
    time_s: float
    drones: dict[Role, DroneTruth]
    objects: tuple[ObjectTruth, ...]
    marker_hidden: bool = False
    depth_holes: bool = False
