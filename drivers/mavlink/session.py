"""One MAVSDK instance on one connection, talking to one vehicle chosen by its system id.

Everything is sent through MavlinkDirect, one message a call. MAVSDK's Offboard plugin would repeat
the last setpoint from its own thread while Python hangs, and its Action plugin resends commands
that were not acknowledged.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mavsdk import logging as mavsdk_logging
from mavsdk.exceptions import MavsdkError
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin

from drivers.interfaces import LinkError, VehicleError
from drivers.link.key import signing_key
from drivers.mavlink.modes import KINDS, AutopilotKind
from drivers.mavlink.preflight.parameters import ParameterAccess
from drivers.mavlink.telemetry import AUTOPILOT_COMPONENT, TelemetrySlots
from drivers.mavlink.transport.mavsdk_line import MavsdkLine, needs_line
from drivers.mavlink.transport.port_lock import PortLock
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig

POLL_S = 0.01
LONGEST_POLL_S = 0.1  # a longer one is a program that stood still
SECOND_LOOK_S = 0.3  # in which a heartbeat that waits to be read must come
CLOSE_S = 5.0
FORCE_DISARM_MAGIC = 21196.0
ARM_DISARM = 400  # MAV_CMD_COMPONENT_ARM_DISARM
# MAV_RESULT
ACCEPTED = 0
IN_PROGRESS = 5
REAL32 = 9  # MAV_PARAM_TYPE
RESULTS = (
    "accepted",
    "temporarily rejected",
    "denied",
    "unsupported",
    "failed",
    "in progress",
    "cancelled",
)

_log = logging.getLogger("drivers.mavsdk")
# the open ones; MAVSDK has one log for all, and prints it when nobody takes it
_logging: set[MavsdkSession] = set()


class MavsdkSession:
    """Opened by ``open``, closed by ``close``. All methods belong to the event loop and raise
    VehicleError.
    """

    def __init__(self, config: MavsdkVehicleConfig, telemetry: TelemetrySlots) -> None:
        self._config = config
        self._clock = telemetry.clock
        self._telemetry = telemetry
        self._mavsdk: Any = None
        self._direct: Any = None
        # as the others: when it is collected, its subscriptions end without a word
        self._plugin: Any = None
        self.parameters: ParameterAccess | None = None  # while open
        self._lock: PortLock | None = None
        self._line: MavsdkLine | None = None
        self._start_s = time.monotonic()

    async def open(self) -> AutopilotKind:
        """Connect and wait for the vehicle's heartbeat. Says what was heard instead when it is not
        there.
        """
        url = self._config.url
        try:
            key = signing_key(self._config.key_file)
        except LinkError as error:
            raise VehicleError(str(error)) from error
        self._clock.follow()
        self._lock = PortLock(url)
        _logging.add(self)
        mavsdk_logging.log_subscribe(_to_python_log)
        self._mavsdk = Mavsdk(
            Configuration.create_manual(self._config.own_sysid, self._config.own_compid, True)
        )
        if needs_line(url, key):
            own = self._config.own_sysid, self._config.own_compid
            self._line = MavsdkLine(url, self._config.sysid, own, key)
        try:
            if self._line is None:
                self._mavsdk.add_any_connection_with_handle(url)
            else:
                self._line.start(self._mavsdk)
        except MavsdkError as error:
            raise VehicleError(
                f"cannot open {url}: {error}", "check that the device or address exists"
            ) from error
        system = await self._find_system()
        self._direct = MavlinkDirect(system)
        self._telemetry.subscribe_heartbeat(self._direct)
        end_s = time.monotonic() + self._config.connect_timeout_s
        while self._telemetry.heartbeat is None and time.monotonic() < end_s:
            self._telemetry.check()
            await asyncio.sleep(POLL_S)
        kind = self._identify()
        self._telemetry.kind = kind
        self.parameters = ParameterAccess(system)
        self._plugin = TelemetryPlugin(system)
        self._telemetry.subscribe(self._plugin, self._direct)
        return kind

    async def close(self) -> None:
        """Idempotent and bounded. MAVSDK's threads and the port are gone afterwards."""
        mavsdk = self._mavsdk
        direct = self._direct
        plugin = self._plugin
        parameters = self.parameters
        self._mavsdk = self._direct = self._plugin = self.parameters = None
        try:
            if self._line is not None:
                self._line.stop()
            if mavsdk is not None:
                await _destroy(
                    [part for part in (parameters, plugin, direct, mavsdk) if part is not None]
                )
        finally:
            _logging.discard(self)
            if not _logging:
                mavsdk_logging.log_unsubscribe()
            if self._line is not None:
                self._line.close()
            if self._lock is not None:
                self._lock.release()

    @property
    def ignored(self) -> Mapping[str, int]:
        """Everything that came as the vehicle's and was not believed, in words, and its count."""
        return {} if self._line is None else self._line.ignored

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; False when it did not come. Raises when the vehicle falls silent.

        Time in which this program stood still is not counted: what came meanwhile waits to be read.
        """
        waited_s = 0.0
        while not condition():
            await self.check_alive()
            if waited_s >= timeout_s:
                return False
            waited_s += await _polled()
        return True

    async def check_alive(self) -> None:
        """Raise when closed, when telemetry could not be understood or the newest heartbeat is too
        old.

        A program that stood still finds old heartbeats first: those that wait for it are read
        before it judges.
        """
        limit_s = self._config.heartbeat_timeout_s
        end_s = time.monotonic() + SECOND_LOOK_S
        while (age_s := self._heartbeat_age_s()) > limit_s:
            if time.monotonic() >= end_s:
                raise VehicleError(
                    f"heartbeat of vehicle {self._config.sysid} lost on {self._config.url} ({age_s:.1f} s old)",
                    "the autopilot now flies on its own failsafe; check cable or radio",
                )
            await asyncio.sleep(POLL_S)

    def _heartbeat_age_s(self) -> float:
        self._telemetry.check()
        heartbeat = self._telemetry.heartbeat
        if self._direct is None or heartbeat is None:
            raise VehicleError(
                f"{self._config.url} is not open", "enter the vehicle with `async with` first"
            )
        return (self._clock.now_ns() - heartbeat.arrival_ns) * 1e-9

    def send(self, name: str, fields: dict[str, Any]) -> None:
        """Send one message once, addressed to the autopilot. None becomes NaN."""
        direct = self._direct
        config = self._config
        if direct is None:
            raise VehicleError(
                f"{config.url} is not open", "enter the vehicle with `async with` first"
            )
        fields = {"target_system": config.sysid, "target_component": AUTOPILOT_COMPONENT, **fields}
        message = MavlinkMessage(
            name,
            config.own_sysid,
            config.own_compid,
            config.sysid,
            AUTOPILOT_COMPONENT,
            json.dumps(fields),
        )
        try:
            direct.send_message(message)
        except (MavsdkError, RuntimeError) as error:
            raise VehicleError(
                f"cannot send {name} on {config.url}: {error}", "check cable or radio"
            ) from error

    def boot_ms(self) -> int:
        return int((time.monotonic() - self._start_s) * 1e3) & 0xFFFFFFFF

    async def command(
        self, command: int, params: Sequence[float | None], tries: int = 1
    ) -> int | None:
        """Send COMMAND_LONG and wait for its final acknowledgement.

        Args:
            command: MAV_CMD number.
            params: param1 to at most param7; None and what is missing go as the autopilot's
                "unset".
            tries: 1 for everything that starts motion.

        Returns:
            The MAV_RESULT, or None when no acknowledgement came: whether it was carried out is then
            unknown.
        """
        kind = self._telemetry.kind
        unset = kind.unset if kind else None
        filled = [*params, *([unset] * (7 - len(params)))]
        if command == ARM_DISARM and filled[1] == FORCE_DISARM_MAGIC:
            # it stops the motors in the air
            raise VehicleError("forced arming or disarming is never sent")
        fields: dict[str, Any] = {f"param{index}": value for index, value in enumerate(filled, 1)}
        telemetry = self._telemetry
        for confirmation in range(tries):
            telemetry.acks.pop(command, None)
            self.send("COMMAND_LONG", {"command": command, "confirmation": confirmation, **fields})
            # not counting time in which this program stood still
            left_s = self._config.command_timeout_s
            while left_s > 0.0:
                await self.check_alive()
                ack = telemetry.acks.get(command)
                if ack is not None and ack.result != IN_PROGRESS:
                    return ack.result
                # the vehicle is at it: it has until three seconds after saying so
                if ack is not None:
                    left_s = max(left_s, 3.0 - (self._clock.now_ns() - ack.arrival_ns) * 1e-9)
                left_s -= await _polled()
        return None

    async def set_float_parameter(self, name: str, value: float) -> None:
        """Set a REAL32 parameter and wait until the vehicle says it has it."""
        for _ in range(3):
            self._telemetry.parameter = None
            self.send("PARAM_SET", {"param_id": name, "param_value": value, "param_type": REAL32})
            if await self.until(
                lambda: self._parameter_is(name, value), self._config.command_timeout_s
            ):
                return
        raise VehicleError(
            f"the vehicle did not take parameter {name} = {value}",
            "is it the right kind of autopilot?",
        )

    def _parameter_is(self, name: str, value: float) -> bool:
        parameter = self._telemetry.parameter
        close = parameter is not None and math.isclose(
            parameter.value, value, rel_tol=1e-6, abs_tol=1e-6
        )
        return parameter is not None and parameter.name == name and close

    async def _find_system(self) -> Any:
        config = self._config
        end_s = time.monotonic() + config.connect_timeout_s
        heard: set[int] = set()
        while True:
            for system in self._mavsdk.get_systems():
                heard.add(system.get_system_id())
                if system.get_system_id() == config.sysid and system.has_autopilot():
                    return system
            if time.monotonic() >= end_s:
                break
            await asyncio.sleep(2 * POLL_S)
        if heard:
            others = ", ".join(str(sysid) for sysid in sorted(heard))
            raise VehicleError(
                f"vehicle {config.sysid} is not on {config.url}: in {config.connect_timeout_s:g} s heard only {others}",
                f"set sysid = {min(heard)} in the rig, or MAV_SYS_ID (SYSID_THISMAV) of the vehicle to {config.sysid}",
            )
        raise VehicleError(
            f"no heartbeat on {config.url} in {config.connect_timeout_s:g} s",
            "is the vehicle powered, and does it send MAVLink to this address and port?",
        )

    def _identify(self) -> AutopilotKind:
        config = self._config
        heartbeat = self._telemetry.heartbeat
        if heartbeat is None:
            raise VehicleError(
                f"heartbeats of vehicle {config.sysid} stopped on {config.url} while connecting",
                "check cable or radio",
            )
        kind = next((kind for kind in KINDS if kind.mav_autopilot == heartbeat.autopilot), None)
        if kind is None:
            raise VehicleError(
                f"vehicle {config.sysid} on {config.url} is neither PX4 nor ArduPilot (MAV_AUTOPILOT "
                f"{heartbeat.autopilot})",
                "only these two are flown",
            )
        if config.autopilot not in ("auto", kind.name):
            raise VehicleError(
                f"vehicle {config.sysid} on {config.url} is {kind.name}, the rig says {config.autopilot}",
                f'set autopilot = "{kind.name}" (or "auto"), or connect the other vehicle',
            )
        return kind


async def _polled() -> float:
    """Wait for POLL_S; return how long that was, s, as far as this program did not stand still."""
    begun_s = time.monotonic()
    await asyncio.sleep(POLL_S)
    return min(time.monotonic() - begun_s, LONGEST_POLL_S)


async def _destroy(parts: Sequence[Any]) -> None:
    """Destroys MAVSDK's parts in this order. It joins its threads here without a bound, so it is
    watched from outside.

    MAVSDK would end its plugins too, but not those that the garbage collector has come to know as
    unreachable: they would be ended by it in another thread at the same time, which aborts the
    process.
    """

    def destroy() -> None:
        for part in parts:
            part.destroy()

    thread = threading.Thread(target=destroy, name="mavsdk-destroy", daemon=True)
    thread.start()
    end_s = time.monotonic() + CLOSE_S
    while thread.is_alive():
        if time.monotonic() >= end_s:
            raise VehicleError(
                f"MAVSDK did not close within {CLOSE_S:g} s",
                "end this process before the next flight",
            )
        await asyncio.sleep(POLL_S)


def _to_python_log(
    level: mavsdk_logging.LogLevel, message: str, _file: str | None, _line: int
) -> bool:
    _log.log(
        logging.WARNING if level >= mavsdk_logging.LogLevel.ERROR else logging.DEBUG, "%s", message
    )
    return True
