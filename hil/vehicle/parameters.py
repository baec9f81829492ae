"""The parameters of the embedded vehicle: each is what its autopilot goes by, so that what is set
takes effect.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from hil.autopilot.autopilot import Autopilot
from path.bounds import Bounds, bounded_fields

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
INT32 = mavlink.MAV_PARAM_TYPE_INT32
TAKE_OFF = "MIS_TAKEOFF_ALT"
# PX4's navigator looks at its parameters once a second at most: what was set just before is not
# flown
LOOKS_S = 1.0
FIXED: Mapping[str, int] = {"COM_OBL_RC_ACT": 4, "NAV_DLL_ACT": 0, "COM_LOW_BAT_ACT": 2}
"""Its fixed behaviour: it lands when setpoints stop, does not mind a ground station that leaves,
and lands with an empty battery."""

FIELDS: Mapping[str, str] = {
    TAKE_OFF: "default_takeoff_m",
    "COM_OF_LOSS_T": "offboard_loss_s",
    "COM_DISARM_LAND": "land_disarm_s",
    "COM_DISARM_PRFLT": "idle_disarm_s",
    "MPC_XY_VEL_MAX": "max_horizontal_mps",
    "MPC_Z_VEL_MAX_UP": "max_up_mps",
    "MPC_Z_VEL_MAX_DN": "max_down_mps",
    "RTL_RETURN_ALT": "return_height_m",
    "COM_RC_IN_MODE": "radio.in_mode",
    "COM_RC_OVERRIDE": "radio.override",
    "COM_RC_LOSS_T": "radio.loss_s",
    "COM_RCL_EXCEPT": "radio.loss_except",
    "NAV_RCL_ACT": "radio.loss_act",
    "COM_FAIL_ACT_T": "radio.act_after_s",
    "COM_KILL_DISARM": "radio.kill_disarm_s",
    "RC_MAP_FLTMODE": "radio.mode_channel",
    "RC_MAP_KILL_SW": "radio.kill_channel",
    "GF_ACTION": "fence.action",
    "GF_MAX_HOR_DIST": "fence.radius_m",
    "GF_MAX_VER_DIST": "fence.height_m",
}
"""PX4's names, and the fields of ``AutopilotConfig`` behind them."""


class Parameters:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET.

    A PARAM_SET that is out of bounds, of another type, or of what cannot be set, is answered with
    the old value, as PX4 answers one that it does not take.
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._names = (*FIELDS, *FIXED)
        self._take_off_m = autopilot.config.default_takeoff_m
        self._looked_s = -math.inf
        self._changed_s: float | None = None  # something, that was not looked at yet

    def take_off_m(self, now_s: float) -> float:
        """The height that a take-off without one climbs to."""
        self._look(now_s)
        return self._take_off_m

    def _look(self, now_s: float) -> None:
        if self._changed_s is not None and now_s >= (
            due_s := max(self._changed_s, self._looked_s + LOOKS_S)
        ):
            self._looked_s = due_s
            self._changed_s = None
            self._take_off_m = self._autopilot.config.default_takeoff_m

    def answer(self, message: Any, now_s: float) -> list[Any]:
        self._look(now_s)
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self._message(name) for name in self._names]
        if kind == "PARAM_REQUEST_READ" and 0 <= message.param_index < len(self._names):
            return [self._message(self._names[message.param_index])]
        if kind not in ("PARAM_REQUEST_READ", "PARAM_SET") or message.param_id not in self._names:
            return []
        if kind == "PARAM_SET":
            self._set(message.param_id, message.param_type, message.param_value)
            self._changed_s = now_s if self._changed_s is None else self._changed_s
        return [self._message(message.param_id)]

    def _table(self, name: str) -> tuple[Any, str]:
        """The dataclass that holds a parameter, and its field there."""
        table, _, inner = FIELDS[name].rpartition(".")
        config = self._autopilot.config
        return (getattr(config, table) if table else config), inner

    def _value(self, name: str) -> float | int:
        if name in FIXED:
            return FIXED[name]
        table, inner = self._table(name)
        return getattr(table, inner)

    def _set(
        self,
        name: str,
        kind: int,
        value: float,
    ) -> None:
        if name not in FIELDS:
            return
        table, inner = self._table(name)
        whole = isinstance(getattr(table, inner), int)
        if kind != (INT32 if whole else REAL32):
            return
        wanted: float | int = struct.unpack("<i", struct.pack("<f", value))[0] if whole else value
        bounds: Bounds = bounded_fields(type(table))[inner][1]
        if not bounds.holds(wanted) or (
            name == TAKE_OFF and not 0.0 < wanted <= self._autopilot.config.max_height_m
        ):
            return
        changed = replace(table, **{inner: wanted})
        config = self._autopilot.config
        outer = FIELDS[name].rpartition(".")[0]
        self._autopilot.config = replace(config, **{outer: changed}) if outer else changed

    def _message(self, name: str) -> Any:
        value = self._value(name)
        whole = isinstance(value, int)
        # An integer travels in the bytes of the float, as PX4 sends it.
        wire = (
            struct.unpack("<f", struct.pack("<i", value))[0] if whole else min(float(value), 3.4e38)
        )
        assert not math.isnan(wire) or whole
        index = self._names.index(name)
        count = len(self._names)
        return mavlink.MAVLink_param_value_message(
            name.encode(),
            wire,
            INT32 if whole else REAL32,
            count,
            index,
        )
