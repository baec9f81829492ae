"""PX4 and ArduPilot multicopters through MAVSDK, behind the Vehicle Protocol."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Self

from drivers.arrivals import too_slow
from drivers.interfaces import FlightMode, VehicleError, VehicleState, VelocitySetpoint
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.manoeuvres import SAFE_TRIES, Manoeuvres
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.preflight.before_arming import BeforeArming, access_of
from drivers.mavlink.preflight.geofence import FencePlan, Geofence
from drivers.mavlink.preflight.parameters import Difference, ParameterAccess, differences
from drivers.mavlink.session import ACCEPTED, ARM_DISARM, MavsdkSession
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig
from drivers.mavlink.vision import VisionFeed
from drivers.rig.part_check import Finding, counted
from drivers.rig.parts import PartContext

# MAV_CMD
SET_MESSAGE_INTERVAL = 511
REQUEST_MESSAGE = 512
# Message ids, for SET_MESSAGE_INTERVAL
HEARTBEAT = 0
SYS_STATUS = 1
GPS_RAW_INT = 24
ATTITUDE_QUATERNION = 31
LOCAL_POSITION_NED = 32
GLOBAL_POSITION_INT = 33
BATTERY_STATUS = 147
HOME_POSITION = 242
EXTENDED_SYS_STATE = 245
DISTANCE_SENSOR = 132
AUTOPILOT_VERSION = 148
CURRENT_MODE = 436

FRAME_LOCAL_NED = 1
MASK_VELOCITY_YAW = 2503  # ignore position, acceleration and yaw rate (POSITION_TARGET_TYPEMASK)
RANGEFINDER_HZ = 10.0
MODE_HZ = 20.0  # a pilot who takes the vehicle must not wait for the next heartbeat

_FASTER = (
    "a faster link (baud, radio), a lower telemetry_hz in the rig so that all streams fit it, or the autopilot's own "
    "rates for this port; telemetry_age_s in [mission.guard] says how old it may be"
)
USUAL_AGE_S = 0.5  # of telemetry, at which a mission ends that does not say another
_NO_CHARGE = (
    "set its capacity, or name the battery that flies with battery_id in the vehicle's table"
)
_log = logging.getLogger(__name__)


class MavsdkVehicle:
    """A drone flown by velocity setpoints over MAVLink.

    Commands that start motion (arm, take-off, offboard) are sent once; a missing acknowledgement is
    an error and leaves it unknown whether the vehicle acts. Those that end motion (hold, land) are
    resent.
    """

    Config = MavsdkVehicleConfig

    def __init__(self, config: MavsdkVehicleConfig, context: PartContext) -> None:
        self._config = config
        origin = context.origin
        tangent = LocalTangent.at(origin)
        self._telemetry = TelemetrySlots(
            config.sysid,
            context.clock,
            tangent,
            config.height_from == "home",
            config.vision is not None,
            config.battery_id,
        )
        self._clock = self._telemetry.clock
        self._session = MavsdkSession(config, self._telemetry)
        self._manoeuvres = Manoeuvres(self._session, self._telemetry, config)
        self._before = BeforeArming(self._session, self._telemetry, config)
        self._vision = config.vision and VisionFeed(
            config.vision, context, self._session, self._telemetry
        )
        self._feeding: asyncio.Task[None] | None = None
        self._oldest_s = USUAL_AGE_S

    async def __aenter__(self) -> Self:
        try:
            self._manoeuvres.kind = await self._session.open()
            await self._set_rates()
            config = self._config
            telemetry = self._telemetry
            if not await self._session.until(
                lambda: telemetry.attitude is not None, config.connect_timeout_s
            ):
                raise VehicleError(
                    f"no attitude from vehicle {config.sysid} on {config.url} in {config.connect_timeout_s:g} s",
                    "is the link fast enough for telemetry_hz?",
                )
            if self._vision is not None:
                if self._manoeuvres.kind is PX4 and config.height_from != "home":
                    raise VehicleError(
                        "a PX4 without GPS knows no altitude",
                        'write height_from = "home" in its table',
                    )
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
        """Return which autopilot it is, how often it tells what was asked of it, and what arming
        waits for.
        """
        telemetry = self._telemetry
        await self._session.command(REQUEST_MESSAGE, (AUTOPILOT_VERSION,), SAFE_TRIES)
        await self._session.until(
            lambda: telemetry.firmware is not None, self._config.command_timeout_s
        )
        firmware = (
            "that does not tell its firmware"
            if telemetry.firmware is None
            else f"firmware {telemetry.firmware}"
        )
        findings = [
            Finding(
                "ok",
                "autopilot",
                f"{self._manoeuvres.kind.name}, {firmware}, system id {self._config.sysid}",
            )
        ]
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

    async def rangefinder(self, timeout_s: float) -> tuple[str, str]:
        """Listen for a rangefinder that looks down. Return what is wrong, empty when nothing is,
        and what it says.
        """
        own = self._telemetry.rangefinder
        await self._session.until(lambda: own.heard, timeout_s)
        if not own.heard:
            return "no DISTANCE_SENSOR that looks down (orientation 25) came", ""
        below = own.at(self._clock.now_ns())
        if below is None:  # on the ground it may be too near to it
            return (
                "",
                f"heard, it measures nothing at present: {own.trouble or 'its newest word is old'}",
            )
        return "", f"{below.distance_m:.2f} m above the ground"

    async def parameter_differences(self) -> tuple[Difference, ...]:
        """Return the parameters that are not as the rig's ``parameters`` want them. Raises
        VehicleError.
        """
        wanted = self._config.parameters
        return differences(wanted, await self._access.read(wanted))

    async def read_parameters(self, names: Iterable[str]) -> Mapping[str, float | None]:
        """By name, None for one that it does not have. Raises VehicleError."""
        return await self._access.read(names)

    async def set_parameter(self, difference: Difference) -> None:
        """Make one parameter what the rig wants, and confirm it. Raises VehicleError."""
        await self._access.write(difference)

    async def pilot_findings(self) -> Sequence[Finding]:
        """Check that a pilot's radio can take the vehicle; nothing is set. Raises VehicleError."""
        return await self._before.pilot_findings()

    async def plan_geofence(self, fence: Geofence) -> FencePlan:
        """Return what has to be done about the autopilot's own fence; nothing is set. Raises
        VehicleError.
        """
        return await self._before.plan_geofence(fence)

    async def keep_geofence(self, fence: Geofence) -> Mapping[str, float]:
        """Give the autopilot a fence of its own, one step wider than the script's, and read it
        back.

        What was set, by name. Raises VehicleError where that is not possible: then nothing is to be
        armed.
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
            return not telemetry.missing() and telemetry.battery.known and not self._too_slow()

        if await self._session.until(ready, timeout_s):
            await self._before.check_pilot()
            self._check_ground()
            return
        battery = telemetry.battery.trouble
        missing = telemetry.missing() + ([battery] if battery else [])
        if not missing:
            raise VehicleError(
                f"vehicle {self._config.sysid} on {self._config.url} tells its {self._too_slow()}",
                _FASTER,
            )
        texts = telemetry.texts_since(start_ns)[-3:]
        said = f"; the vehicle says: {' | '.join(texts)}" if texts else ""
        raise VehicleError(
            f"vehicle {self._config.sysid} not ready to arm after {timeout_s:g} s: waiting for "
            f"{', '.join(missing)}{said}",
            _NO_CHARGE
            if missing == [battery]
            else "give it a clear sky and do what its ground station shows",
        )

    def expect_telemetry(self, oldest_s: float) -> None:
        """Take how old telemetry may be in the flight to come: what comes too seldom for it is not
        armable.
        """
        self._oldest_s = oldest_s

    def _too_slow(self) -> str:
        return too_slow(self._telemetry.arrivals, self._clock.now_ns(), self._oldest_s)

    def _check_ground(self) -> None:
        """A ceiling that is counted from an altitude of GPS holds only as far as that altitude is
        right.
        """
        config = self._config
        state = self.state
        height_m = -state.position_n_m[2]
        if (
            config.height_from == "sea_level"
            and not state.in_air
            and not abs(height_m) <= config.ground_within_m
        ):
            raise VehicleError(
                f"vehicle {config.sysid} stands on the ground and says that it is {height_m:.1f} m above [origin]",
                'write height_from = "home" in its table, or correct altitude_m in [origin]',
            )

    async def arm(self) -> None:
        if self._manoeuvres.kind is ARDUPILOT:
            # After a landing it is left in a mode that refuses to arm, and only GUIDED takes the
            # take-off command.
            await self._manoeuvres.change_mode(FlightMode.OFFBOARD, "select GUIDED")
        await self._manoeuvres.do("arm", ARM_DISARM, (1.0, 0.0))
        if not await self._session.until(lambda: self.state.armed, self._config.mode_timeout_s):
            raise VehicleError(
                "arming was accepted, but the vehicle is not armed", "see its ground station"
            )

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._session.check_alive()
        if not self.state.armed:
            raise VehicleError("take-off refused: the vehicle is not armed", "arm first")
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise VehicleError(f"take-off refused: height {height_m} m", "give a height above zero")
        await self._manoeuvres.take_off(height_m, timeout_s)

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        config = self._config
        session = self._session
        stream = asyncio.create_task(self._stream(first))
        try:
            # Both autopilots want setpoints before the mode.
            await session.until(stream.done, config.offboard_lead_s)
            await self._manoeuvres.change_mode(FlightMode.OFFBOARD, "enter offboard control")
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
        await self._manoeuvres.change_mode(FlightMode.HOLD, "hold", SAFE_TRIES)

    async def land(self, timeout_s: float) -> None:
        await self._session.check_alive()  # "not armed" must be news
        if not self.state.armed:
            return
        await self._manoeuvres.land(timeout_s)

    # --- inside ---

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
            DISTANCE_SENSOR: RANGEFINDER_HZ,  # of one that has a rangefinder
        }
        for message, rate_hz in rates.items():
            if rate_hz <= 0.0:
                continue
            result = await self._session.command(
                SET_MESSAGE_INTERVAL, (message, 1e6 / rate_hz, 0.0), SAFE_TRIES
            )
            if result is None:
                raise VehicleError(
                    f"vehicle {config.sysid} on {config.url} sends heartbeats but answers no command",
                    "its link is one-way, or a router keeps our messages from it",
                )
            if result != ACCEPTED:
                _log.info("vehicle %d keeps its own rate of message %d", config.sysid, message)

    async def _stream(self, setpoint: VelocitySetpoint) -> None:
        while True:
            self.fly(setpoint)
            await asyncio.sleep(0.05)


def _log_failure(feeding: asyncio.Task[None]) -> None:
    """The vehicle goes on as its autopilot decides when the positions stop; that they did must not
    go unseen.
    """
    if not feeding.cancelled() and feeding.exception() is not None:
        _log.error("external vision has ended: %s", feeding.exception())
