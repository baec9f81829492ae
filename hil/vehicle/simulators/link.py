"""The harness's own MAVLink connection to a simulated autopilot: what is true there, and whether it
is ready to fly.

PX4 (SIH) tells the truth in HIL_STATE_QUATERNION; ArduPilot in SIM_STATE and, for its position,
SIMSTATE (SIM_STATE has whole degrees in single precision, and its 1e-7 degrees only in newer
versions). No heartbeat is ever sent here: an autopilot must not take the harness for its companion.
A flight controller on the bench, which simulates on board, is spoken to in the same way over a
serial port.
"""

from __future__ import annotations

import contextlib
import math
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.modes import CUSTOM_MODE_ENABLED, KINDS
from hil.autopilot.simulator import Kind
from hil.vehicle.arrival import Address
from hil.vehicle.simulators.relay import DO_SET_MODE, PILOT_MODE, FlightWatch
from hil.vehicle.simulators.truth_follower import Fix, TrueMotion, TruthFollower
from hil.vehicle.simulators.wire import open_wire
from path.messages import Vec3

OWN_SYSID = 250
OWN_COMPONENT = 191
AUTOPILOT = 1
TRUTH_HZ = 100.0
SLOW_HZ = 2.0
MODE_HZ = 20.0
ASK_AGAIN_S = 1.0
PREARM_CHECK = mavlink.MAV_SYS_STATUS_PREARM_CHECK

TRUTH: dict[Kind, tuple[int, ...]] = {
    "px4": (mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,),
    "ardupilot": (mavlink.MAVLINK_MSG_ID_SIM_STATE, mavlink.MAVLINK_MSG_ID_SIMSTATE),
}
READINESS = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_STATUSTEXT,
)


