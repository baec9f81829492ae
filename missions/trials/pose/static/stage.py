"""The seven configurations of the static experiment: where D1, D2 and the target truly are.

World ``w`` is ENU; D1 hovers above the origin and heads east. D2's place is given from the marker:
range, azimuth from straight behind D1 (positive to D1's left), elevation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers.rig.parts import Rig
from flight.harness.renderer import RenderedInstant, Thing
from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Matrix, Pose, Vector
from path.marker.layout import MarkerLayout
from path.messages import Role
from path.values import frozen

CAMERA = CameraModel(1280, 720, 920.0, 919.0, 642.0, 358.0, (0.06, -0.12, 0.001, -0.0008, 0.0))
"""Of both drones, as it truly is: colour of a D415 at 720p."""
# as the rigs state it
SIDE_M = 0.040
SIDE_SIGMA_M = 0.0001

HEIGHT_M = 0.9  # of D1: its target is about a metre from its camera, the paper's nominal depth
PLACES_M = ((1.05, 0.0), (0.9, 0.3), (1.25, -0.3))  # of the target: ahead of D1, to its left
# standard deviations per axis
HOVER_M = 0.02
HOVER_RAD = math.radians(1.5)
HOVER_YAW_RAD = math.radians(2.0)
R_W_N = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # ENU from NED


@frozen
class Configuration:
    """One place of D2.

    Attributes:
        facing: D2 is turned towards D1 (between marker and target); otherwise it heads as D1 does.
        place: number of the target's place.
    """

    name: str
    facing: bool
    range_m: float
    azimuth_deg: float
    elevation_deg: float
    place: int


CONFIGURATIONS = (
    Configuration("A", False, 0.70, 0.0, 45.0, 0),
    Configuration("B", False, 1.10, 15.0, 35.0, 1),
    Configuration("C", False, 1.50, -15.0, 55.0, 2),
    Configuration("D", True, 0.83, 40.0, 40.0, 1),
    Configuration("E", True, 0.97, -65.0, 50.0, 2),
    Configuration("F", True, 1.23, -40.0, 40.0, 0),
    Configuration("G", True, 1.37, 65.0, 50.0, 1),
)
"""Ranges evenly over 0.7 to 1.5 m, elevations 45° and 10° to either side, three places of the
target.
"""
SQUARE = Configuration("H", False, 1.50, 0.0, 45.0, 0)
"""Beside the seven: the worst view there is, from afar along the marker's normal, where its tilt
hardly shows.
"""
STANDS = (*CONFIGURATIONS, SQUARE)


@frozen(eq=False)
class Mounts:
    """The true mounts of both drones: cameras and marker frame to body (FRD). Equal by their
    numbers.
    """

    T_b_c1: Pose
    T_b_v: Pose
    T_b_c2: Pose

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mounts) and self._bytes() == other._bytes()

    def __hash__(self) -> int:
        return hash(self._bytes())

    def _bytes(self) -> bytes:
        return b"".join(
            array.tobytes() for T in (self.T_b_c1, self.T_b_v, self.T_b_c2) for array in (T.R, T.t)
        )

    @property
    def T_v_c1(self) -> Pose:
        return self.T_b_v.inverse() @ self.T_b_c1

    def T_b_c(self, role: Role) -> Pose:
        return self.T_b_c1 if role is Role.SENDER else self.T_b_c2


def with_camera(rig: Rig, layout: MarkerLayout) -> Rig:
    """Return the rig as it is in the trial: both drones have its camera, and D1 its marker."""
    sender, receiver = (replace(rig.role(role), camera=CAMERA) for role in Role)
    return replace(rig, sender=sender, receiver=receiver, layout=layout)


def mounts_of(rig: Rig) -> Mounts:
    return Mounts(rig.sender.mount.T_b_c, rig.sender.mount.T_b_v, rig.receiver.mount.T_b_c)


def nominal(configuration: Configuration, mounts: Mounts) -> tuple[Pose, Pose, float]:
    """``T_w_b`` of D1 and of D2 without hover motion, and D2's heading relative to D1's, rad
    counter-clockwise.
    """
    D1 = Pose(attitude(0.0, 0.0, 0.0), np.array([0.0, 0.0, HEIGHT_M]))
    marker_w = (D1 @ mounts.T_b_v).t
    azimuth = math.radians(configuration.azimuth_deg)
    elevation = math.radians(configuration.elevation_deg)
    level = math.cos(elevation)
    toward = np.array([-level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    camera_w = marker_w + configuration.range_m * toward
    heading = _between(camera_w, marker_w, target_w(configuration)) if configuration.facing else 0.0
    R_w_b = attitude(0.0, 0.0, heading)
    return D1, Pose(R_w_b, camera_w - R_w_b @ mounts.T_b_c2.t), heading


def target_w(configuration: Configuration) -> Vector:
    x, y = PLACES_M[configuration.place]
    return np.array([x, y, 0.0])


def hovering(T_w_b: Pose, rng: np.random.Generator) -> Pose:
    """A drone that holds its place as well as it can."""
    roll, pitch = rng.normal(0.0, HOVER_RAD, 2)
    turn = rotation.R_from_rpy(float(roll), float(pitch), float(rng.normal(0.0, HOVER_YAW_RAD)))
    return Pose(T_w_b.R @ turn, T_w_b.t + rng.normal(0.0, HOVER_M, 3))


def stage_of(
    configuration: Configuration,
    mounts: Mounts,
    heading_rad: float,
    rng: np.random.Generator,
) -> RenderedInstant:
    """The stage of one measurement; ``heading_rad`` of the target."""
    D1, D2, _ = nominal(configuration, mounts)
    x, y, z = target_w(configuration).tolist()
    drones = {Role.SENDER: hovering(D1, rng), Role.RECEIVER: hovering(D2, rng)}
    return RenderedInstant(
        drones,
        (Thing("car", (x, y, z), heading_rad),),
        float(rng.uniform(0.0, math.tau)),
    )


def attitude(
    roll: float,
    pitch: float,
    heading_rad: float,
) -> Matrix:
    """``R_w_b``; the heading is counter-clockwise from east."""
    return R_W_N @ rotation.R_from_rpy(roll, pitch, 0.5 * math.pi - heading_rad)


def _between(
    eye_w: Vector,
    a_w: Vector,
    b_w: Vector,
) -> float:
    """Heading half way between two points."""
    a, b = (math.atan2(p[1] - eye_w[1], p[0] - eye_w[0]) for p in (a_w, b_w))
    return a + 0.5 * rotation.wrapped(b - a)
