"""The embedded MAVLink vehicle on a raw socket, pumped in simulated time."""

import math
import socket
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from hil.autopilot.autopilot import AutopilotConfig
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import HomeConfig
from path.messages import Role
from tests.exact_world import QUICK, exact_world

SYSID = 7
START = (3.0, -2.0, -0.1)  # not the mission's origin: local and mission frames must not be mixed up
HOME = HomeConfig(position_m=(START[1], START[0]))
TANGENT = LocalTangent(47.4, 8.5, 480.0)
STEP_S = 0.005


class Bench:
    """A vehicle and a ground station's socket, both in simulated time."""

    def __init__(
        self, config: AutopilotConfig = QUICK, arrived: Callable[[float], float] | None = None
    ) -> None:
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(("127.0.0.1", 0))
        self.ground.settimeout(0.0)
        self.world = exact_world(config, sender_home=HOME)
        self.drone = self.world.drone(Role.SENDER)
        on_wire = MavlinkVehicleConfig(SYSID, self.ground.getsockname())
        self.vehicle = MavlinkVehicle(on_wire, self.drone, TANGENT, arrived)
        self.mav: Any = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        self.now_s = 0.0
        self.heard: list[tuple[float, Any]] = []

    def close(self) -> None:
        self.vehicle.close()
        self.ground.close()

    def run(self, duration_s: float, each: Callable[[], None] = lambda: None) -> None:
        """Step and pump; ``each`` runs before every step."""
        for _ in range(round(duration_s / STEP_S)):
            each()
            self.now_s += STEP_S
            self.world.advance(self.now_s)
            self.vehicle.pump(self.now_s)
            self.listen()

    def listen(self) -> None:
        while True:
            try:
                packet = self.ground.recv(2048)
            except BlockingIOError:
                return
            self.heard += [(self.now_s, message) for message in self.mav.parse_buffer(packet) or ()]

    def send(self, message: Any) -> None:
        self.send_raw(message.pack(self.mav))

    def send_raw(self, packet: bytes) -> None:
        self.ground.sendto(packet, self.vehicle.address)

    def of(self, kind: str) -> list[Any]:
        return [message for _, message in self.heard if message.get_type() == kind]

    def command(self, command: int, *params: float, target: int = SYSID) -> int | None:
        """The MAV_RESULT, None without an answer."""
        self.heard.clear()
        filled = [*params, *([math.nan] * (7 - len(params)))]
        self.send(mavlink.MAVLink_command_long_message(target, 1, command, 0, *filled))
        self.run(STEP_S)
        return next((ack.result for ack in self.of("COMMAND_ACK") if ack.command == command), None)

    def setpoint(
        self, velocity: tuple[float, float, float], mask: int = 2503, **fields: float
    ) -> None:
        at = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0, "yaw_rate": 0.0, "frame": 1, **fields}
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, SYSID, 1, int(at["frame"]), mask, at["x"], at["y"], at["z"], *velocity, 0.0, 0.0, 0.0, at["yaw"],
                at["yaw_rate"],
            )
        )  # fmt: skip

    def fly_at(self, height_m: float = 0.8) -> None:
        self.run(0.5)
        self.send(mavlink.MAVLink_param_set_message(SYSID, 1, b"MIS_TAKEOFF_ALT", height_m, 9))
        assert (
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0)
            == mavlink.MAV_RESULT_ACCEPTED
        )
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_ACCEPTED
        self.run(4.0)
        assert self.drone.autopilot.mode is FlightMode.HOLD
        assert not self.drone.autopilot.landed
