"""A multicopter autopilot in the manner of PX4: modes, failsafes and acknowledgements, stepped and without I/O.

The same object flies behind the in-process vehicle and behind the MAVLink endpoint. Nothing here knows truth except
``truth_on_ground``, which stands for the land detector. Times are seconds of the world's clock.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from drivers.interfaces import FlightMode, VelocitySetpoint

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class AutopilotConfig:
    """Times and limits. Defaults are near PX4's, shortened where a wait would only cost simulation time."""

    settle_s: float = 2.5  # from the first step until armable, ± 10 % by seed
    arming_fault: str = ""  # when set, never armable, for this reason
    spool_s: float = 1.0
    climb_mps: float = 1.0
    land_mps: float = 0.7
    touchdown_mps: float = 0.4  # below 1 m over home
    max_horizontal_mps: float = 3.0
    max_up_mps: float = 1.5
    max_down_mps: float = 1.0
    hold_gain_hz: float = 1.0  # position error to velocity
    max_height_m: float = 30.0
    default_takeoff_m: float = 1.5
    return_height_m: float = 2.5
    return_mps: float = 1.5
    offboard_loss_s: float = 0.5
    offboard_land_s: float = 1.0  # in HOLD after the loss, before LAND
    land_disarm_s: float = 1.0
    idle_disarm_s: float = 10.0
    endurance_s: float = 900.0  # full battery, flying
    low_battery: float = 0.15


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the estimator says. Position (N, E, D) from the mission origin, velocity NED, attitude wxyz body to NED."""

    time_s: float
    position_n_m: Vec3
    velocity_n_mps: Vec3
    q_n_b: Quat

    @property
    def yaw_rad(self) -> float:
        w, x, y, z = self.q_n_b
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True, slots=True)
class RateCommand:
    """To the velocity loop. ``velocity_n_mps`` None: motors idle on the ground; ``thrust_on`` False: motors off."""

    velocity_n_mps: Vec3 | None
    yaw_rad: float
    thrust_on: bool


@dataclass(frozen=True, slots=True)
class Ack:
    """Answer to a command. ``reason`` says why it was refused, empty when accepted."""

    accepted: bool
    reason: str = ""


class Severity(Enum):
    """MAVLink MAV_SEVERITY numbers."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


@dataclass(frozen=True, slots=True)
class StatusText:
    time_s: float
    severity: Severity
    text: str


@dataclass(slots=True)
class OffboardSession:
    """One stay in OFFBOARD. ``max_gap_s`` is the longest time between setpoints, the last open one included (S8)."""

    start_s: float
    max_gap_s: float = 0.0
    end_s: float | None = None
    ended_by: FlightMode | None = None


class ReturnPhase(Enum):
    CLIMB = 0
    CRUISE = 1
    DESCEND = 2


OK = Ack(True)
ZERO: Vec3 = (0.0, 0.0, 0.0)


class Autopilot:
    """Modes, arming, failsafes and the position loop of one multicopter.

    Call ``step`` at a steady rate (50 Hz is enough) and the ``request_*`` methods and ``setpoint`` between steps.
    Every command is idempotent: MAVSDK resends without saying so. ``status_texts`` only grows; readers keep
    their own index.
    """

    def __init__(self, config: AutopilotConfig, seed: int) -> None:
        self.config = config

    # --- telemetry ---

    @property
    def mode(self) -> FlightMode: ...
    @property
    def armed(self) -> bool: ...
    @property
    def landed(self) -> bool: ...
    @property
    def armable(self) -> bool: ...
    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not armable; empty when it is."""
        ...
    @property
    def battery(self) -> float:
        """0..1."""
        ...
    @property
    def home_n_m(self) -> Vec3 | None:
        """Estimated position at the newest arming, or the first armable one; None before."""
        ...
    @property
    def pilot_in_control(self) -> bool: ...
    @property
    def status_texts(self) -> Sequence[StatusText]: ...
    @property
    def offboard_sessions(self) -> Sequence[OffboardSession]: ...
    @property
    def setpoint_gap_s(self) -> float:
        """Longest gap between setpoints in any OFFBOARD session so far."""
        ...

    # --- commands ---

    def set_battery(self, fraction: float) -> None: ...
    def request_arm(self, now_s: float, arm: bool, force: bool = False) -> Ack:
        """Arm or disarm. ``force`` never disarms in the air and never skips a check."""
        ...
    def request_takeoff(self, now_s: float, height_m: float) -> Ack:
        """Climb to ``height_m`` above home, then HOLD by itself."""
        ...
    def request_mode(self, now_s: float, mode: FlightMode, by_pilot: bool = False) -> Ack:
        """OFFBOARD wants a setpoint younger than ``offboard_loss_s``; OTHER is the pilot's alone."""
        ...
    def setpoint(self, now_s: float, setpoint: VelocitySetpoint) -> bool:
        """Take a setpoint; False (ignored, not counted as arrived) when it has a non-finite number."""
        ...
    def step(self, now_s: float, estimate: Estimate, truth_on_ground: bool) -> RateCommand: ...
