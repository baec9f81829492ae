"""Inputs and outputs of the autopilot: settings, estimate, commands, answers and texts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from drivers.interfaces import FlightMode
from hil.autopilot.radio import RadioConfig
from path.bounds import Bounds
from path.messages import Quat, Vec3
from path.values import frozen, value

HOLD_AT_FENCE = 2
RETURN_AT_FENCE = 3
LAND_AT_FENCE = 5
MAX_SETPOINT_GAP_S = 0.2  # of a script that flies (S8)


@frozen
class FenceConfig:
    """The autopilot's own fence, around and above its home: GF_ACTION, GF_MAX_HOR_DIST and
    GF_MAX_VER_DIST of PX4.

    ``action``: 2 hold, 3 return, 5 land; anything else does nothing. A distance of 0 is none.
    """

    action: Annotated[int, Bounds(0, 5, "(an action)")] = HOLD_AT_FENCE
    radius_m: Annotated[float, Bounds(0.0, 10_000.0)] = 0.0
    height_m: Annotated[float, Bounds(0.0, 10_000.0)] = 0.0


@frozen
class AutopilotConfig:
    """Times and limits. Defaults are near PX4's, shortened where a wait would only cost simulation
    time.

    What PX4 and ArduCopter were measured to do is in docs/conformance.md; rig ``sitl`` has PX4's
    figures.
    """

    # from the first step until armable, ± 10 % by seed
    settle_s: Annotated[float, Bounds(0.0, 120.0)] = 2.5
    arming_fault: str = ""  # when set, never armable, for this reason
    # kept to whatever is asked for, changes shown with the next; 0: as asked, changes at once
    heartbeat_hz: Annotated[float, Bounds(0.0, 50.0)] = 0.0
    spool_s: Annotated[float, Bounds(0.0, 20.0)] = 1.0
    climb_mps: Annotated[float, Bounds(0.1, 10.0)] = 1.0
    land_mps: Annotated[float, Bounds(0.1, 10.0)] = 0.7
    touchdown_mps: Annotated[float, Bounds(0.05, 5.0)] = 0.4  # below 1 m over home
    max_horizontal_mps: Annotated[float, Bounds(0.1, 30.0)] = 3.0
    max_up_mps: Annotated[float, Bounds(0.1, 20.0)] = 1.5
    max_down_mps: Annotated[float, Bounds(0.1, 20.0)] = 1.0
    hold_gain_hz: Annotated[float, Bounds(0.05, 10.0)] = 1.0  # position error to velocity
    max_height_m: Annotated[float, Bounds(1.0, 1000.0)] = 30.0
    default_takeoff_m: Annotated[float, Bounds(0.3, 100.0)] = 1.5
    return_height_m: Annotated[float, Bounds(0.3, 100.0)] = 2.5
    return_mps: Annotated[float, Bounds(0.1, 30.0)] = 1.5
    offboard_loss_s: Annotated[float, Bounds(0.05, 60.0)] = 0.5
    # in HOLD after the loss, before LAND
    offboard_land_s: Annotated[float, Bounds(0.0, 600.0)] = 1.0
    setpoint_stale_s: Annotated[float, Bounds(0.05, 600.0)] = (
        math.inf
    )  # a setpoint older than this counts as standing still
    companion_loss_s: Annotated[float, Bounds(0.1, 600.0)] = (
        math.inf
    )  # without a ground station's heartbeat for this long it lands
    # ground contact this long is a landing
    land_detect_s: Annotated[float, Bounds(0.0, 10.0)] = 0.3
    land_disarm_s: Annotated[float, Bounds(0.0, 60.0)] = 1.0  # after that
    idle_disarm_s: Annotated[float, Bounds(0.1, 3600.0)] = 10.0
    endurance_s: Annotated[float, Bounds(10.0, 36000.0)] = 900.0  # full battery, flying
    # lands by itself; scripts should come down earlier
    low_battery: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.1
    radio: RadioConfig = field(default_factory=RadioConfig)
    fence: FenceConfig = field(default_factory=FenceConfig)


@value
class Estimate:
    """The estimator's output. Position (N, E, D) from the mission origin, velocity NED, attitude
    wxyz body to NED.

    ``resets``: how often it has stepped.
    """

    time_s: float
    position_n_m: Vec3
    velocity_n_mps: Vec3
    q_n_b: Quat
    resets: int = 0


@value
class RateCommand:
    """A command to the velocity loop.

    ``velocity_n_mps`` None: motors idle on the ground; ``thrust_on`` False: motors off.
    """

    velocity_n_mps: Vec3 | None
    yaw_rad: float
    thrust_on: bool


@frozen
class Ack:
    """Answer to a command. ``reason`` says why it was refused, empty when accepted."""

    accepted: bool
    reason: str = ""


class Severity(Enum):
    """MAVLink MAV_SEVERITY numbers."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


@frozen
class StatusText:
    time_s: float
    severity: Severity
    text: str


@dataclass(slots=True)
class OffboardSession:
    """One stay in OFFBOARD, with the times between setpoints (S8); the last one counts while it is
    open.

    Attributes:
        max_gap_s: the longest.
        long_gaps: from when to when each lasted that was longer than ``MAX_SETPOINT_GAP_S``.
    """

    start_s: float
    max_gap_s: float = 0.0
    end_s: float | None = None
    ended_by: FlightMode | None = None
    long_gaps: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])

    def note_gap(self, from_s: float, to_s: float) -> None:
        """No setpoint came between these instants. An open gap may be noted again and again, as it
        grows.
        """
        self.max_gap_s = max(self.max_gap_s, to_s - from_s)
        if to_s - from_s <= MAX_SETPOINT_GAP_S:
            return
        if self.long_gaps and self.long_gaps[-1][0] == from_s:
            self.long_gaps.pop()
        self.long_gaps.append((from_s, to_s))
