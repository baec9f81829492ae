"""The newest of everything a vehicle says, kept by MAVSDK's callback thread and read by the role's
event loop.

Each slot is one immutable value, replaced whole, so that a reader needs no lock and never sees half
an update.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

from drivers.arrivals import Arrivals
from drivers.interfaces import Clock, FlightMode, VehicleError, VehicleState
from drivers.mavlink.battery import LOWEST_ID, FlightBattery
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.modes import PX4, SAFETY_ARMED, AutopilotKind, powered, stopped_by
from drivers.mavlink.rangefinder import Rangefinder
from drivers.perception.history import StateHistory
from path.values import frozen

Vec3 = tuple[float, float, float]
NAN3: Vec3 = (math.nan, math.nan, math.nan)
RC_RECEIVER = 65536  # MAV_SYS_STATUS_SENSOR_RC_RECEIVER
AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
KEPT_TEXTS = 50
UNDISTURBED_NS = 100_000  # two readings this close had no other thread between them


@frozen
class Heartbeat:
    arrival_ns: int
    autopilot: int
    armed: bool  # and not stopped by a kill switch
    told: int = 1  # how many in a row have said the same of arming
    disarmed: bool = False  # which a vehicle whose motors a pilot has stopped in the air is not


@frozen
class ReportedMode:
    """The mode as a heartbeat says it, or CURRENT_MODE: PX4 beats once a second whatever it is
    asked for.
    """

    arrival_ns: int
    custom_mode: int
    told: int = 1  # how many in a row have said the same


@frozen
class Position:
    """Global position as mission NED, the height above the vehicle's own home, and the altitude it
    says.
    """

    arrival_ns: int
    n_m: Vec3
    above_home_m: float
    altitude_m: float


@frozen
class Attitude:
    arrival_ns: int
    q_n_b: tuple[float, float, float, float]


@frozen
class Text:
    """A STATUSTEXT. ``severity`` in MAVSDK's order: 3 warning, 4 error, 5 critical and up."""

    arrival_ns: int
    severity: int
    text: str


@frozen
class CommandAck:
    """A COMMAND_ACK. ``result`` is MAV_RESULT, 5 of which means: in progress."""

    arrival_ns: int
    command: int
    result: int


@frozen
class Parameter:
    name: str
    value: float


