"""Mounts of camera and marker on a drone, as a person writes them.

Measured on the body, or a calibration by its file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from drivers.rig.calibration_file import CalibrationError, MountCalibration, read_mount
from drivers.rig.tables import RigError, decode_table
from path.bounds import Bounds
from path.geometry.transforms import Matrix, Pose
from path.values import frozen

Vec3 = tuple[float, float, float]


@frozen
class CalibrationName:
    """Instead of numbers, the file of a calibration, relative to the rig."""

    calibration: Path


@frozen
class CameraMount:
    """Camera looking forward along body x, turned by roll, then pitched down, then yawed."""

    position_b_m: Annotated[Vec3, Bounds(-3.0, 3.0)]
    pitch_down_deg: Annotated[float, Bounds(-90.0, 90.0)]
    roll_deg: Annotated[float, Bounds(-180.0, 180.0)] = 0.0
    yaw_deg: Annotated[float, Bounds(-180.0, 180.0)] = 0.0

    def pose(self) -> Pose:
        # columns: x right, y down, z ahead
        forward = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        turn = _turn(self.roll_deg, -self.pitch_down_deg, self.yaw_deg)
        return Pose(turn @ forward, np.array(self.position_b_m))


@frozen
class MarkerMount:
    """Marker plate facing backwards, turned by roll, then tilted up, then yawed."""

    position_b_m: Annotated[Vec3, Bounds(-3.0, 3.0)]
    tilt_up_deg: Annotated[float, Bounds(-90.0, 90.0)]
    roll_deg: Annotated[float, Bounds(-180.0, 180.0)] = 0.0
    yaw_deg: Annotated[float, Bounds(-180.0, 180.0)] = 0.0

    def pose(self) -> Pose:
        # columns: x right, y up, z out
        backward = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        turn = _turn(self.roll_deg, -self.tilt_up_deg, self.yaw_deg)
        return Pose(turn @ backward, np.array(self.position_b_m))


@frozen
class MarkerPlace:
    """The marker's place on the sender: measured on the body, or calibrated against the camera."""

    measured: MarkerMount | None
    calibrated: MountCalibration | None

    @classmethod
    def from_table(
        cls,
        table: Any,
        where: str,
        base: Path | None,
    ) -> MarkerPlace:
        """Used by ``decode_table``. Raises RigError."""
        if not (isinstance(table, Mapping) and "calibration" in table):
            return cls(decode_table(table, MarkerMount, where, base), None)
        try:
            return cls(
                None, read_mount(decode_table(table, CalibrationName, where, base).calibration)
            )
        except CalibrationError as error:
            raise RigError([f"{where}.calibration: {error}"], error.remedy) from error

    def pose(self, T_b_c: Pose) -> Pose:
        """``T_b_v``, with the camera at ``T_b_c``."""
        if self.calibrated is not None:
            return T_b_c @ self.calibrated.T_v_c.inverse()
        assert self.measured is not None
        return self.measured.pose()


def axis_turn(axis: int, angle_deg: float) -> Matrix:
    a = math.radians(angle_deg)
    c = math.cos(a)
    s = math.sin(a)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def _turn(
    roll_deg: float,
    pitch_deg: float,
    yaw_deg: float,
) -> Matrix:
    return axis_turn(2, yaw_deg) @ axis_turn(1, pitch_deg) @ axis_turn(0, roll_deg)
