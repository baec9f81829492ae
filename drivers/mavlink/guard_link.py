"""The guard's own MAVLink link to one vehicle, PX4 or ArduPilot: what it must see, and two
commands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from drivers.link.key import signing_key
from drivers.link.udp import address_of
from drivers.mavlink.battery import LOWEST_ID, FlightBattery
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.guard.interfaces import GuardView
from drivers.mavlink.modes import (
    CUSTOM_MODE_ENABLED,
    KINDS,
    PX4,
    SAFETY_ARMED,
    AutopilotKind,
    powered,
    stopped_by,
)
from drivers.mavlink.transport.port import URL, MavlinkPort
from drivers.rig.parts import PartContext
from path.bounds import Bounds, check_bounds
from path.values import frozen

HEARTBEAT = 0
SYS_STATUS = 1
LOCAL_POSITION = 32
GLOBAL_POSITION = 33
COMMAND_ACK = 77
BATTERY_STATUS = 147
EXTENDED_SYS_STATE = 245
STATUSTEXT = 253
CURRENT_MODE = 436
RATES_HZ = {
    **dict.fromkeys((HEARTBEAT, CURRENT_MODE, LOCAL_POSITION, GLOBAL_POSITION), 10.0),
    EXTENDED_SYS_STATE: 5.0,
    SYS_STATUS: 2.0,
    BATTERY_STATUS: 1.0,
}
WANTED = frozenset({*RATES_HZ, COMMAND_ACK, STATUSTEXT})
DO_SET_MODE = 176
NAV_LAND = 21
SET_MESSAGE_INTERVAL = 511
IN_PROGRESS = 5
OWN_HEARTBEAT_S = 1.0
ASK_AGAIN_S = 3.0
STALE_S = 1.0
MOST_ASKED = 5  # times for BATTERY_STATUS: a vehicle may not have it


@frozen
class GuardMavlinkConfig:
    """The ``[sender.guard]`` and ``[receiver.guard]`` tables of a rig.

    Attributes:
        url: a second way to the autopilot, ``udpin://127.0.0.1:14551`` (an endpoint of a MAVLink
            router), ``udpout://10.0.0.2:14550``, ``serial:///dev/ttyTHS2:57600``; never the one the
            role uses.
        vehicle_sysid: of the vehicle, as in ``[*.vehicle]``.
        bind: where the role's program and its guard meet, on this computer.
        key_file: of MAVLink 2's signatures, 32 bytes, mode 0600, the one that the autopilot was
            given (SETUP_SIGNING); then only what is rightly signed is believed, and all that is
            sent is signed.
        height_from: as of the vehicle that is flown, and taken from its table where this one does
            not say it.
        battery_id: as of the vehicle that is flown, and taken from its table where this one does
            not say it.
        own_sysid, own_compid: who the guard is on MAVLink. Not the number that ArduPilot's
            MAV_GCS_SYSID or PX4's data link loss watches: a guard that lives must not hide that the
            role's program died.
    """

    url: str
    bind: str
    vehicle_sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 1
    own_sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 246
    own_compid: Annotated[int, Bounds(1, 255, "(an id)")] = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
    key_file: Path | None = None
    height_from: Literal["sea_level", "home"] = "sea_level"
    battery_id: Annotated[int, Bounds(-1, 255, "(an id; -1: the lowest)")] = LOWEST_ID

    def __post_init__(self) -> None:
        if URL.fullmatch(self.url) is None:
            raise ValueError(
                f"url: {self.url!r} is not like udpin://HOST:PORT, udpout://HOST:PORT, serial://DEVICE:BAUD"
            )
        host, _ = address_of(self.bind, "bind")
        if not host.startswith("127."):
            raise ValueError(
                "bind: a guard listens on its own computer only, such as 127.0.0.1:14561"
            )
        check_bounds(self)
        if self.vehicle_sysid == self.own_sysid:
            raise ValueError("vehicle_sysid and own_sysid must differ")


class GuardMavlink:
    """A ``drivers.mavlink.guard.interfaces.Watched``. A command is one packet a call, never
    repeated here.
    """

    Config = GuardMavlinkConfig

    def __init__(self, config: GuardMavlinkConfig, context: PartContext) -> None:
        self._config = config
        self._clock = context.clock
        origin = context.origin
        self._tangent = LocalTangent.at(origin)
        self._port: MavlinkPort | None = None
        self._kind: AutopilotKind | None = None
        self._heartbeat: tuple[int, Any] | None = None
        self._mode = FlightMode.OTHER
        self._mode_told = 0
        # the latter: where it stood before it was armed
        self._local_down_m = self._ground_down_m = math.nan
        self._position: tuple[int, tuple[float, float, float]] = (0, (math.nan, math.nan, math.nan))
        self._stopped = False  # by a pilot's switch, as a text says
        # until it is told: nothing is done in the air that would be wrong on the ground
        self._in_air = True
        self._battery = FlightBattery(config.battery_id)
        self._commanded: int | None = None
        self._acked: bool | None = None
        self._asked_ns = 0
        self._asked_battery = 0
        self._beat_ns = 0

    @property
    def name(self) -> str:
        return f"vehicle {self._config.vehicle_sysid} on {self._config.url}"

    @property
    def ignored(self) -> Mapping[str, int]:
        return {} if self._port is None else self._port.ignored

    async def __aenter__(self) -> Self:
        config = self._config
        own = config.own_sysid, config.own_compid
        key = signing_key(config.key_file)
        self._port = MavlinkPort(
            config.url,
            config.vehicle_sysid,
            own,
            WANTED,
            self._clock.now_ns,
            key,
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        port = self._port
        self._port = None
        if port is not None:
            port.close()

    def view(self) -> GuardView | None:
        self._read()
        if self._heartbeat is None or self._kind is None:
            return None
        heartbeat_ns, heartbeat = self._heartbeat
        position_ns, position_n_m = self._position
        return GuardView(
            heartbeat_ns=heartbeat_ns,
            position_ns=position_ns,
            armed=powered(heartbeat.base_mode, heartbeat.system_status) and not self._stopped,
            in_air=self._in_air,
            mode=self._mode,
            position_n_m=position_n_m,
            battery=self._battery.level,
            battery_ns=self._battery.told_ns,
            acked=self._acked,
            mode_told=self._mode_told,
        )

    def hold(self) -> None:
        if self._kind is None:
            return  # it was never heard: there is nobody to command
        main, sub = self._kind.set_mode[FlightMode.HOLD]
        self._command(DO_SET_MODE, CUSTOM_MODE_ENABLED, main, sub)

    def land(self) -> None:
        if self._kind is None:
            return
        unset = math.nan if self._kind.unset is None else self._kind.unset
        self._command(NAV_LAND, 0.0, 0.0, 0.0, unset, unset, unset)

    # --- inside ---

    def _command(self, command: int, *params: float) -> None:
        self._commanded = command
        self._acked = None
        self._send_command(command, *params)

    def _send_command(self, command: int, *params: float) -> None:
        filled = [*params, *([0.0] * (7 - len(params)))]
        target = self._config.vehicle_sysid, mavlink.MAV_COMP_ID_AUTOPILOT1
        self._send(mavlink.MAVLink_command_long_message(*target, command, 0, *filled))

    def _send(self, message: Any) -> None:
        if self._port is not None:
            self._port.send(message)

    def _read(self) -> None:
        if self._port is None:
            return
        now_ns = self._clock.now_ns()
        for message in self._port.read():
            self._take(message, now_ns)
        if (now_ns - self._beat_ns) * 1e-9 >= OWN_HEARTBEAT_S:
            self._beat_ns = now_ns
            companion = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self._send(
                mavlink.MAVLink_heartbeat_message(*companion, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)
            )
        if self._heartbeat is not None and (now_ns - self._asked_ns) * 1e-9 >= ASK_AGAIN_S:
            self._ask(now_ns)

    def _ask(self, now_ns: int) -> None:
        """Ask for everything when positions are late, and a few times for the batteries while none
        is told of.
        """
        late = (now_ns - self._position[0]) * 1e-9 > STALE_S
        wanted = RATES_HZ if late else {BATTERY_STATUS: RATES_HZ[BATTERY_STATUS]}
        if not late and (self._battery.heard or self._asked_battery >= MOST_ASKED):
            return
        self._asked_ns = now_ns
        self._asked_battery += 1
        for message_id, rate_hz in wanted.items():
            self._send_command(SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def _take(self, message: Any, now_ns: int) -> None:
        match message.get_msgId():
            case 0:  # HEARTBEAT
                self._kind = next(
                    (kind for kind in KINDS if kind.mav_autopilot == message.autopilot), self._kind
                )
                self._heartbeat = now_ns, message
                self._battery.hear(now_ns)
                self._stopped = self._stopped and bool(message.base_mode & SAFETY_ARMED)
                self._note_mode(message.custom_mode)
            case 1:  # SYS_STATUS
                self._battery.on_sys_status(message.battery_remaining, now_ns)
            # BATTERY_STATUS
            case 147 if message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
                self._battery.on_battery(
                    message.id,
                    message.battery_function,
                    message.battery_remaining,
                    now_ns,
                )
            case 33:  # GLOBAL_POSITION_INT
                self._position = now_ns, self._place(message)
            case 32:  # LOCAL_POSITION_NED
                self._local_down_m = float(message.z)
                if self._heartbeat is not None and not self._heartbeat[1].base_mode & SAFETY_ARMED:
                    self._ground_down_m = self._local_down_m
            # COMMAND_ACK
            case 77 if message.command == self._commanded and message.result != IN_PROGRESS:
                self._acked = message.result == mavlink.MAV_RESULT_ACCEPTED
            case 245:  # EXTENDED_SYS_STATE
                self._in_air = message.landed_state != mavlink.MAV_LANDED_STATE_ON_GROUND
            case 253:  # STATUSTEXT
                self._stopped = stopped_by(str(message.text), self._stopped)
            # CURRENT_MODE: PX4 beats once a second, whatever it is asked for
            case 436 if self._kind is not None:
                if self._kind.news(message.custom_mode, self._mode, self._mode_told):
                    self._note_mode(message.custom_mode)
            case _:
                pass

    def _place(self, message: Any) -> tuple[float, float, float]:
        """Return the place in NED, with the height that the script has.

        Of a PX4 the local one (``Telemetry`` says why).
        """
        north, east, down = self._tangent.to_ned(
            message.lat * 1e-7,
            message.lon * 1e-7,
            message.alt * 1e-3,
        )
        if self._config.height_from == "sea_level":
            return north, east, down
        above_m = self._ground_down_m - self._local_down_m
        local = self._kind is PX4 and math.isfinite(above_m)
        return north, east, -above_m if local else -message.relative_alt * 1e-3

    def _note_mode(self, custom_mode: int) -> None:
        if self._kind is not None:
            mode = self._kind.mode(custom_mode)
            self._mode, self._mode_told = mode, self._mode_told + 1 if mode is self._mode else 1
