"""The position loop of each of the autopilot's modes: from the estimate to a velocity.

Positions are (N, E, D) in metres from the mission origin, velocities NED in m/s.
"""

from __future__ import annotations

import math
from enum import Enum

from drivers.interfaces import FlightMode
from hil.autopilot.values import AutopilotConfig, Estimate
from path.geometry.rotation import yaw_of
from path.messages import Vec3

STOP_S = 0.4  # a drone told to hold comes to rest this much further along its velocity
HOLD_MPS = 1.0
AT_HEIGHT_M = 0.1
AT_HOME_M = 0.3
LOW_M = 1.0  # below this height over home the descent slows down
MIN_CLIMB_MPS = 0.2


def toward(
    position: Vec3,
    goal: Vec3,
    gain_hz: float,
    max_horizontal_mps: float,
    max_vertical_mps: float,
) -> Vec3:
    """Velocity proportional to the distance left, limited horizontally (as a vector) and
    vertically.
    """
    vn, ve, vd = (gain_hz * (g - p) for g, p in zip(goal, position, strict=True))
    return limited((vn, ve, vd), max_horizontal_mps, max_vertical_mps, max_vertical_mps)


def limited(
    velocity: Vec3,
    max_horizontal_mps: float,
    max_up_mps: float,
    max_down_mps: float,
) -> Vec3:
    """The same direction over ground, no faster than the limits."""
    vn, ve, vd = velocity
    speed = math.hypot(vn, ve)
    scale = max_horizontal_mps / speed if speed > max_horizontal_mps else 1.0
    return vn * scale, ve * scale, min(max_down_mps, max(-max_up_mps, vd))


class ReturnPhase(Enum):
    CLIMB = 0
    CRUISE = 1
    DESCEND = 2


class Guidance:
    """The hold of the mode just entered, and the velocity that follows from it."""

    def __init__(self, config: AutopilotConfig) -> None:
        self._config = config
        self._hold: Vec3 = (0.0, 0.0, 0.0)
        self._since_s = 0.0
        self._return_phase = ReturnPhase.CLIMB
        self.yaw_rad = 0.0
        self.climb_to_m = config.default_takeoff_m

    def enter(self, now_s: float, estimate: Estimate) -> None:
        """A mode begins: keep the heading, and the place where the drone will have come to rest."""
        (n, e, d), (vn, ve, vd) = estimate.position_n_m, estimate.velocity_n_mps
        self._hold = (n + STOP_S * vn, e + STOP_S * ve, d + STOP_S * vd)
        self._since_s = now_s
        self._return_phase = ReturnPhase.CLIMB
        self.yaw_rad = yaw_of(estimate.q_n_b)

    def height_reached(self, estimate: Estimate, home: Vec3) -> bool:
        """Return whether a take-off is where it should end."""
        return home[2] - estimate.position_n_m[2] > self.climb_to_m - AT_HEIGHT_M

    def hold_height(self, home: Vec3) -> None:
        """Hold the height asked for after a take-off, not the one passed through."""
        north, east, _ = self._hold
        self._hold = (north, east, home[2] - self.climb_to_m)

    def hold_at(self, goal: Vec3) -> None:
        """Go to a place, and hold there."""
        self._hold = goal

    def velocity(
        self,
        now_s: float,
        mode: FlightMode,
        estimate: Estimate,
        home: Vec3,
    ) -> Vec3 | None:
        """Velocity of every mode but OFFBOARD; None while the motors spool up for a take-off."""
        if mode is FlightMode.TAKEOFF:
            return self._take_off(now_s, estimate, home)
        if mode is FlightMode.LAND:
            return self._descend(self._hold, estimate, home)
        if mode is FlightMode.RETURN:
            return self._return(estimate, home)
        return self._go_to(self._hold, HOLD_MPS, estimate)

    def _go_to(
        self,
        goal: Vec3,
        speed_mps: float,
        estimate: Estimate,
    ) -> Vec3:
        return toward(
            estimate.position_n_m,
            goal,
            self._config.hold_gain_hz,
            speed_mps,
            self._config.climb_mps,
        )

    def _take_off(
        self,
        now_s: float,
        estimate: Estimate,
        home: Vec3,
    ) -> Vec3 | None:
        climb_mps = self._config.climb_mps
        since_spool_s = now_s - self._since_s - self._config.spool_s
        if since_spool_s < 0.0:
            return None
        left_m = self.climb_to_m - (home[2] - estimate.position_n_m[2])
        vn, ve, _ = self._go_to(self._hold, HOLD_MPS, estimate)
        return vn, ve, -max(MIN_CLIMB_MPS, min(climb_mps, climb_mps * since_spool_s, left_m))

    def _descend(
        self,
        over: Vec3,
        estimate: Estimate,
        home: Vec3,
    ) -> Vec3:
        vn, ve, _ = self._go_to(over, HOLD_MPS, estimate)
        high = home[2] - estimate.position_n_m[2] > LOW_M
        return vn, ve, self._config.land_mps if high else self._config.touchdown_mps

    def _return(self, estimate: Estimate, home: Vec3) -> Vec3:
        config, (north, east, down) = self._config, estimate.position_n_m
        if self._return_phase is ReturnPhase.CLIMB:
            goal_down = home[2] - config.return_height_m
            if down > goal_down + AT_HEIGHT_M:
                return self._go_to((self._hold[0], self._hold[1], goal_down), HOLD_MPS, estimate)
            self._return_phase = ReturnPhase.CRUISE
            self._hold = (north, east, down)
        if self._return_phase is ReturnPhase.CRUISE:
            if math.hypot(home[0] - north, home[1] - east) > AT_HOME_M:
                return self._go_to((home[0], home[1], self._hold[2]), config.return_mps, estimate)
            self._return_phase = ReturnPhase.DESCEND
        return self._descend(home, estimate, home)