class SimulatorLink:
    """Bound to a port the simulator sends to, or connected to nothing until it does. Read it with
    ``receive``.
    """

    def __init__(
        self,
        kind: Kind,
        sysid: int,
        port: Address | str,
        tangent: LocalTangent,
        follower: TruthFollower,
        placed_later: bool = False,
    ) -> None:
        """Raise OSError, PartError when the port is taken.

        ``port``: where it listens, or the URL of a serial port. ``placed_later``: only the
        mission's own parts tell it where it is, so that it cannot be ready before.
        """
        self._placed_later = placed_later
        self._readiness = (
            (mavlink.MAVLINK_MSG_ID_ATTITUDE, *READINESS) if placed_later else READINESS
        )
        self._kind: Kind = kind
        self._sysid = sysid
        self._tangent = tangent
        self.follower = follower
        self.wire = open_wire(port)
        self.watch = FlightWatch(next(known for known in KINDS if known.name == kind))
        self.epoch_s = 0.0  # of the world's clock, for ``watch``
        self._mav: Any = mavlink.MAVLink(None, srcSystem=OWN_SYSID, srcComponent=OWN_COMPONENT)
        self._radio_mav: Any = mavlink.MAVLink(
            None,
            srcSystem=OWN_SYSID,
            srcComponent=OWN_COMPONENT,
        )
        self._asked_s = -math.inf
        self._heard: dict[int, float] = {}
        self.armable = False
        self.battery = 1.0  # what it says is left, 0..1
        self.texts: list[str] = []
        self.parameters: dict[str, float] = {}

    def fileno(self) -> int:
        return self.wire.fileno()

    def close(self) -> None:
        self.wire.close()

    @property
    def missing(self) -> list[str]:
        """Return what it still lacks before a mission may start; empty when it is ready."""
        wanted = {
            "heartbeat": mavlink.MAVLINK_MSG_ID_HEARTBEAT,
            "local position": mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            "global position": mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
            "home position": mavlink.MAVLINK_MSG_ID_HOME_POSITION,
        }
        # the port its truth comes from carries nothing else by itself, heartbeats included
        if self._kind == "px4":
            wanted.pop("heartbeat")
        if self._placed_later:
            wanted = {"attitude": mavlink.MAVLINK_MSG_ID_ATTITUDE}
        missing = [what for what, message in wanted.items() if message not in self._heard]
        missing += [] if self.armable or self._placed_later else ["arming checks"]
        return missing + ([] if self.follower.ready else ["truth"])

    def receive(self) -> None:
        """Take all that came in. Times are of the monotonic clock."""
        for message_id, sysid, frame, arrival_s in self.wire.read():
            if sysid != self._sysid or message_id not in mavlink.mavlink_map:
                continue
            with contextlib.suppress(mavlink.MAVError):
                self._take(self._mav.decode(bytearray(frame)), arrival_s)

    def ask(self, now_s: float) -> None:
        """Ask for the streams that do not come, once a second: requests are lost while it
        starts.
        """
        if not self.wire.met or now_s - self._asked_s < ASK_AGAIN_S:
            return
        self._asked_s = now_s
        for message in TRUTH[self._kind]:
            if now_s - self._heard.get(message, -math.inf) > ASK_AGAIN_S or self._slow(message):
                self._want(message, TRUTH_HZ)
        if self._kind == "px4" and mavlink.MAVLINK_MSG_ID_CURRENT_MODE not in self._heard:
            self._want(mavlink.MAVLINK_MSG_ID_CURRENT_MODE, MODE_HZ)
        for message in self._readiness:
            if now_s - self._heard.get(message, -math.inf) > 2.0 * ASK_AGAIN_S:
                self._want(message, SLOW_HZ)

    def sag_battery(self, fraction: float) -> None:
        """Leave this much of the charge, 0..1; PX4's simulated battery gets there within a
        second.
        """
        if self._kind == "px4":
            self.set_parameter("SIM_BAT_DRAIN", 1.0)
            self.set_parameter("SIM_BAT_MIN_PCT", 100.0 * fraction)
        else:
            self._command(mavlink.MAV_CMD_BATTERY_RESET, 1.0, 100.0 * fraction)

    def pilot_takes_over(self) -> None:
        """Change the mode as a second ground station."""
        self._command(DO_SET_MODE, float(CUSTOM_MODE_ENABLED), *PILOT_MODE[self._kind])

    def set_parameter(self, name: str, value: float) -> None:
        """Ask for a change of a float parameter; ``parameters`` has it when it was made."""
        self._send(
            mavlink.MAVLink_param_set_message(
                self._sysid,
                AUTOPILOT,
                name.encode(),
                value,
                mavlink.MAV_PARAM_TYPE_REAL32,
            )
        )

    def send_channels(self, channels: tuple[int, ...]) -> None:
        """Send pulse widths in µs of channels 1 to 8, as of a receiver on board. Another thread
        may do so.
        """
        message: Any = mavlink.MAVLink_rc_channels_override_message(
            self._sysid,
            AUTOPILOT,
            *channels,
        )
        self.wire.write(message.pack(self._radio_mav))

    # --- inside ---

    def _slow(self, message: int) -> bool:
        """PX4 sends the truth by itself, at 25 Hz: asked for again until the first second has gone
        by.
        """
        return message == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION and not self.armable

    def _want(self, message: int, rate_hz: float) -> None:
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, float(message), 1e6 / rate_hz)

    def _command(self, command: int, *params: float) -> None:
        filled = [*params, *([0.0] * (7 - len(params)))]
        self._send(
            mavlink.MAVLink_command_long_message(self._sysid, AUTOPILOT, command, 0, *filled)
        )

    def _send(self, message: Any) -> None:
        self.wire.write(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def _take(self, message: Any, time_s: float) -> None:
        self._heard[message.get_msgId()] = time_s
        match message.get_type():
            case "HIL_STATE_QUATERNION":
                self._on_px4_truth(message, time_s)
            case "SIM_STATE":
                self._on_sim_state(message, time_s)
            case "SIMSTATE":
                north, east, _ = self._tangent.to_ned(message.lat * 1e-7, message.lng * 1e-7, 0.0)
                self.follower.on_fix(Fix(time_s, (north, east, math.nan)))
            case "HEARTBEAT" if message.get_srcComponent() == AUTOPILOT:
                self.watch.on_heartbeat(
                    time_s - self.epoch_s,
                    message.custom_mode,
                    message.base_mode,
                )
            case "CURRENT_MODE":
                self.watch.on_mode(time_s - self.epoch_s, message.custom_mode)
            case "SYS_STATUS":
                self.armable = bool(message.onboard_control_sensors_health & PREARM_CHECK)
                if message.battery_remaining >= 0:
                    self.battery = message.battery_remaining / 100.0
            case "STATUSTEXT":
                self.texts.append(str(message.text))
            case "PARAM_VALUE":
                self.parameters[str(message.param_id)] = float(message.param_value)
            case "GLOBAL_POSITION_INT" if message.lat == 0 and message.lon == 0:
                self._heard.pop(message.get_msgId())  # sent before there is a position
            case _:
                pass

    def _on_px4_truth(self, message: Any, time_s: float) -> None:
        """Its whole numbers are cut off towards zero, not rounded: half a unit is given back."""
        velocity: Vec3 = (
            _middle(message.vx) * 1e-2,
            _middle(message.vy) * 1e-2,
            _middle(message.vz) * 1e-2,
        )
        w, x, y, z = message.attitude_quaternion
        rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
        self.follower.on_motion(TrueMotion(time_s, velocity, (w, x, y, z), rates))
        latitude, longitude, altitude = (
            _middle(value) for value in (message.lat, message.lon, message.alt)
        )
        place = self._tangent.to_ned(latitude * 1e-7, longitude * 1e-7, altitude * 1e-3)
        self.follower.on_fix(Fix(time_s, place))

    def _on_sim_state(self, message: Any, time_s: float) -> None:
        rates = (message.xgyro, message.ygyro, message.zgyro)
        attitude = (message.q1, message.q2, message.q3, message.q4)
        self.follower.on_motion(
            TrueMotion(time_s, (message.vn, message.ve, message.vd), attitude, rates)
        )
        _, _, down = self._tangent.to_ned(0.0, 0.0, message.alt)
        self.follower.on_fix(Fix(time_s, (math.nan, math.nan, down)))


def _middle(whole: int) -> float:
    return whole + math.copysign(0.5, whole) if whole else 0.0
