"""The MAVSDK driver over loopback against a scripted ArduCopter, as far as its own rules on the
wire go.
"""

import asyncio
import math
import socket
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode, VehicleError
from drivers.mavlink.session import ARM_DISARM
from tests.drivers.mavlink.mavsdk_bench import (
    LIMIT_S,
    STILL,
    SYSID,
    Wire,
    stepped,
    until,
    vehicle_at,
)
from tests.free_ports import free_port


class ArduCopter:
    """Answers as ArduCopter would. It flies only up and down, and not at all when ``deaf`` to a
    command.

    Every rate must be asked for, arming and take-off want GUIDED, the height is param7, BRAKE is
    its hold.
    """

    def __init__(self, port: int, wire: Wire) -> None:
        self._remote = ("127.0.0.1", port)
        self._wire = wire
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._mav: Any = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        self._due_s: dict[int, float] = {0: 0.0}
        self._interval_s: dict[int, float] = {0: 0.5}
        self._last_s = 0.0
        self.deaf: set[int] = set()
        self.mode = 5  # LOITER
        self.armed = False
        self.height_m = 0.0
        self.goal_m = 0.0

    def close(self) -> None:
        self._socket.close()

    def pump(self, now_s: float) -> None:
        step_m, self._last_s = 1.5 * (now_s - self._last_s), now_s
        if self.mode == 9:
            self.goal_m = 0.0
            self.armed = self.armed and self.height_m > 0.0
        self.height_m += max(-step_m, min(step_m, self.goal_m - self.height_m))
        while True:
            try:
                packet, _ = self._socket.recvfrom(2048)
            except BlockingIOError:
                break
            for message in self._mav.parse_buffer(packet) or ():
                self._wire.tap(now_s, message)
                if message.get_type() == "COMMAND_LONG" and message.command not in self.deaf:
                    self._send(
                        mavlink.MAVLink_command_ack_message(
                            message.command, self._command(message, now_s)
                        )
                    )
                elif message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    self._send(
                        mavlink.MAVLink_timesync_message(round(now_s * 1e9) + 1, message.ts1)
                    )
        for message_id, due_s in self._due_s.items():
            if now_s >= due_s:
                self._due_s[message_id] = now_s + self._interval_s[message_id]
                self._send(self._telemetry(message_id, int(now_s * 1e3)))

    def say(self, text: str) -> None:
        self._send(mavlink.MAVLink_statustext_message(6, text.encode()))

    def _command(self, message: Any, now_s: float) -> int:
        guided, what = self.mode == 4, message.command
        if what == 511:
            if self._telemetry(int(message.param1), 0) is None:
                return mavlink.MAV_RESULT_DENIED
            self._interval_s[int(message.param1)] = message.param2 * 1e-6
            self._due_s[int(message.param1)] = now_s
        elif what == 176:
            self.mode = int(message.param2)
        elif what == 400:
            if not guided:
                self._send(mavlink.MAVLink_statustext_message(2, b"Arm: mode not armable"))
                return mavlink.MAV_RESULT_FAILED
            self.armed = message.param1 == 1.0
        elif what == 22:
            if not (guided and self.armed):
                return mavlink.MAV_RESULT_FAILED
            self.goal_m = message.param7
        elif what == 21:
            self.mode = 9
        elif what == 512:
            made = self._telemetry(int(message.param1), 0)
            return (
                mavlink.MAV_RESULT_ACCEPTED if made is not None else mavlink.MAV_RESULT_UNSUPPORTED
            )
        return mavlink.MAV_RESULT_ACCEPTED

    def _telemetry(self, message_id: int, boot_ms: int) -> Any:
        position = (474_000_000, 85_000_000, round(480_000 + 1e3 * self.height_m))
        healthy = 0x1000_003F
        made: dict[int, Callable[[], Any]] = {
            0: lambda: mavlink.MAVLink_heartbeat_message(
                2, 3, 1 | 128 * self.armed, self.mode, 4, 3
            ),
            1: lambda: mavlink.MAVLink_sys_status_message(
                healthy, healthy, healthy, 0, 16_000, 0, 80, 0, 0, 0, 0, 0, 0
            ),
            24: lambda: mavlink.MAVLink_gps_raw_int_message(
                boot_ms * 1000, 3, *position, 80, 80, 0, 0, 12
            ),
            31: lambda: mavlink.MAVLink_attitude_quaternion_message(
                boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            ),
            32: lambda: mavlink.MAVLink_local_position_ned_message(
                boot_ms, 0.0, 0.0, -self.height_m, 0.0, 0.0, 0.0
            ),
            33: lambda: mavlink.MAVLink_global_position_int_message(
                boot_ms, *position, round(1e3 * self.height_m), 0, 0, 0, 0
            ),
            242: lambda: mavlink.MAVLink_home_position_message(
                474_000_000, 85_000_000, 480_000, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
            ),
            245: lambda: mavlink.MAVLink_extended_sys_state_message(
                0, 2 if self.height_m > 0.0 else 1
            ),
        }
        return made[message_id]() if message_id in made else None

    def _send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._mav), self._remote)
        self._mav.seq = (self._mav.seq + 1) % 256


