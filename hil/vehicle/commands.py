"""What a vehicle does when it is commanded, as PX4 does it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from hil.autopilot.autopilot import Ack, Severity
from hil.vehicle.answers import height_above_sea_m, place_asked
from hil.vehicle.messages import AUTO, AUTO_MODES, OFFBOARD, PILOT_MODES, FlightInstant
from hil.vehicle.parameters import Parameters

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
NOT_NOW = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
FORCE_MAGIC = 21196.0


class Commands:
    """The commands that move a vehicle or change its mode. Each returns a MAV_RESULT."""

    def __init__(self, parameters: Parameters, tangent: LocalTangent) -> None:
        self._parameters = parameters
        self._tangent = tangent
        self._known: dict[int, Callable[[FlightInstant, Any], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda flight, _: request(flight, FlightMode.LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda flight, _: request(
                flight, FlightMode.RETURN
            ),
            mavlink.MAV_CMD_DO_SET_MODE: self._set_mode,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
        }

    def obey(self, flight: FlightInstant, message: Any) -> int:
        """Do what a command says; UNSUPPORTED for what is none of these."""
        known = self._known.get(message.command)
        return UNSUPPORTED if known is None else known(flight, message)

    def _arm(self, flight: FlightInstant, message: Any) -> int:
        arm = whole(message.param1)
        if arm not in (0, 1):
            return DENIED
        return _not_now(
            flight.autopilot.request_arm(flight.now_s, arm == 1, message.param2 == FORCE_MAGIC)
        )

    def _take_off(self, flight: FlightInstant, message: Any) -> int:
        """Take off. Without an altitude the height is MIS_TAKEOFF_ALT over home."""
        home = flight.autopilot.home_n_m
        altitude_m = height_above_sea_m(message)
        if altitude_m is None:
            return DENIED
        height_m = self._parameters.take_off_m(flight.now_s)
        if home is not None and math.isfinite(altitude_m):
            asked_m = (
                altitude_m - flight.autopilot.altitude_error_m - self._tangent.to_global(*home)[2]
            )
            if asked_m > 0.0:
                height_m = asked_m
            else:  # a height above home where PX4 wants one above the sea: it goes as high as usual
                flight.autopilot.say(
                    flight.now_s,
                    Severity.CRITICAL,
                    f"Using minimum takeoff altitude: {height_m:.2f} m",
                )
        return _result(flight.autopilot.request_takeoff(flight.now_s, height_m))

    def _reposition(self, flight: FlightInstant, message: Any) -> int:
        """Go to a place and hold there, as PX4 does in AUTO.LOITER."""
        asked = place_asked(message)
        home = flight.autopilot.home_n_m
        if asked is None or home is None:
            return DENIED
        latitude_deg, longitude_deg, altitude_m, above_home = asked
        if not all(map(math.isfinite, (latitude_deg, longitude_deg))):
            return DENIED
        above_sea_m = altitude_m - flight.autopilot.altitude_error_m
        if above_home:
            above_sea_m = altitude_m + self._tangent.to_global(*home)[2]
        north_m, east_m, down_m = self._tangent.to_ned(latitude_deg, longitude_deg, above_sea_m)
        if not math.isfinite(altitude_m):
            down_m = flight.estimate.position_n_m[2]
        goal = north_m, east_m, down_m
        return _not_now(flight.autopilot.request_reposition(flight.now_s, goal))

    def _set_mode(self, flight: FlightInstant, message: Any) -> int:
        return self.select(flight, whole(message.param2), whole(message.param3))

    def select(self, flight: FlightInstant, main: int | None, sub: int | None) -> int:
        """Change to PX4's mode of these numbers."""
        if main in PILOT_MODES:
            return request(flight, FlightMode.OTHER, by_pilot=True)
        if main == OFFBOARD:
            return request(flight, FlightMode.OFFBOARD)
        if main == AUTO and sub in AUTO_MODES:
            if AUTO_MODES[sub] is FlightMode.TAKEOFF:
                return _result(
                    flight.autopilot.request_takeoff(
                        flight.now_s, self._parameters.take_off_m(flight.now_s)
                    )
                )
            return request(flight, AUTO_MODES[sub])
        return DENIED


def request(flight: FlightInstant, mode: FlightMode, by_pilot: bool = False) -> int:
    """Ask the autopilot for a mode."""
    return _not_now(flight.autopilot.request_mode(flight.now_s, mode, by_pilot))


def whole(value: float) -> int | None:
    """Return a command parameter that stands for a whole number; None for NaN and infinities."""
    return int(value) if math.isfinite(value) else None


def _result(ack: Ack) -> int:
    return ACCEPTED if ack.accepted else DENIED


def _not_now(ack: Ack) -> int:
    """Return PX4's answer to what it would do another time: arming, disarming, a mode."""
    return ACCEPTED if ack.accepted else NOT_NOW
