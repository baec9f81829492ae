"""Poses and snapshots that the renderer's tests look at."""

from __future__ import annotations

import numpy as np

from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose
from path.messages import Role

VGA = CameraModel(640, 480, 615.0, 614.0, 321.3, 238.1, (0.08, -0.18, 0.0008, -0.0005, 0.05))
SMALL = CameraModel(96, 72, 92.0, 92.5, 48.3, 35.2, (0.08, -0.18, 0.0008, -0.0005, 0.05))
C = float(np.sqrt(0.5))
TAIL = Pose(np.array([[0.0, C, -C], [1.0, 0.0, 0.0], [0.0, -C, -C]]), np.array([-0.18, 0.0, -0.06]))
# a marker that stands clear of the drone: nothing but background is behind its plate
ABOVE = Pose(
    np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 0.0, -0.6])
)
LEVEL = Pose(np.eye(3), np.zeros(3))
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FAR_AWAY = Pose(NED_TO_ENU, np.array([0.0, -500.0, 1.0]))


def mount(pitch_deg: float) -> Pose:
    """A camera looking ahead and ``pitch_deg`` down."""
    c, s = np.cos(np.radians(pitch_deg)), np.sin(np.radians(pitch_deg))
    return Pose(
        np.column_stack(((0.0, 1.0, 0.0), (-s, 0.0, c), (c, 0.0, s))), np.array([0.1, 0.0, 0.03])
    )


def hovering(east: float, north: float, up: float, yaw_rad: float = 0.0) -> Pose:
    return Pose(NED_TO_ENU @ R_from_yaw(yaw_rad), np.array([east, north, up]))


def drone(pose: Pose, *, armed: bool = True, phase_rad: float = 0.7) -> DroneTruth:
    return DroneTruth(pose, (0.0, 0.0, 0.0), phase_rad, armed)


def at(object_id: int, east: float, north: float, yaw_rad: float = 0.0) -> ObjectTruth:
    return ObjectTruth(object_id, (east, north, 0.0), yaw_rad, 0.0)


def scene(*, marker_hidden: bool = False) -> Snapshot:
    """D1 1.4 m high with the target 2 m away, D2 behind, above and to the side of it, three
    look-alikes.
    """
    drones = {
        Role.SENDER: drone(hovering(0.0, 0.0, 1.4)),
        Role.RECEIVER: drone(hovering(0.45, -0.95, 2.1, -0.25)),
    }
    objects = (
        at(0, 0.05, 1.5, 0.6),
        at(1, 1.3, 2.0, 2.0),
        at(2, -1.0, 2.4, -1.0),
        at(3, -1.2, 0.4, 1.2),
    )
    return Snapshot(0.0, drones, objects, marker_hidden)


def looking_at(sender_from_camera: Pose) -> Snapshot:
    """The receiver's camera (mounted at its body's origin, LEVEL) 20 m high, looking north.

    ``sender_from_camera``: T_c_b1.
    """
    T_w_c = Pose(
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 20.0])
    )
    drones = {Role.SENDER: drone(T_w_c @ sender_from_camera), Role.RECEIVER: drone(T_w_c)}
    return Snapshot(0.0, drones, ())