def test_arducopter_is_guided_before_it_arms_and_brakes_to_hold() -> None:
    async def fly(copter: ArduCopter, port: int, wire: Wire) -> None:
        async with vehicle_at(port, command_timeout_s=1.0, rc="none") as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert vehicle.state.mode is FlightMode.OTHER
            assert vehicle.state.battery == pytest.approx(0.8)
            copter.deaf = {ARM_DISARM}
            with pytest.raises(VehicleError, match=r"no answer to the command to arm: .* unknown"):
                await vehicle.arm()
            assert len(wire.commands(ARM_DISARM)) == 1  # never a second time
            copter.deaf = set()
            await vehicle.arm()
            await vehicle.take_off(1.2, LIMIT_S)
            assert copter.height_m == pytest.approx(1.2, abs=0.31)
            await vehicle.start_offboard(STILL)
            await vehicle.hold()
            assert copter.mode == 17
            copter.deaf = {mavlink.MAV_CMD_NAV_LAND}
            with pytest.raises(VehicleError, match="no answer to the command to land"):
                await vehicle.land(LIMIT_S)
            landings = wire.commands(mavlink.MAV_CMD_NAV_LAND)
            # what ends motion is resent
            assert [message.confirmation for message in landings] == [0, 1, 2]
            copter.deaf = set()
            await vehicle.land(LIMIT_S)
            assert not copter.armed

    wire, port = Wire(), free_port()
    copter = ArduCopter(port, wire)
    with stepped(copter, None, wire):
        asyncio.run(fly(copter, port, wire))
    modes = [int(message.param2) for message in wire.commands(176)]
    assert modes == [4, 4, 4, 17]  # twice to arm, once for offboard, once to hold
    assert [message.param7 for message in wire.commands(22)] == [pytest.approx(1.2)]
    sent = [message for message in wire.of("COMMAND_LONG") if message.command in (21, 22, 176, 400)]
    assert all(math.isfinite(message.param4) for message in sent)  # ArduPilot takes unset as 0
    assert wire.of("PARAM_SET") == []


def test_arducopters_emergency_stop_is_heard_from_its_text() -> None:
    async def fly(copter: ArduCopter, port: int) -> None:
        async with vehicle_at(port, rc="none") as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            copter.say("RC5: FlightMode HIGH")
            copter.say("RC7: MotorEStop HIGH")
            await until(lambda: not vehicle.state.armed)
            assert copter.armed  # and so it says for 5 s
            copter.say("RC7: MotorEStop LOW")
            await until(lambda: vehicle.state.armed)
            copter.say("RC7: MotorEStop HIGH")
            await until(lambda: not vehicle.state.armed)
            copter.armed = False
            await until(lambda: vehicle.state.armed_told > 3)
            copter.armed = True  # a new flight
            await until(lambda: vehicle.state.armed)

    wire, port = Wire(), free_port()
    copter = ArduCopter(port, wire)
    with stepped(copter, None, wire):
        asyncio.run(fly(copter, port))
