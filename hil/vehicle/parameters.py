"""The parameters of the embedded vehicle: few, and each of them true."""

from __future__ import annotations

import struct
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from hil.autopilot.autopilot import AutopilotConfig

REAL32, INT32 = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT32
TAKE_OFF = "MIS_TAKEOFF_ALT"


class Parameters:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET.

    Only MIS_TAKEOFF_ALT can be set; the others say how the autopilot is, and a PARAM_SET is answered with the old
    value, as PX4 answers one it does not take.
    """

    def __init__(self, config: AutopilotConfig) -> None:
        self._values: dict[str, float | int] = {
            TAKE_OFF: config.default_takeoff_m,
            "COM_OF_LOSS_T": config.offboard_loss_s,
            "COM_OBL_RC_ACT": 4,  # land
            "COM_RC_IN_MODE": 4,  # no remote control
            "COM_DISARM_LAND": config.land_disarm_s,
            "COM_DISARM_PRFLT": config.idle_disarm_s,
            "MPC_XY_VEL_MAX": config.max_horizontal_mps,
            "MPC_Z_VEL_MAX_UP": config.max_up_mps,
            "MPC_Z_VEL_MAX_DN": config.max_down_mps,
            "RTL_RETURN_ALT": config.return_height_m,
        }
        self._highest_m = config.max_height_m

    @property
    def take_off_m(self) -> float:
        return float(self._values[TAKE_OFF])

    def answer(self, message: Any) -> list[Any]:
        kind = message.get_type()
        names = list(self._values)
        if kind == "PARAM_REQUEST_LIST":
            return [self._message(name) for name in names]
        if kind == "PARAM_REQUEST_READ" and 0 <= message.param_index < len(names):
            return [self._message(names[message.param_index])]
        if kind not in ("PARAM_REQUEST_READ", "PARAM_SET") or message.param_id not in self._values:
            return []
        if kind == "PARAM_SET":
            self._set(message.param_id, message.param_type, message.param_value)
        return [self._message(message.param_id)]

    def _set(self, name: str, kind: int, value: float) -> None:
        if name == TAKE_OFF and kind == REAL32 and 0.0 < value <= self._highest_m:
            self._values[name] = value

    def _message(self, name: str) -> Any:
        value = self._values[name]
        whole = isinstance(value, int)
        # An integer travels in the bytes of the float, as PX4 sends it.
        wire = struct.unpack("<f", struct.pack("<i", value))[0] if whole else value
        index, count = list(self._values).index(name), len(self._values)
        return mavlink.MAVLink_param_value_message(name.encode(), wire, INT32 if whole else REAL32, count, index)
