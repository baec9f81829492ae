"""The velocity that a setpoint on the wire asks for, as PX4 has it."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import VelocitySetpoint
from hil.vehicle.messages import FlightInstant
from path.geometry.rotation import wrapped, yaw_of

FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED)
"""Of setpoints that are followed."""
# POSITION_TARGET_TYPEMASK
IGNORE_POSITION = 0b111
IGNORE_VELOCITY = 0b111000
IGNORE_YAW = 1 << 10
IGNORE_YAW_RATE = 1 << 11
TURN_LEAD_RAD = 0.5  # how far ahead of the nose a rate commands the heading, at most
TURN_PAUSE_S = 0.5  # after so long without one a rate begins from the heading as it is


class Setpoints:
    """One vehicle's setpoints: a rate of turn goes on from where the one before it had led to."""

    def __init__(self) -> None:
        self._turning = 0.0, -math.inf  # heading that a rate has led to, and when

    def read(self, flight: FlightInstant, message: Any) -> VelocitySetpoint | None:
        """Return what a SET_POSITION_TARGET_LOCAL_NED asks for; None for neither velocity nor
        place.

        Velocity, position by a proportional loop, or both, in MAV_FRAME_LOCAL_NED. In
        MAV_FRAME_BODY_NED velocity alone, ahead, right and down of the heading.
        """
        mask = message.type_mask
        own = message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED
        by_velocity = not mask & IGNORE_VELOCITY
        by_position = not own and not mask & IGNORE_POSITION
        if not (by_velocity or by_position):
            return None
        north, east, down = (message.vx, message.vy, message.vz) if by_velocity else (0.0, 0.0, 0.0)
        if own:
            heading = yaw_of(flight.estimate.q_n_b)
            c = math.cos(heading)
            s = math.sin(heading)
            north, east = c * north - s * east, s * north + c * east
        if by_position:
            gain_hz, (n, e, d) = flight.autopilot.config.hold_gain_hz, flight.local_n_m
            north += gain_hz * (message.x - n)
            east += gain_hz * (message.y - e)
            down += gain_hz * (message.z - d)
        return VelocitySetpoint((north, east, down), self._yaw(flight, message))

    def _yaw(self, flight: FlightInstant, message: Any) -> float:
        """The heading that a setpoint asks for: itself, by a rate from the one before, or as it
        is.
        """
        mask = message.type_mask
        yaw = yaw_of(flight.estimate.q_n_b)
        if not mask & IGNORE_YAW:
            return message.yaw
        if mask & IGNORE_YAW_RATE or not math.isfinite(message.yaw_rate):
            return yaw
        goal, since_s = self._turning
        passed_s = flight.now_s - since_s
        ahead = (
            wrapped(goal + message.yaw_rate * passed_s - yaw) if passed_s < TURN_PAUSE_S else 0.0
        )
        goal = yaw + max(-TURN_LEAD_RAD, min(TURN_LEAD_RAD, ahead))
        self._turning = goal, flight.now_s
        return goal
