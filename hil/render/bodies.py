"""The bodies that stand and fly in the world: models at poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.render.scene import Model
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose

Array = NDArray[np.float64]

STILL = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A model at its pose in the world.

    Attributes:
        motion: (3,): cosine and sine of the blades' angle, 1 when they turn.
        target: it is of the kind that is tracked: depth may be missing over it.
    """

    model: Model
    T_w_body: Pose
    motion: Array
    target: bool


def flying(model: Model, T_w_b: Pose, rotor_phase_rad: float, turning: bool) -> Body:
    """A drone."""
    return Body(
        model, T_w_b, np.array([math.cos(rotor_phase_rad), math.sin(rotor_phase_rad), float(turning)]), target=False
    )


def lying(model: Model, T_w_o: Pose) -> Body:
    """Something that neither moves nor is tracked, at any pose."""
    return Body(model, T_w_o, STILL, target=False)


def standing(model: Model, position_w_m: tuple[float, float, float], yaw_rad: float) -> Body:
    """A car or a person, upright. ``yaw_rad``: counter-clockwise from east."""
    return Body(model, Pose(R_from_yaw(yaw_rad), np.array(position_w_m)), STILL, target=True)
