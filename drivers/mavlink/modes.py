"""Flight modes as PX4 and ArduPilot number them in HEARTBEAT.custom_mode and
MAV_CMD_DO_SET_MODE.
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.interfaces import SURE, FlightMode
from path.values import frozen

# HEARTBEAT.base_mode (MAV_MODE_FLAG).
CUSTOM_MODE_ENABLED = 1
SAFETY_ARMED = 128
# HEARTBEAT.system_status (MAV_STATE): so PX4 shows a pilot's kill switch, and calls itself armed
# for 5 s more.
FLIGHT_TERMINATION = 8
# "RC7: MotorEStop HIGH"
ESTOP = "MotorEStop"
STOPPED = "HIGH"


def powered(base_mode: int, system_status: int) -> bool:
    """Return whether a heartbeat says that the motors may turn: armed, and not stopped by a kill
    switch.
    """
    return bool(base_mode & SAFETY_ARMED) and system_status != FLIGHT_TERMINATION


def stopped_by(text: str, before: bool) -> bool:
    """Return whether a pilot's switch has stopped the motors, after a text; ``before``: whether it
    had before it.

    ArduCopter calls itself armed, and in GUIDED, for 5 s more. It tells of its Motor Emergency Stop
    by a text alone, whichever channel that is on.
    """
    return text.endswith(STOPPED) if ESTOP in text else before


@frozen
class AutopilotKind:
    """The differences on the wire between the two autopilots.

    Attributes:
        name: as written in rigs.
        mav_autopilot: HEARTBEAT.autopilot (MAV_AUTOPILOT).
        modes: custom_mode of each mode the missions use; what is not here is ``FlightMode.OTHER``.
        set_mode: param2 and param3 of MAV_CMD_DO_SET_MODE for the modes a mission asks for.
        unset: what an unused command parameter is sent as; None is NaN on the wire.
    """

    name: str
    mav_autopilot: int
    modes: Mapping[int, FlightMode]
    set_mode: Mapping[FlightMode, tuple[int, int]]
    unset: float | None

    def mode(self, custom_mode: int) -> FlightMode:
        return self.modes.get(custom_mode, FlightMode.OTHER)

    def news(
        self,
        custom_mode: int,
        before: FlightMode,
        told: int,
    ) -> bool:
        """Return whether a CURRENT_MODE is believed before a heartbeat says the same.

        OFFBOARD is only against a pilot's mode that one message alone has told: having landed, PX4
        goes back to it before it says that it is disarmed.
        """
        one_alone = before is FlightMode.OTHER and told < SURE
        return self.mode(custom_mode) is not FlightMode.OFFBOARD or one_alone


def px4_custom_mode(main: int, sub: int) -> int:
    """PX4's custom_mode: main mode in bits 16-23, sub mode in bits 24-31 (px4_custom_mode.h)."""
    return main << 16 | sub << 24


PX4 = AutopilotKind(
    name="px4",
    mav_autopilot=12,
    modes={
        px4_custom_mode(4, 2): FlightMode.TAKEOFF,
        px4_custom_mode(4, 3): FlightMode.HOLD,
        px4_custom_mode(4, 5): FlightMode.RETURN,
        px4_custom_mode(4, 6): FlightMode.LAND,
        px4_custom_mode(6, 0): FlightMode.OFFBOARD,
    },
    set_mode={FlightMode.HOLD: (4, 3), FlightMode.OFFBOARD: (6, 0)},
    unset=None,
)

# GUIDED is both where a take-off is commanded and where setpoints are flown, so a take-off shows as
# OFFBOARD. BRAKE is the hold that needs no sticks; LOITER is a pilot's mode.
ARDUPILOT = AutopilotKind(
    name="ardupilot",
    mav_autopilot=3,
    modes={
        4: FlightMode.OFFBOARD,
        6: FlightMode.RETURN,
        9: FlightMode.LAND,
        17: FlightMode.HOLD,
    },
    set_mode={FlightMode.HOLD: (17, 0), FlightMode.OFFBOARD: (4, 0)},
    unset=0.0,
)

KINDS = (PX4, ARDUPILOT)