class ThreadClock:
    """The role's clock as MAVSDK's thread may read it: some clocks can be read only where the event
    loop runs.

    ``follow`` belongs to the event loop and is called often, so that a clock that drifts is
    followed.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_ns: int | None = None

    def follow(self) -> None:
        before_ns = time.monotonic_ns()
        now_ns = self._clock.now_ns()
        after_ns = time.monotonic_ns()
        if self._offset_ns is None or after_ns - before_ns < UNDISTURBED_NS:
            self._offset_ns = now_ns - (before_ns + after_ns) // 2

    def now_ns(self) -> int:
        return time.monotonic_ns() + (self._offset_ns or 0)


class TelemetrySlots:
    """Slots, their handlers, and ``state`` made of them. Handlers run on MAVSDK's thread."""

    def __init__(
        self,
        sysid: int,
        clock: Clock,
        tangent: LocalTangent,
        height_from_home: bool = False,
        without_gps: bool = False,
        battery_id: int = LOWEST_ID,
    ) -> None:
        """``without_gps``: MAVSDK's word on the global position is the GPS's health, and not asked
        for.
        """
        self._without_gps = without_gps
        self._sysid = sysid
        self._height_from_home = height_from_home
        self.clock = ThreadClock(clock)
        self._tangent = tangent
        self._history = StateHistory()
        self._failure: BaseException | None = None
        self.kind: AutopilotKind | None = None
        self.heartbeat: Heartbeat | None = None
        self.reported_mode: ReportedMode | None = None
        self.position: Position | None = None
        self.velocity_n_mps: Vec3 = NAN3
        self._local_down_m = math.nan
        self._ground_down_m = math.nan  # where it was armed, in its local frame
        self.attitude: Attitude | None = None
        self.arrivals = {name: Arrivals() for name in ("position", "local position", "attitude")}
        self.health: dict[str, bool] = {}
        self.in_air = False
        self.battery = FlightBattery(battery_id)
        self.rangefinder = Rangefinder()
        self.texts: tuple[Text, ...] = ()
        self.acks: dict[int, CommandAck] = {}
        self.parameter: Parameter | None = None
        self.firmware: str | None = None
        self.radio_heard: bool | None = None  # a pilot's; None: nothing is said of it yet
        self.gps: tuple[int, int] | None = None
        # of its estimator, as it counts them where it sends ODOMETRY
        self.resets: int | None = None
        self._stopped = False  # by a pilot's switch, as a text says

    def subscribe(self, telemetry: Any, direct: Any) -> None:
        """Take everything needed from MAVSDK's Telemetry and MavlinkDirect plugins."""
        direct.subscribe_message("COMMAND_ACK", self._guarded(self._on_ack))
        direct.subscribe_message("PARAM_VALUE", self._guarded(self._on_parameter))
        direct.subscribe_message("SYS_STATUS", self._guarded(self._on_sys_status))
        direct.subscribe_message("GPS_RAW_INT", self._guarded(self._on_gps))
        direct.subscribe_message("BATTERY_STATUS", self._guarded(self._on_battery))
        direct.subscribe_message("DISTANCE_SENSOR", self._guarded(self._on_distance))
        direct.subscribe_message("ODOMETRY", self._guarded(self._on_odometry))
        direct.subscribe_message("AUTOPILOT_VERSION", self._guarded(self._on_version))
        telemetry.subscribe_status_text(self._guarded(self._on_text))
        telemetry.subscribe_health(self._guarded(self._on_health))
        telemetry.subscribe_in_air(self._guarded(self._on_in_air))
        telemetry.subscribe_position(self._guarded(self._on_position))
        telemetry.subscribe_position_velocity_ned(self._guarded(self._on_velocity))
        telemetry.subscribe_attitude_quaternion(self._guarded(self._on_attitude))

    def subscribe_heartbeat(self, direct: Any) -> None:
        """Straight from the message: it has mode, arming and autopilot in one, and MAVSDK's own
        copies come later.
        """
        direct.subscribe_message("HEARTBEAT", self._guarded(self._on_heartbeat))
        direct.subscribe_message("CURRENT_MODE", self._guarded(self._on_current_mode))

    # --- for the event loop ---

    @property
    def known_kind(self) -> AutopilotKind:
        """Whose modes and parameters it has. Raises VehicleError before that is known."""
        if self.kind is None:
            raise VehicleError("the vehicle is not connected", "open it first")
        return self.kind

    def check(self) -> None:
        """Raise VehicleError when a handler failed: MAVSDK itself prints such an exception and goes
        on.
        """
        self.clock.follow()
        if self._failure is not None:
            raise VehicleError(
                f"telemetry cannot be understood: {self._failure!r}",
                "report this; the vehicle is no longer followed",
            ) from self._failure

    def state(self) -> VehicleState:
        """NaN position and stamp 0 until the vehicle first knew where it is."""
        self.check()
        heartbeat = self.heartbeat
        position = self.position
        attitude = self.attitude
        if heartbeat is None or attitude is None:
            raise VehicleError("the vehicle is not connected", "open it first")
        return VehicleState(
            # The older of the two, so that one stream that stops cannot hide behind the other.
            stamp_ns=min(position.arrival_ns, attitude.arrival_ns) if position else 0,
            heartbeat_ns=heartbeat.arrival_ns,
            position_n_m=position.n_m if position else NAN3,
            velocity_n_mps=self.velocity_n_mps,
            q_n_b=attitude.q_n_b,
            armed=heartbeat.armed,
            in_air=self.in_air,
            armable=not self.missing(),
            mode=self.mode,
            battery=self.battery.level,
            battery_ns=self.battery.told_ns,
            mode_told=self.mode_told,
            armed_told=heartbeat.told,
            resets=self.resets,
            below=self.rangefinder.at(self.clock.now_ns()),
            gps=self.gps,
            radio=self.radio_heard,
        )

    @property
    def mode(self) -> FlightMode:
        reported = self.reported_mode
        return self.kind.mode(reported.custom_mode) if self.kind and reported else FlightMode.OTHER

    @property
    def mode_told(self) -> int:
        """The number of messages in a row that have said this mode."""
        return self.reported_mode.told if self.reported_mode else 0

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self._history.attitude_at(stamp_ns)

    def missing(self) -> list[str]:
        """Return what is not ready for flight. ``is_armable`` alone comes seconds before there is
        a position.

        ArduPilot tells a global position, and MAVSDK finds it well, 15 s before it has one that it
        would fly with: then it begins to tell the local one.
        """
        wanted = {
            "is_armable": "arming checks",
            "is_local_position_ok": "local position",
            "is_global_position_ok": "global position",
            "is_home_position_ok": "home position",
        }
        if self._without_gps:
            del wanted["is_global_position_ok"]
        missing = [what for name, what in wanted.items() if not self.health.get(name, False)]
        missing += ["position telemetry"] if self.position is None else []
        return missing + (
            ["local position telemetry"] if math.isnan(self.velocity_n_mps[0]) else []
        )

    def texts_since(self, stamp_ns: int, severity: int = 3) -> list[str]:
        """Texts of warning or worse that came after a stamp, oldest first, each once."""
        texts = [
            text.text
            for text in self.texts
            if text.arrival_ns >= stamp_ns and text.severity >= severity
        ]
        return list(dict.fromkeys(texts))

    # --- on MAVSDK's thread ---

    def _guarded(self, handler: Callable[[Any], None]) -> Callable[[Any, Any], None]:
        @wraps(handler)
        def guarded(value: Any, _user_data: Any) -> None:
            try:
                handler(value)
            # kept for ``check``: whoever raised it must not end MAVSDK's thread
            except Exception as error:
                self._failure = self._failure or error

        return guarded

    def _on_heartbeat(self, message: Any) -> None:
        if not self._of_autopilot(message):
            return
        fields = json.loads(message.fields_json)
        now_ns = self.clock.now_ns()
        self.battery.hear(now_ns)
        self._note_mode(now_ns, int(fields["custom_mode"]))
        base_mode = int(fields["base_mode"])
        before = self.heartbeat
        self._stopped = self._stopped and bool(base_mode & SAFETY_ARMED)
        armed = powered(base_mode, int(fields.get("system_status", 0))) and not self._stopped
        told = before.told + 1 if before is not None and before.armed is armed else 1
        self.heartbeat = Heartbeat(
            now_ns, int(fields["autopilot"]), armed, told, not base_mode & SAFETY_ARMED
        )

    def _on_current_mode(self, message: Any) -> None:
        if self._of_autopilot(message) and self.kind is not None:
            custom_mode = int(json.loads(message.fields_json)["custom_mode"])
            if self.kind.news(custom_mode, self.mode, self.mode_told):
                self._note_mode(self.clock.now_ns(), custom_mode)

    def _note_mode(self, now_ns: int, custom_mode: int) -> None:
        before = self.reported_mode
        told = before.told + 1 if before is not None and before.custom_mode == custom_mode else 1
        self.reported_mode = ReportedMode(now_ns, custom_mode, told)

    def _of_autopilot(self, message: Any) -> bool:
        return message.system_id == self._sysid and message.component_id == AUTOPILOT_COMPONENT

    def _on_ack(self, message: Any) -> None:
        if message.system_id == self._sysid:
            fields = json.loads(message.fields_json)
            ack = CommandAck(self.clock.now_ns(), int(fields["command"]), int(fields["result"]))
            self.acks[ack.command] = ack

    def _on_parameter(self, message: Any) -> None:
        if message.system_id == self._sysid:
            fields = json.loads(message.fields_json)
            value = fields["param_value"]
            self.parameter = Parameter(
                str(fields["param_id"]), math.nan if value is None else float(value)
            )

    def _on_version(self, message: Any) -> None:
        if message.system_id == self._sysid:
            version = int(json.loads(message.fields_json)["flight_sw_version"])
            self.firmware = ".".join(str(version >> shift & 0xFF) for shift in (24, 16, 8))

    def _on_odometry(self, message: Any) -> None:
        """Take the count alone: place and attitude come in messages that every autopilot sends.

        It is not asked for: it is long, and PX4 sends it by itself to a companion.
        """
        if self._of_autopilot(message):
            self.resets = int(json.loads(message.fields_json)["reset_counter"])

    def _on_distance(self, message: Any) -> None:
        if message.system_id == self._sysid:  # a companion computer may be the one that has it
            self.rangefinder.on_distance(json.loads(message.fields_json), self.clock.now_ns())

    def _on_sys_status(self, message: Any) -> None:
        if self._of_autopilot(message):
            fields = json.loads(message.fields_json)
            parts = ("present", "enabled", "health")
            self.battery.on_sys_status(_percent(fields), self.clock.now_ns())
            self.radio_heard = all(
                int(fields[f"onboard_control_sensors_{part}"]) & RC_RECEIVER for part in parts
            )

    def _on_gps(self, message: Any) -> None:
        if self._of_autopilot(message):
            fields = json.loads(message.fields_json)
            self.gps = int(fields["fix_type"]), int(fields["satellites_visible"])

    def _on_text(self, text: Any) -> None:
        self._stopped = stopped_by(str(text.text), self._stopped)
        self.texts = (
            *self.texts[1 - KEPT_TEXTS :],
            Text(self.clock.now_ns(), int(text.type), str(text.text)),
        )

    def _on_health(self, health: Any) -> None:
        self.health = {name: bool(value) for name, value in vars(health).items()}

    def _on_in_air(self, in_air: Any) -> None:
        self.in_air = bool(in_air)

    def _on_battery(self, message: Any) -> None:
        if self._of_autopilot(message):
            fields = json.loads(message.fields_json)
            number = int(fields["id"])
            function = int(fields["battery_function"])
            self.battery.on_battery(number, function, _percent(fields), self.clock.now_ns())

    def _on_position(self, position: Any) -> None:
        north, east, down = self._tangent.to_ned(
            position.latitude_deg, position.longitude_deg, position.absolute_altitude_m
        )
        above_home_m = self._above_home_m(position)
        n_m = (north, east, -above_home_m if self._height_from_home else down)
        now_ns = self.clock.now_ns()
        self.arrivals["position"].add(now_ns)
        self.position = Position(now_ns, n_m, above_home_m, float(position.absolute_altitude_m))

    def _above_home_m(self, position: Any) -> float:
        """Return the height above home, m: of a PX4 from the local frame, else as it is told.

        PX4 flies on one of several estimators. When it goes over to another one its altitude steps,
        by a metre in simulation, and its home's place in the local frame with it; its own place in
        that frame does not. It puts its home where it is armed. What was met in the air is
        believed: nothing better is known.
        """
        above_m = self._ground_down_m - self._local_down_m
        return (
            above_m
            if self.kind is PX4 and math.isfinite(above_m)
            else float(position.relative_altitude_m)
        )

    def _on_velocity(self, ned: Any) -> None:
        velocity = ned.velocity
        self.arrivals["local position"].add(self.clock.now_ns())
        self._local_down_m = float(ned.position.down_m)
        if self.heartbeat is not None and self.heartbeat.disarmed:
            self._ground_down_m = self._local_down_m
        self.velocity_n_mps = (
            float(velocity.north_m_s),
            float(velocity.east_m_s),
            float(velocity.down_m_s),
        )

    def _on_attitude(self, quaternion: Any) -> None:
        now_ns = self.clock.now_ns()
        self.arrivals["attitude"].add(now_ns)
        q_n_b = (float(quaternion.w), float(quaternion.x), float(quaternion.y), float(quaternion.z))
        self.attitude = Attitude(now_ns, q_n_b)
        self._history.add(now_ns, q_n_b)


def _percent(fields: Mapping[str, Any]) -> float:
    """Return ``battery_remaining`` of a message's fields, NaN where it is null."""
    value = fields["battery_remaining"]
    return math.nan if value is None else float(value)
