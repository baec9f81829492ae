"""The ``[world]`` table of a rig: where drones stand, what errs and how much, the light, and what
there is to see.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, Literal, get_args

from drivers.rig.parts import Rig
from flight.harness.measured import MEASURED
from flight.harness.renderer import Imaging
from hil.autopilot.autopilot import AutopilotConfig
from hil.autopilot.simulator import SimulatorConfig
from hil.world.air import AirConfig
from hil.world.detector import DetectorConfig
from hil.world.dynamics import AirframeConfig
from hil.world.errors import ErrorsConfig, level_of, put_down
from hil.world.estimator import EstimatorConfig, WindConfig
from hil.world.obstacles import ObstaclesConfig
from hil.world.operator import PersonConfig
from hil.world.rangefinder import RangefinderConfig
from hil.world.targets import LookAlikeConfig, Point, TargetConfig
from path.bounds import Bounds, check_bounds
from path.messages import Role
from path.values import frozen

SceneName = Literal["plain", "outdoor-sun", "overcast", "low-sun", "dusk", "hall"]
SCENES: tuple[SceneName, ...] = get_args(SceneName)
ImagingName = Literal["measured", "ideal"]


@frozen
class HomeConfig:
    """The place of a drone at the start: (E, N) in m, nose direction clockwise from north."""

    position_m: Annotated[Point, Bounds(-1000, 1000)] = (0.0, 0.0)
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0


@frozen
class PositionOffsetConfig:
    """The offset of the drones' positions from the start, besides the errors of their estimators.

    The receiver's is the one that is off, in a direction drawn by seed; upward or downward
    likewise.
    """

    across_m: Annotated[float, Bounds(0.0, 50.0)] = 0.0
    height_m: Annotated[float, Bounds(0.0, 50.0)] = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)


@frozen
class AltitudeConfig:
    """The error of the vehicles' altitude above the sea. Their local frames and barometers have
    none of it.

    Attributes:
        offset_m: of the first drone upward, of the second downward, and so on.
        drift_mps: by which that grows, with the same sign, until it has grown by ``drift_most_m``.
        jump_m: by which every altitude jumps ``jump_after_s`` after it was switched on: a PX4
            without GPS that begins with vision anew takes the height it has for its altitude.
    """

    offset_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    drift_mps: Annotated[float, Bounds(-1.0, 1.0)] = 0.0
    drift_most_m: Annotated[float, Bounds(0.0, 100.0)] = 10.0
    jump_m: Annotated[float, Bounds(-5000.0, 5000.0)] = 0.0
    jump_after_s: Annotated[float, Bounds(0.0, 3600.0)] = 5.0

    def error_m(self, number: int, time_s: float) -> float:
        """The error of the drone with this number, from 0."""
        sign = -1.0 if number % 2 else 1.0
        drift_m = math.copysign(
            min(self.drift_most_m, abs(self.drift_mps) * time_s), self.drift_mps
        )
        jumped_m = self.jump_m if time_s >= self.jump_after_s else 0.0
        return sign * (self.offset_m + drift_m) + jumped_m


@frozen
class SceneConfig:
    """The ``[world.scene]`` table of a rig, for levels that draw frames.

    Attributes:
        name: of the scene (docs/errors.md); "plain" is soil in a soft light without shadows.
        crates: printed boxes that lie about beside the target's way, at ``sim-rendered``.
    """

    name: SceneName = "plain"
    crates: Annotated[int, Bounds(0, 200, "boxes")] = 0


@frozen
class ImagingConfig:
    """The ``[world.imaging]`` table of a rig, for levels that draw frames.

    Attributes:
        name: how the drones' colour cameras make an image: as the one of the D415's family that was
            measured (``flight.harness.measured``), or as an ideal sensor, with blur and noise
            alone; None: as measured, and ideal where the errors are exact.
    """

    name: ImagingName | None = None


@frozen
class WorldConfig:
    """The ``[world]`` table of a rig."""

    # of a core, for each role's program: on a computer that much slower (docs/compute.md)
    slow: Annotated[float | None, Bounds(0.02, 1.0, "of a core")] = None
    errors: ErrorsConfig = field(default_factory=ErrorsConfig)
    rangefinder: RangefinderConfig = field(default_factory=RangefinderConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    imaging: ImagingConfig = field(default_factory=ImagingConfig)
    wind: WindConfig = field(default_factory=WindConfig)
    air: AirConfig = field(default_factory=AirConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    position_offset: PositionOffsetConfig = field(default_factory=PositionOffsetConfig)
    altitude: AltitudeConfig = field(default_factory=AltitudeConfig)
    airframe: AirframeConfig = field(default_factory=AirframeConfig)
    autopilot: AutopilotConfig = field(default_factory=AutopilotConfig)
    detector: DetectorConfig | None = None  # as one was measured on such targets in this scene
    # who says which object is meant, in real time
    person: PersonConfig = field(default_factory=PersonConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    look_alikes: LookAlikeConfig = field(default_factory=LookAlikeConfig)
    obstacles: ObstaclesConfig = field(default_factory=ObstaclesConfig)
    sender_home: HomeConfig = field(default_factory=HomeConfig)
    receiver_home: HomeConfig = field(default_factory=lambda: HomeConfig((1.5, -3.0)))
    sender_simulator: SimulatorConfig | None = None
    receiver_simulator: SimulatorConfig | None = None

    def __post_init__(self) -> None:
        if math.dist(self.sender_home.position_m, self.receiver_home.position_m) < 1.0:
            raise ValueError("sender_home and receiver_home must be at least 1 m apart")
        if (self.sender_simulator is None) != (self.receiver_simulator is None):
            raise ValueError("either both drones have a simulator of their own, or none")

    def home(self, role: Role) -> HomeConfig:
        return self.sender_home if role is Role.SENDER else self.receiver_home

    def true_home(self, role: Role, seed: int) -> HomeConfig:
        """The place where a drone truly stands: the crew measured its place as well as it could."""
        said = self.home(role)
        return replace(
            said,
            position_m=put_down(said.position_m, self.errors.sizes, seed, list(Role).index(role)),
        )

    def simulator(self, role: Role) -> SimulatorConfig | None:
        return self.sender_simulator if role is Role.SENDER else self.receiver_simulator


def scene_of(rig: Rig) -> SceneName:
    """The scene that the cameras of a rig's world see."""
    return rig.world.get("scene", {}).get("name", SceneConfig().name)


def imaging_of(rig: Rig) -> Imaging | None:
    """The imaging of the colour cameras of a rig's world; None for an ideal sensor."""
    by_errors: ImagingName = "ideal" if level_of(rig) == "exact" else "measured"
    return MEASURED if rig.world.get("imaging", {}).get("name", by_errors) == "measured" else None


def drawn_imaging(rig: Rig) -> dict[str, str]:
    """The same as a report has it, beside the errors; nothing where no frames are drawn."""
    drawn = any("camera" in rig.role(role).perception.options for role in Role)
    return {"imaging": "ideal" if imaging_of(rig) is None else "measured"} if drawn else {}
