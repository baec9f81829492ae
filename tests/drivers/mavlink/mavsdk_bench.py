"""The embedded PX4-like vehicle in a thread, in real time or faster, and the driver that reaches it
over loopback.
"""

import asyncio
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from drivers.interfaces import VelocitySetpoint
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.vehicle import MavsdkVehicle, MavsdkVehicleConfig
from drivers.rig.parts import Mount, Origin, PartContext
from hil.autopilot.autopilot import AutopilotConfig
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import AltitudeConfig, HomeConfig
from hil.world.world import SimDrone, World
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.messages import Role
from tests.exact_world import QUICK, exact_world
from tests.free_ports import free_port
from tests.steady_time import SteadyTime

SYSID = 7
HOME = HomeConfig(position_m=(-2.0, 3.0))  # east, north: not the mission's origin
ORIGIN = Origin(47.4, 8.5, 480.0)
TANGENT = LocalTangent.at(ORIGIN)
HEIGHT_M = 0.8
STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
LIMIT_S = 60.0


AHEAD_NS = 10**12


class LoopClock:
    """A role clock that is not the computer's and can be read in the event loop only."""

    def now_ns(self) -> int:
        return AHEAD_NS + round(asyncio.get_running_loop().time() * 1e9)


IDENTITY = Pose(np.eye(3), np.zeros(3))
CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (0.0, 0.0, 0.0, 0.0, 0.0))
CONTEXT = PartContext(
    Role.SENDER,
    LoopClock(),
    CAMERA,
    Mount(IDENTITY, IDENTITY),
    layout=cast(Any, None),
    origin=ORIGIN,
)


class Endpoint(Protocol):
    def pump(self, now_s: float) -> None: ...

    def close(self) -> None: ...


class Wire:
    """Every message that reached the vehicle."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def tap(self, _now_s: float, message: Any) -> None:
        self.messages.append(message)

    def of(self, kind: str) -> list[Any]:
        return [message for message in self.messages if message.get_type() == kind]

    def commands(self, command: int) -> list[Any]:
        return [message for message in self.of("COMMAND_LONG") if message.command == command]

    def assert_no_force(self) -> None:
        assert all(message.param2 != 21196.0 for message in self.commands(400))


@contextmanager
def stepped(
    endpoint: Endpoint, world: World | None, wire: Wire, speed: float = 1.0
) -> Generator[None]:
    stop = threading.Event()

    def run() -> None:
        passed = SteadyTime(speed)
        while not stop.wait(0.004):
            now_s = passed.now_s()
            if world is not None:
                world.advance(now_s)
            endpoint.pump(now_s)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        endpoint.close()
        wire.assert_no_force()


class Bench:
    """The embedded vehicle in a thread, and the configuration that reaches it."""

    def __init__(self, endpoint: MavlinkVehicle, drone: SimDrone, wire: Wire, port: int) -> None:
        self.endpoint = endpoint
        self.drone = drone
        self.autopilot = drone.autopilot
        self.wire = wire
        self.port = port

    def vehicle(self, **options: Any) -> MavsdkVehicle:
        return vehicle_at(self.port, **options)


def vehicle_at(port: int, **options: Any) -> MavsdkVehicle:
    settings: dict[str, Any] = {
        "url": f"udpin://127.0.0.1:{port}",
        "sysid": SYSID,
        # this and all others: of a machine that is busy with something else
        "heartbeat_timeout_s": 3.0,
        "connect_timeout_s": 60.0,
        "command_timeout_s": 10.0,
        **options,
    }
    return MavsdkVehicle(MavsdkVehicleConfig(**settings), CONTEXT)


@contextmanager
def px4(
    config: AutopilotConfig = QUICK,
    speed: float = 1.0,
    port: int | None = None,
    gps_off_m: float = 0.0,
) -> Generator[Bench]:
    """The vehicle's time runs ``speed`` times as fast as ours. It speaks to ``port``, or one that
    is free.

    ``gps_off_m``: of the altitude that it tells.
    """
    world = exact_world(config, sender_home=HOME, altitude=AltitudeConfig(offset_m=gps_off_m))
    wire, port, drone = Wire(), port or free_port(), world.drone(Role.SENDER)
    endpoint = MavlinkVehicle(MavlinkVehicleConfig(SYSID, ("127.0.0.1", port)), drone, TANGENT)
    endpoint.tap = wire.tap
    with stepped(endpoint, world, wire, speed):
        yield Bench(endpoint, drone, wire, port)


async def until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not condition():
            each()
            await asyncio.sleep(0.02)


async def into_the_air(vehicle: MavsdkVehicle) -> None:
    await vehicle.wait_armable(LIMIT_S)
    await vehicle.arm()
    await vehicle.take_off(HEIGHT_M, LIMIT_S)


def threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))
