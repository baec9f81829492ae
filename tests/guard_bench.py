"""A flying embedded vehicle with two MAVLink ports, and what a hung role's MAVSDK would go on
sending to the first.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode, VelocitySetpoint
from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.parts import Origin
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import AltitudeConfig
from path.messages import Role
from tests.exact_world import QUICK, exact_world
from tests.free_ports import free_port
from tests.steady_time import SteadyTime

SYSID = 1
ORIGIN = Origin(47.3977, 8.5456, 488.0)
# Its own failsafe for setpoints is as good as off: whatever happens is the guard's doing.
SLOW_TO_GIVE_UP = replace(QUICK, offboard_loss_s=300.0)
LIMIT_S = 60.0
STEP_S = 0.005
SETPOINT_STEPS = 10  # 20 Hz
RIGHT = AltitudeConfig()
FORWARD = VelocitySetpoint((0.05, 0.0, 0.0), 0.0)


class Bench:
    """Stepped by a thread; everything that touches the world takes ``lock``."""

    def __init__(
        self,
        speed: float = 1.0,
        key: bytes | None = None,
        altitude_off_m: float = 0.0,
        altitude: AltitudeConfig = RIGHT,
    ) -> None:
        self._speed = speed
        self.world = exact_world(SLOW_TO_GIVE_UP, altitude=altitude)
        self.flown = FORWARD
        self.drone = self.world.drone(Role.SENDER)
        self.lock = threading.Lock()
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(("127.0.0.1", 0))
        self.ground.setblocking(False)
        self.port = free_port()
        tangent = LocalTangent(
            ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m + altitude_off_m
        )
        config = MavlinkVehicleConfig(
            SYSID, self.ground.getsockname(), second=("127.0.0.1", self.port), key=key
        )
        self.vehicle = MavlinkVehicle(config, self.drone, tangent)
        self.vehicle.tap = lambda _, message: self.wire.append(message)
        self.wire: list[Any] = []
        self.repeating = True  # setpoints, as MAVSDK's own thread does whatever Python does
        self._mav: Any = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)

    @property
    def autopilot(self) -> Any:
        return self.drone.autopilot

    def run(self, stop: threading.Event) -> None:
        passed, steps = SteadyTime(self._speed), 0
        while not stop.wait(STEP_S):
            steps += 1
            with self.lock:
                self.world.advance(passed.now_s())
                self.vehicle.pump(self.world.time_s)
            if self.repeating and steps % SETPOINT_STEPS == 0:
                self._setpoint()
            self._drain()

    def _setpoint(self) -> None:
        north, east, down = self.flown.velocity_n_mps
        message = mavlink.MAVLink_set_position_target_local_ned_message(
            0, SYSID, 1, 1, 2503, 0, 0, 0, north, east, down, 0, 0, 0, FORWARD.yaw_rad, 0
        )
        self.ground.sendto(message.pack(self._mav), self.vehicle.address)

    def _drain(self) -> None:
        while True:
            try:
                self.ground.recv(2048)
            except BlockingIOError:
                return

    def in_air(self, by_setpoints: bool = True) -> None:
        """Armed, climbed, in offboard control; without setpoints it holds."""
        until(lambda: self.autopilot.armable)
        with self.lock:
            now_s = self.world.time_s
            assert self.autopilot.request_arm(now_s, True).accepted
            assert self.autopilot.request_takeoff(now_s, 1.0).accepted
        until(lambda: self.autopilot.mode is FlightMode.HOLD and not self.autopilot.landed)
        if by_setpoints:
            self.select(FlightMode.OFFBOARD)

    def select(self, mode: FlightMode, by_pilot: bool = False) -> None:
        with self.lock:
            assert self.autopilot.request_mode(self.world.time_s, mode, by_pilot).accepted

    def commands(self, *numbers: int) -> list[int]:
        """Commands that reached the vehicle, of these numbers, in order."""
        return [
            m.command for m in self.wire if m.get_type() == "COMMAND_LONG" and m.command in numbers
        ]


@contextmanager
def bench(
    speed: float = 1.0,
    key: bytes | None = None,
    altitude_off_m: float = 0.0,
    altitude: AltitudeConfig = RIGHT,
) -> Generator[Bench]:
    """The vehicle's time runs ``speed`` times as fast as ours; with a ``key`` it signs, and takes
    what is signed.

    ``altitude_off_m``: of what it takes for its altitude above sea level; ``altitude``: the same,
    and how it moves.
    """
    own, stop = Bench(speed, key, altitude_off_m, altitude), threading.Event()
    thread = threading.Thread(target=own.run, args=(stop,))
    thread.start()
    try:
        yield own
    finally:
        stop.set()
        thread.join()
        own.vehicle.close()
        own.ground.close()


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, "a condition did not come true"
        time.sleep(0.005)
