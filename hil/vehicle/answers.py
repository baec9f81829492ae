"""The embedded vehicle's answers to what is no command: missions, logs, pings; sticks; and to whom
at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from hil.autopilot.radio import CHANNELS, MIDDLE_US, UNCHANGED

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_GLOBAL_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_HOME_FRAMES = (
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)

OLDER_REQUESTS: Mapping[int, int] = {
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
}
"""Commands of before MAV_CMD_REQUEST_MESSAGE, and the message that is asked for."""

STICKS = ("RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL")
NOT_FOLLOWED = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
"""Setpoints that are not followed, and have no answer of their own: a status text says so."""


def is_meant(message: Any, sysid: int) -> bool:
    """Return whether a message is for this vehicle's autopilot, as PX4 sees it.

    Commands name their system, but for the one that asks for a message: that is answered whoever is
    asked.
    """
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    kind = message.get_type()
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return system in (0, sysid)
        return system == sysid and component in (0, AUTOPILOT)
    if kind in ("SET_MODE", "MANUAL_CONTROL"):
        return sysid == (message.target if kind == "MANUAL_CONTROL" else system)
    return system in (0, sysid) and component in (0, AUTOPILOT)


def answer(message: Any) -> Any | None:
    """The answer to a request for what this vehicle has none of; None: silence."""
    make = _ANSWERS.get(message.get_type())
    return None if make is None else make(message)


def height_above_sea_m(message: Any) -> float | None:
    """The altitude that a take-off asks for, NaN for none; None: in a frame that is not
    understood.
    """
    if message.get_type() == "COMMAND_LONG":
        return float(message.param7)
    return float(message.z) if message.frame in _GLOBAL_FRAMES else None


def place_asked(message: Any) -> tuple[float, float, float, bool] | None:
    """Where DO_REPOSITION asks a vehicle to go: degrees north and east, metres, NaN for as it is, and
    whether those are above home; None: in a frame that is not understood.
    """
    if message.get_type() == "COMMAND_LONG":
        return message.param5, message.param6, message.param7, False
    if message.frame not in (*_GLOBAL_FRAMES, *_HOME_FRAMES):
        return None
    above_home = message.frame in _HOME_FRAMES
    return message.x * 1e-7, message.y * 1e-7, message.z, above_home


def sticks_of(message: Any) -> list[int]:
    """A ground station's channels, µs; of a MANUAL_CONTROL those of a joystick's sticks, and no
    switches.
    """
    if message.get_type() == "RC_CHANNELS_OVERRIDE":
        return [getattr(message, f"chan{number}_raw") for number in range(1, CHANNELS + 1)]
    throttle = 2.0 * message.z / 1000.0 - 1.0  # its middle is 500
    sticks = (message.y / 1000.0, message.x / 1000.0, throttle, message.r / 1000.0)
    moved = [round(MIDDLE_US + 500.0 * max(-1.0, min(1.0, stick))) for stick in sticks]
    return moved + [UNCHANGED] * (CHANNELS - len(moved))


def _from(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _no_items(asked: Any) -> Any:
    return mavlink.MAVLink_mission_count_message(*_from(asked), 0, asked.mission_type)


def _items_offered(asked: Any) -> Any:
    """None at all is an upload that clears what there is; there is room for none."""
    result = mavlink.MAV_MISSION_UNSUPPORTED if asked.count else mavlink.MAV_MISSION_ACCEPTED
    return mavlink.MAVLink_mission_ack_message(*_from(asked), result, asked.mission_type)


def _cleared(asked: Any) -> Any:
    return mavlink.MAVLink_mission_ack_message(
        *_from(asked),
        mavlink.MAV_MISSION_ACCEPTED,
        asked.mission_type,
    )


def _no_logs(_asked: Any) -> Any:
    return mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0)


def _ping(asked: Any) -> Any | None:
    if asked.target_system or asked.target_component:
        return None  # an answer to somebody's
    return mavlink.MAVLink_ping_message(asked.time_usec, asked.seq, *_from(asked))


_ANSWERS: Mapping[str, Callable[[Any], Any | None]] = {
    "MISSION_REQUEST_LIST": _no_items,
    "MISSION_COUNT": _items_offered,
    "MISSION_CLEAR_ALL": _cleared,
    "LOG_REQUEST_LIST": _no_logs,
    "PING": _ping,
}
"""It has no mission, fence points, rally points or logs, and takes none; a ground station waits for
answers yet.
"""
