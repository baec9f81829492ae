"""Which of a vehicle's batteries flies it, and how full it is. One rule for the script's link and
for the guard's.

A vehicle tells BATTERY_STATUS of each battery by its id, those of a payload or a companion computer
among them, and SYS_STATUS of "the" battery, which on PX4 is the emptiest of all. MAVSDK hands on
whichever came last. A percentage that the autopilot does not know is -1, or 255 where it is read as
unsigned: unknown is not empty.
"""

from __future__ import annotations

import math

LOWEST_ID = -1  # of a rig that does not say which battery flies
_NOT_FOR_FLIGHT = (3, 4)  # MAV_BATTERY_FUNCTION: avionics, payload


class FlightBattery:
    """The flight's battery as the newest messages tell it.

    Attributes:
        level: 0..1, the newest that was told; NaN before the first.
        told_ns: when it was told last, on the listener's clock; before that, when the vehicle was
            first heard.
    """

    def __init__(self, wanted_id: int = LOWEST_ID) -> None:
        """``wanted_id``: as the rig says; else the lowest id of those that do not say they serve
        something else.
        """
        self._wanted_id = wanted_id
        self._heard: set[int] = set()  # ids that may fly it
        self._silent: set[int] = set()  # of these, the ids whose newest message tells no percentage
        self._flying_id: int | None = None
        self._by_status = False  # a BATTERY_STATUS has told the level: SYS_STATUS says nothing more
        self.level = math.nan
        self.told_ns: int | None = None

    def hear(self, now_ns: int) -> None:
        """Note that the vehicle is heard: from now on it could tell."""
        if self.told_ns is None:
            self.told_ns = now_ns

    def on_battery(
        self,
        battery_id: int,
        function: int,
        percent: float,
        now_ns: int,
    ) -> None:
        """Take a BATTERY_STATUS. ``percent``: beyond 0..100 the autopilot does not know it."""
        self.hear(now_ns)
        if self._wanted_id == LOWEST_ID and function in _NOT_FOR_FLIGHT:
            return
        self._heard.add(battery_id)
        flying_id = min(self._heard) if self._wanted_id == LOWEST_ID else self._wanted_id
        if battery_id != flying_id:
            return
        if flying_id != self._flying_id:
            self._flying_id = flying_id
            self._forget(now_ns)
        if _known(percent):
            self._silent.discard(battery_id)
            self._by_status = True
            self._tell(percent, now_ns)
        else:
            self._silent.add(battery_id)

    def on_sys_status(self, percent: float, now_ns: int) -> None:
        """Take a SYS_STATUS: believed as long as no BATTERY_STATUS tells more, and there is but one
        battery.
        """
        self.hear(now_ns)
        one_battery = self._wanted_id == LOWEST_ID and len(self._heard) <= 1
        if one_battery and not self._by_status and _known(percent):
            self._tell(percent, now_ns)

    @property
    def heard(self) -> bool:
        """Whether a BATTERY_STATUS of a battery that may fly it ever came."""
        return bool(self._heard)

    @property
    def known(self) -> bool:
        """Whether its level was ever told."""
        return math.isfinite(self.level)

    @property
    def trouble(self) -> str:
        """Why no level is known, in words for the crew; empty when it is."""
        if self.known:
            return ""
        if self._wanted_id != LOWEST_ID and self._wanted_id not in self._heard:
            others = ", ".join(str(each) for each in sorted(self._heard)) or "none"
            return f"level of battery {self._wanted_id}, which battery_id names: it tells only of {others}"
        if self._silent:
            number = min(self._silent)
            return f"level of battery {number}: it tells no percentage (PX4: BAT1_CAPACITY, ArduPilot: BATT_CAPACITY)"
        return "battery level"

    def _tell(self, percent: float, now_ns: int) -> None:
        self.level = percent / 100.0
        self.told_ns = now_ns

    def _forget(self, now_ns: int) -> None:
        """What another battery told, or SYS_STATUS, is not this one's."""
        if self._by_status:
            self.level = math.nan
            self.told_ns = now_ns


def _known(percent: float) -> bool:
    return math.isfinite(percent) and 0.0 <= percent <= 100.0
