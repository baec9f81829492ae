"""The errors of what drones believe in one session, for trials that judge single frames.

The rig names who draws it (``[trials] errors``): the world's own table of errors, as large as the
rig's level says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from drivers.rig.parts import Rig
from path.arrays import Depths
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role
from path.values import frozen


@frozen
class DepthError:
    """The error of every depth that one camera measures: a factor, and what comes on top."""

    factor: float = 1.0
    bias_m: float = 0.0

    def measured_m(self, depth_m: float) -> float:
        return self.factor * depth_m + self.bias_m

    def measured_mm(self, depth_mm: Depths) -> Depths:
        """A depth image with this error; 0, where there is none, stays 0."""
        if self.factor == 1.0 and self.bias_m == 0.0:
            return depth_mm
        wrong = depth_mm.astype(np.float32)
        wrong *= np.float32(self.factor)
        wrong += np.float32(1000.0 * self.bias_m + 0.5)
        measured = wrong.astype(np.uint16)
        measured *= depth_mm > 0
        return measured


@frozen
class DrawnErrors:
    """The beliefs of two drones about themselves in one session, and the errors of their sensors.

    Attributes:
        cameras, T_b_c: of each drone; ``T_b_v`` of the marker on D1; ``layout`` as it is believed
            to be printed.
        depth: of each drone's camera.
        tilt_bias_rad: of each drone's roll and pitch.
        tilt_noise_rad: standard deviation of what comes on top in every frame.
    """

    cameras: Mapping[Role, CameraModel]
    T_b_c: Mapping[Role, Pose]
    T_b_v: Pose
    layout: MarkerLayout
    depth: Mapping[Role, DepthError]
    tilt_bias_rad: Mapping[Role, tuple[float, float]]
    tilt_noise_rad: float


class TrialErrors(Protocol):
    """The table of errors of a rig's level, around what the rig says, which is the truth of the
    trial.
    """

    def __init__(self, rig: Rig) -> None: ...

    def session(self, seed: int) -> DrawnErrors:
        """Return the draws of one session."""
        ...

    def rows(self) -> tuple[tuple[str, str, str], ...]:
        """Return what is drawn, how large it is, and for how long it lasts, as rows of a report."""
        ...
