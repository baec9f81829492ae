"""PX4 and ArduPilot multicopters through MAVSDK, behind the Vehicle Protocol."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Self

from drivers.interfaces import SURE, FlightMode, TakenOver, VehicleError, VehicleState, VelocitySetpoint
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.modes import ARDUPILOT, CUSTOM_MODE_ENABLED, PX4, AutopilotKind
from drivers.mavlink.preflight.before_arming import BeforeArming, access_of
from drivers.mavlink.preflight.geofence import FencePlan, Geofence
from drivers.mavlink.preflight.parameters import Difference, ParameterAccess, differences
from drivers.mavlink.preflight.pilot_rules import silenced
from drivers.mavlink.session import ACCEPTED, ARM_DISARM, RESULTS, MavsdkSession, SessionConfig
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.transport.port import URL
from drivers.mavlink.vision import VisionConfig, VisionFeed
from drivers.rig.part_check import Finding, counted
from drivers.rig.parts import PartContext
from path.bounds import AutopilotValues, Bounds

# MAV_CMD
NAV_LAND, NAV_TAKEOFF, DO_SET_MODE, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 21, 22, 176, 511, 512
# Message ids, for SET_MESSAGE_INTERVAL
HEARTBEAT, SYS_STATUS, GPS_RAW_INT, ATTITUDE_QUATERNION, LOCAL_POSITION_NED = 0, 1, 24, 31, 32
GLOBAL_POSITION_INT, BATTERY_STATUS, HOME_POSITION, EXTENDED_SYS_STATE = 33, 147, 242, 245
AUTOPILOT_VERSION, CURRENT_MODE = 148, 436

FRAME_LOCAL_NED = 1
MASK_VELOCITY_YAW = 2503  # ignore position, acceleration and yaw rate (POSITION_TARGET_TYPEMASK)
SETTLED_MPS = 0.3
STOPPED_SHORT_M = 2.0  # PX4 ends a take-off up to 0.8 m before the height (NAV_MC_ALT_RAD), which it may have wrong
DISARM_NEWS_S = 1.5  # PX4 beats once a second
MODE_HZ = 20.0  # a pilot who takes the vehicle must not wait for the next heartbeat
TEXT_WAIT_S = 0.5  # STATUSTEXT may come before or after the refusal it explains
SAFE_TRIES = 3  # what only ends motion, or starts none, is resent when no acknowledgement came

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MavsdkVehicleConfig:
    """Options of the vehicle in a rig.

    Attributes:
        url: MAVSDK connection, ``udpin://127.0.0.1:14541``, ``serial:///dev/ttyACM0:921600``, ...
        sysid: the vehicle's MAVLink system id.
        autopilot: refused when the vehicle is another.
        own_sysid: ours. ArduPilot's ground-station failsafe (MAV_GCS_SYSID) watches it.
        telemetry_hz: position, velocity and attitude; three streams of 50 Hz need 9 kB/s.
        heartbeat_hz: asked for, so that mode and arming are not a second late; 0 leaves it alone.
        connect_timeout_s: for the first heartbeat, and for the first attitude after it.
        command_timeout_s: for one acknowledgement.
        mode_timeout_s: from an accepted command until telemetry shows it.
        heartbeat_timeout_s: any wait ends with an error when the newest heartbeat is older.
        take_off_tolerance_m: height error at which a take-off is over.
        vision: a beacon's positions for an autopilot without GPS.
        height_from: ``sea_level``: the altitude it says against the origin's. ``home``: what it says to be above its
            home, which must then lie at the origin's altitude. Two GPS differ by metres in altitude, two barometers
            that started on the same ground by decimetres.
        key_file: of MAVLink 2's signatures, 32 bytes, mode 0600, the one that the autopilot was given (SETUP_SIGNING);
            then only what is rightly signed is believed, and all that is sent is signed.
        parameters: of the autopilot, without which a companion-driven flight is not safe; checked before arming. None
            of them may keep a pilot's radio out.
        rc: ``required``: nothing is armed unless a pilot's radio is heard and can take the vehicle. ``none``: there is
            none, and nobody can take it but by a ground station.
        ground_within_m: of the origin's altitude, as far as the vehicle says with ``sea_level`` while it stands there.
    """

    url: str
    sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 1
    autopilot: Literal["auto", "px4", "ardupilot"] = "auto"
    own_sysid: Annotated[int, Bounds(1, 255, "(an id)")] = 245
    # MAV_COMP_ID_MISSIONPLANNER: a ground station, as the failsafes expect
    own_compid: Annotated[int, Bounds(1, 255, "(an id)")] = 190
    telemetry_hz: Annotated[float, Bounds(1.0, 400.0)] = 50.0
    heartbeat_hz: Annotated[float, Bounds(0.0, 50.0)] = 5.0
    connect_timeout_s: Annotated[float, Bounds(0.1, 300.0)] = 10.0
    command_timeout_s: Annotated[float, Bounds(0.05, 30.0)] = 1.0
    mode_timeout_s: Annotated[float, Bounds(0.05, 60.0)] = 3.0
    heartbeat_timeout_s: Annotated[float, Bounds(0.2, 30.0)] = 1.5
    take_off_tolerance_m: Annotated[float, Bounds(0.01, 5.0)] = 0.3
    offboard_lead_s: Annotated[float, Bounds(0.0, 5.0)] = 0.3
    vision: VisionConfig | None = None
    height_from: Literal["sea_level", "home"] = "sea_level"
    key_file: Path | None = None
    parameters: AutopilotValues = field(default_factory=dict[str, float])
    rc: Literal["required", "none"] = "required"
    ground_within_m: Annotated[float, Bounds(0.1, 100.0)] = 3.0

    def __post_init__(self) -> None:
        if keeps_out := silenced(self.parameters):
            raise ValueError(f"parameters: {'; '.join(keeps_out)}")
        for name in ("sysid", "own_sysid"):
            if not 1 <= getattr(self, name) <= 255:
                raise ValueError(f"{name} must be within 1..255")
        if self.sysid == self.own_sysid:
            raise ValueError("sysid and own_sysid must differ")
        if self.key_file is not None and URL.fullmatch(self.url) is None:
            raise ValueError(
                "key_file: what is signed goes over udpin://HOST:PORT, udpout://HOST:PORT, serial://DEVICE:BAUD"
            )


class MavsdkVehicle:
    """A drone flown by velocity setpoints over MAVLink.

    Commands that start motion (arm, take-off, offboard) are sent once; a missing acknowledgement is an error and
    leaves it unknown whether the vehicle acts. Those that end motion (hold, land) are resent.
    """

    Config = MavsdkVehicleConfig

    def __init__(self, config: MavsdkVehicleConfig, context: PartContext) -> None:
        self._config = config
        origin = context.origin
        tangent = LocalTangent(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
        self._telemetry = TelemetrySlots(
            config.sysid, context.clock, tangent, config.height_from == "home", config.vision is not None
        )
        session = SessionConfig(
            url=config.url,
            sysid=config.sysid,
            own_sysid=config.own_sysid,
            own_compid=config.own_compid,
            autopilot=config.autopilot,
            connect_timeout_s=config.connect_timeout_s,
            command_timeout_s=config.command_timeout_s,
            heartbeat_timeout_s=config.heartbeat_timeout_s,
            key_file=config.key_file,
        )
        self._clock = self._telemetry.clock
        self._session = MavsdkSession(session, self._telemetry)
        self._kind: AutopilotKind = PX4
        self._before = BeforeArming(self._session, self._telemetry, config)
        self._vision = config.vision and VisionFeed(config.vision, context, self._session, self._telemetry)
        self._feeding: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        try:
            self._kind = await self._session.open()
            await self._set_rates()
            config, telemetry = self._config, self._telemetry
            if not await self._session.until(lambda: telemetry.attitude is not None, config.connect_timeout_s):
                raise VehicleError(
                    f"no attitude from vehicle {config.sysid} on {config.url} in {config.connect_timeout_s:g} s",
                    "is the link fast enough for telemetry_hz?",
                )
            if self._vision is not None:
                if self._kind is PX4 and config.height_from != "home":
                    raise VehicleError("a PX4 without GPS knows no altitude", 'write height_from = "home" in its table')
                self._feeding = asyncio.create_task(self._vision.run())
                self._feeding.add_done_callback(_log_failure)
        except BaseException:
            await self._session.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._feeding is not None:
            self._feeding.cancel()
            await asyncio.gather(self._feeding, return_exceptions=True)
        await self._session.close()

    @property
    def state(self) -> VehicleState:
        return self._telemetry.state()

    @property
    def ignored(self) -> Mapping[str, int]:
        """Everything that came as the vehicle's and was not believed, in words, and its count."""
        return self._session.ignored

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self._telemetry.attitude_at(stamp_ns)

    async def examine(self) -> Sequence[Finding]:
        """Returns which autopilot it is, how often it tells what was asked of it, and what arming waits for."""
        telemetry = self._telemetry
        await self._session.command(REQUEST_MESSAGE, (AUTOPILOT_VERSION,), SAFE_TRIES)
        await self._session.until(lambda: telemetry.firmware is not None, self._config.command_timeout_s)
        firmware = "that does not tell its firmware" if telemetry.firmware is None else f"firmware {telemetry.firmware}"
        findings = [Finding("ok", "autopilot", f"{self._kind.name}, {firmware}, system id {self._config.sysid}")]
        streams = {
            "attitude": lambda: telemetry.attitude and telemetry.attitude.arrival_ns,
            "position": lambda: telemetry.position and telemetry.position.arrival_ns,
        }
        fix = "a faster link (baud, radio), or a lower telemetry_hz in the rig"
        findings += await counted(streams, self._config.telemetry_hz, fix)
        if missing := telemetry.missing():
            findings.append(Finding("note", "waits for", ", ".join(missing)))
        if texts := telemetry.texts_since(0)[-3:]:
            findings.append(Finding("note", "says", " | ".join(texts)))
        return findings

    async def parameter_differences(self) -> tuple[Difference, ...]:
        """Returns the parameters that are not as the rig's ``parameters`` want them. Raises VehicleError."""
        wanted = self._config.parameters
        return differences(wanted, await self._access.read(wanted))

    async def read_parameters(self, names: Iterable[str]) -> Mapping[str, float | None]:
        """By name, None for one that it does not have. Raises VehicleError."""
        return await self._access.read(names)

    async def set_parameter(self, difference: Difference) -> None:
        """Make one parameter what the rig wants, and confirm it. Raises VehicleError."""
        await self._access.write(difference)

    async def pilot_findings(self) -> Sequence[Finding]:
        """Checks that a pilot's radio can take the vehicle; nothing is set. Raises VehicleError."""
        return await self._before.pilot_findings()

    async def plan_geofence(self, fence: Geofence) -> FencePlan:
        """Returns what has to be done about the autopilot's own fence; nothing is set. Raises VehicleError."""
        return await self._before.plan_geofence(fence)

    async def keep_geofence(self, fence: Geofence) -> Mapping[str, float]:
        """Gives the autopilot a fence of its own, one step wider than the script's, and reads it back.

        What was set, by name. Raises VehicleError where that is not possible: then nothing is to be armed.
        """
        return await self._before.keep_geofence(fence)

    @property
    def _access(self) -> ParameterAccess:
        return access_of(self._session, self._config.url)

    async def wait_armable(self, timeout_s: float) -> None:
        await self._session.check_alive()  # what it said before it fell silent counts no more
        wrong = await self.parameter_differences()
        if wrong:
            raise VehicleError(
                f"vehicle {self._config.sysid} is not set for this flight: {'; '.join(map(str, wrong))}",
                "look at `path-handoff doctor --rig RIG`; `--set-parameters` there sets them",
            )
        telemetry = self._telemetry
        start_ns = self._clock.now_ns()

        def ready() -> bool:
            return not telemetry.missing() and telemetry.battery is not None

        if await self._session.until(ready, timeout_s):
            await self._before.check_pilot()
            self._check_ground()
            return
        missing = telemetry.missing() + (["battery level"] if telemetry.battery is None else [])
        texts = telemetry.texts_since(start_ns)[-3:]
        said = f"; the vehicle says: {' | '.join(texts)}" if texts else ""
        raise VehicleError(
            f"vehicle {self._config.sysid} not ready to arm after {timeout_s:g} s: waiting for "
            f"{', '.join(missing)}{said}",
            "give it a clear sky and do what its ground station shows, then start again",
        )

    def _check_ground(self) -> None:
        """A ceiling that is counted from an altitude of GPS holds only as far as that altitude is right."""
        config, state = self._config, self.state
        height_m = -state.position_n_m[2]
        if config.height_from == "sea_level" and not state.in_air and not abs(height_m) <= config.ground_within_m:
            raise VehicleError(
                f"vehicle {config.sysid} stands on the ground and says that it is {height_m:.1f} m above [origin]",
                'write height_from = "home" in its table, or correct altitude_m in [origin]',
            )

    async def arm(self) -> None:
        if self._kind is ARDUPILOT:
            # After a landing it is left in a mode that refuses to arm, and only GUIDED takes the take-off command.
            await self._change_mode(FlightMode.OFFBOARD, "select GUIDED")
        await self._do("arm", ARM_DISARM, (1.0, 0.0))
        if not await self._session.until(lambda: self.state.armed, self._config.mode_timeout_s):
            raise VehicleError("arming was accepted, but the vehicle is not armed", "see its ground station")

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._session.check_alive()
        if not self.state.armed:
            raise VehicleError("take-off refused: the vehicle is not armed", "arm first")
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"take-off refused: height {height_m} m", "give a height above zero")
        if self._kind is PX4:
            # An older one climbs no less than this. It is not what is flown: PX4 looks at its parameters once a second,
            # and has acknowledged a height and climbed to the one it had before.
            await self._session.set_float_parameter("MIS_TAKEOFF_ALT", height_m)
            await self._do("take off", NAV_TAKEOFF, (*[None] * 6, self._altitude_m() + height_m))
            there = FlightMode.HOLD
        else:
            await self._do("take off", NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m))
            there = FlightMode.OFFBOARD
        await self._climb(height_m, there, timeout_s)

    def _altitude_m(self) -> float:
        """Of where it stands, as it says itself, whatever that is above the sea in truth. Raises VehicleError."""
        position = self._telemetry.position
        if position is None or not math.isfinite(position.altitude_m):
            raise VehicleError("take-off refused: the vehicle tells no altitude", "see its ground station")
        return position.altitude_m

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        config, session = self._config, self._session
        stream = asyncio.create_task(self._stream(first))
        try:
            # Both autopilots want setpoints before the mode.
            await session.until(stream.done, config.offboard_lead_s)
            await self._change_mode(FlightMode.OFFBOARD, "enter offboard control")
        finally:
            stream.cancel()
            await asyncio.gather(stream, return_exceptions=True)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        north, east, down = setpoint.velocity_n_mps
        if not all(map(math.isfinite, (north, east, down, setpoint.yaw_rad))):
            raise VehicleError(f"setpoint not sent: {setpoint} is not finite")
        self._session.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            {
                "time_boot_ms": self._session.boot_ms(),
                "coordinate_frame": FRAME_LOCAL_NED,
                "type_mask": MASK_VELOCITY_YAW,
                **dict.fromkeys(("x", "y", "z", "afx", "afy", "afz", "yaw_rate"), 0.0),
                "vx": north,
                "vy": east,
                "vz": down,
                "yaw": setpoint.yaw_rad,
            },
        )

    async def hold(self) -> None:
        await self._change_mode(FlightMode.HOLD, "hold", SAFE_TRIES)

    async def land(self, timeout_s: float) -> None:
        await self._session.check_alive()  # "not armed" must be news
        if not self.state.armed:
            return
        telemetry = self._telemetry
        climbs = telemetry.mode is FlightMode.TAKEOFF

        def held() -> bool:
            """A PX4 whose take-off is over in this very moment goes on to hold, over a landing that it acknowledged."""
            return climbs and telemetry.mode is FlightMode.HOLD and telemetry.mode_told >= SURE

        await self._begin_landing(held)
        if held():
            await self._begin_landing(lambda: False)
        await self._until_down(self._clock.now_ns() + int(timeout_s * 1e9), timeout_s)

    # --- inside ---

    async def _begin_landing(self, or_else: Callable[[], bool]) -> None:
        sent_ns = self._clock.now_ns()
        unset = self._kind.unset
        await self._do("land", NAV_LAND, (0.0, 0.0, 0.0, unset, unset, unset, 0.0), SAFE_TRIES)
        await self._until_mode(FlightMode.LAND, sent_ns, "land", lambda: not self.state.armed or or_else())

    async def _set_rates(self) -> None:
        config = self._config
        rates = {
            HEARTBEAT: config.heartbeat_hz,
            CURRENT_MODE: MODE_HZ,
            ATTITUDE_QUATERNION: config.telemetry_hz,
            LOCAL_POSITION_NED: config.telemetry_hz,
            GLOBAL_POSITION_INT: config.telemetry_hz,
            EXTENDED_SYS_STATE: 5.0,
            SYS_STATUS: 2.0,
            GPS_RAW_INT: 2.0,
            BATTERY_STATUS: 1.0,
            HOME_POSITION: 1.0,
        }
        for message, rate_hz in rates.items():
            if rate_hz <= 0.0:
                continue
            result = await self._session.command(SET_MESSAGE_INTERVAL, (message, 1e6 / rate_hz, 0.0), SAFE_TRIES)
            if result is None:
                raise VehicleError(
                    f"vehicle {config.sysid} on {config.url} sends heartbeats but answers no command",
                    "its link is one-way, or a router keeps our messages from it",
                )
            if result != ACCEPTED:
                _log.info("vehicle %d keeps its own rate of message %d", config.sysid, message)

    async def _do(self, what: str, command: int, params: tuple[float | None, ...], tries: int = 1) -> None:
        """One command that must be accepted. Raises with the vehicle's own reason."""
        sent_ns = self._clock.now_ns()
        result = await self._session.command(command, params, tries)
        if result == ACCEPTED:
            return
        if result is None:
            raise VehicleError(
                f"no answer to the command to {what}: whether the vehicle acts on it is unknown",
                "look at the vehicle before anything else is tried",
            )
        telemetry = self._telemetry
        await self._session.until(lambda: bool(telemetry.texts_since(sent_ns)), TEXT_WAIT_S)
        reasons = telemetry.texts_since(sent_ns) or [f"{name} missing" for name in telemetry.missing()]
        answer = RESULTS[result] if result < len(RESULTS) else f"result {result}"
        raise VehicleError(
            f"the vehicle refused to {what} ({answer}): {' | '.join(reasons) or 'it gave no reason'}",
            "remedy what it names, then start again",
        )

    async def _change_mode(self, mode: FlightMode, what: str, tries: int = 1) -> None:
        sent_ns = self._clock.now_ns()
        main, sub = self._kind.set_mode[mode]
        await self._do(what, DO_SET_MODE, (CUSTOM_MODE_ENABLED, float(main), float(sub)), tries)
        await self._until_mode(mode, sent_ns, what)

    async def _until_mode(
        self, mode: FlightMode, sent_ns: int, what: str, or_else: Callable[[], bool] = lambda: False
    ) -> None:
        """Waits until a report younger than the command shows the mode.

        An older one may still show the last but one.
        """
        telemetry = self._telemetry

        def shown() -> bool:
            reported = telemetry.reported_mode
            return reported is not None and reported.arrival_ns > sent_ns and telemetry.mode is mode

        if not await self._session.until(lambda: shown() or or_else(), self._config.mode_timeout_s):
            texts = " | ".join(telemetry.texts_since(sent_ns)) or "it gives no reason"
            raise VehicleError(
                f"the vehicle agreed to {what} but is in mode {telemetry.mode.value}: {texts}",
                "the pilot may have control; look at its ground station",
            )

    async def _until_down(self, end_ns: int, timeout_s: float) -> None:
        """Waits until it is disarmed.

        Having landed, PX4 goes back to the mode before it, and tells so up to a heartbeat before it tells that it is
        disarmed. So a mode of a script's is another's only when it stays armed.
        """
        session, telemetry = self._session, self._telemetry

        def down() -> bool:
            return not self.state.armed

        def lands() -> bool:
            return telemetry.mode is FlightMode.LAND

        def pilots() -> bool:
            return telemetry.mode is FlightMode.OTHER and telemetry.mode_told >= SURE

        while not down():
            left_s = (end_ns - self._clock.now_ns()) * 1e-9
            if not await session.until(lambda: down() or not lands(), left_s):
                what = f"not on the ground {timeout_s:g} s after the landing began"
                raise VehicleError(what, "land by remote control")
            await session.until(lambda: down() or lands() or pilots(), DISARM_NEWS_S)
            if not (down() or lands()):
                raise TakenOver(f"landing ended by a change to mode {telemetry.mode.value}", "the pilot has control")

    async def _climb(self, height_m: float, there: FlightMode, timeout_s: float) -> None:
        """Waits until at the height and steady.

        A pilot's mode, a hold, a landing or disarming on the way ends it with an error.
        """
        telemetry, config = self._telemetry, self._config
        expected = {FlightMode.TAKEOFF, FlightMode.HOLD, there}
        # The heartbeat may still show the mode before the take-off.
        grace_ns = self._clock.now_ns() + int(config.mode_timeout_s * 1e9)

        def arrived() -> bool:
            position = telemetry.position
            return (
                position is not None
                and abs(position.above_home_m - height_m) <= config.take_off_tolerance_m
                and abs(telemetry.velocity_n_mps[2]) <= SETTLED_MPS
                and telemetry.mode is there
            )

        def held() -> bool:
            position = telemetry.position
            short = position is not None and height_m - position.above_home_m > STOPPED_SHORT_M
            return short and telemetry.mode is FlightMode.HOLD

        def ended() -> bool:
            late = self._clock.now_ns() > grace_ns
            other = telemetry.mode not in expected and telemetry.mode_told >= SURE
            return not self.state.armed or (late and (held() or other))

        if not await self._session.until(lambda: arrived() or ended(), timeout_s):
            raise VehicleError(f"not at {height_m:g} m {timeout_s:g} s after the take-off began", "hold or land")
        if ended():
            if self.state.armed:
                said = f"take-off ended on the way: mode {telemetry.mode.value}"
                raise TakenOver(said, "the pilot has control, or a failsafe acted")
            heartbeat = telemetry.heartbeat
            if heartbeat is not None and not heartbeat.disarmed:
                raise TakenOver("take-off ended on the way: the motors were stopped", "the pilot's kill switch")
            raise VehicleError(
                "take-off ended on the way: disarmed", "a failsafe acted, or it was never off the ground"
            )

    async def _stream(self, setpoint: VelocitySetpoint) -> None:
        while True:
            self.fly(setpoint)
            await asyncio.sleep(0.05)


def _log_failure(feeding: asyncio.Task[None]) -> None:
    """The vehicle goes on as its autopilot decides when the positions stop; that they did must not go unseen."""
    if not feeding.cancelled() and feeding.exception() is not None:
        _log.error("external vision has ended: %s", feeding.exception())
