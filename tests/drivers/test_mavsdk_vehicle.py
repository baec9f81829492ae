"""The MAVSDK driver over loopback, in real time: against the embedded PX4-like vehicle and a scripted ArduCopter."""

import asyncio
import gc
import math
import socket
import threading
import time
import weakref
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import pytest
from mavsdk.mavsdk import Mavsdk
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint
from drivers.mavsdk_geodesy import ECCENTRICITY_SQUARED, SEMI_MAJOR_M, LocalTangent
from drivers.mavsdk_modes import ARDUPILOT, PX4
from drivers.mavsdk_port import PortLock
from drivers.mavsdk_session import ARM_DISARM
from drivers.mavsdk_telemetry import Telemetry, ThreadClock
from drivers.mavsdk_vehicle import MavsdkVehicle, MavsdkVehicleConfig
from drivers.rig import Mount, Origin, PartContext
from hil.autopilot import AutopilotConfig
from hil.estimator import EstimatorConfig, WindConfig
from hil.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world import HomeConfig, SimDrone, World, WorldConfig
from path.camera import CameraModel
from path.geometry import Pose
from path.messages import Role
from path.rotation import yaw_of

SYSID = 7
HOME = HomeConfig(position_m=(-2.0, 3.0))  # east, north: not the mission's origin
ORIGIN = Origin(47.4, 8.5, 480.0)
TANGENT = LocalTangent(ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m)
QUICK = AutopilotConfig(settle_s=0.2, spool_s=0.1, climb_mps=1.5, land_mps=1.0, touchdown_mps=0.8, land_disarm_s=0.2)
HEIGHT_M = 0.8
STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
LIMIT_S = 15.0


AHEAD_NS = 10**12


class LoopClock:
    """A role clock that is not the computer's and can be read in the event loop only."""

    def now_ns(self) -> int:
        return AHEAD_NS + round(asyncio.get_running_loop().time() * 1e9)


IDENTITY = Pose(np.eye(3), np.zeros(3))
CAMERA = CameraModel(640, 480, 615.0, 615.0, 320.0, 240.0, (0.0, 0.0, 0.0, 0.0, 0.0))
CONTEXT = PartContext(
    Role.SENDER, LoopClock(), CAMERA, Mount(IDENTITY, IDENTITY), layout=cast(Any, None), origin=ORIGIN
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
def stepped(endpoint: Endpoint, world: World | None, wire: Wire, speed: float = 1.0) -> Generator[None]:
    stop = threading.Event()

    def run() -> None:
        start_s = time.monotonic()
        while not stop.wait(0.004):
            now_s = speed * (time.monotonic() - start_s)
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
        "heartbeat_timeout_s": 1.0,
        **options,
    }
    return MavsdkVehicle(MavsdkVehicleConfig(**settings), CONTEXT)


@contextmanager
def px4(config: AutopilotConfig = QUICK, speed: float = 1.0) -> Generator[Bench]:
    """The vehicle's time runs ``speed`` times as fast as ours."""
    exact = EstimatorConfig(**dict.fromkeys(EstimatorConfig.__slots__, 0.0))
    calm = WindConfig(0.0, gust_mps=0.0)
    world = World(WorldConfig(calm, exact, autopilot=config, sender_home=HOME), seed=1)
    wire, port, drone = Wire(), free_port(), world.drone(Role.SENDER)
    endpoint = MavlinkVehicle(MavlinkVehicleConfig(SYSID, ("127.0.0.1", port)), drone, TANGENT)
    endpoint.tap = wire.tap
    with stepped(endpoint, world, wire, speed):
        yield Bench(endpoint, drone, wire, port)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


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


# --- flights ---


def test_a_flight_from_arming_to_landing() -> None:
    async def fly(bench: Bench) -> None:
        before = threads()
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert not vehicle.state.armed
            assert abs(LoopClock().now_ns() - vehicle.state.stamp_ns) < 1_000_000_000
            await vehicle.arm()
            assert vehicle.state.armed
            await vehicle.take_off(HEIGHT_M, LIMIT_S)
            state = vehicle.state
            assert (state.mode, state.in_air) == (FlightMode.HOLD, True)
            assert state.position_n_m == pytest.approx((3.0, -2.0, -0.1 - HEIGHT_M), abs=0.32)
            with pytest.raises(VehicleError, match="not finite"):
                vehicle.fly(VelocitySetpoint((0.0, math.nan, 0.0), 0.0))
            await vehicle.start_offboard(STILL)
            assert vehicle.state.mode is FlightMode.OFFBOARD
            for north, east in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
                await square_leg(vehicle, north, east)
            q_n_b = vehicle.attitude_at(vehicle.state.stamp_ns)
            assert yaw_of(q_n_b) == pytest.approx(0.5, abs=0.02)
            await vehicle.hold()
            assert vehicle.state.mode is FlightMode.HOLD
            await vehicle.land(LIMIT_S)
            assert not vehicle.state.armed
            await vehicle.land(LIMIT_S)  # nothing to do
        assert threads() == before
        with pytest.raises(VehicleError, match="not open"):
            vehicle.fly(STILL)

    with px4() as bench:
        asyncio.run(fly(bench))
        assert not bench.autopilot.armed
        assert bench.autopilot.setpoint_gap_s < QUICK.offboard_loss_s
        wire = bench.wire
    for command, times in ((mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1), (mavlink.MAV_CMD_NAV_TAKEOFF, 1)):
        assert len(wire.commands(command)) == times
    assert {(sp.type_mask, sp.coordinate_frame) for sp in wire.of("SET_POSITION_TARGET_LOCAL_NED")} == {(2503, 1)}
    assert all(math.isfinite(sp.vy) for sp in wire.of("SET_POSITION_TARGET_LOCAL_NED"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", bench.port))  # the port is free again


def test_height_may_be_reckoned_from_home() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle(height_from="home") as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert vehicle.state.position_n_m[2] == pytest.approx(0.0, abs=0.02)  # its origin is 0.1 m over the ground

    with px4() as bench:
        asyncio.run(fly(bench))


async def square_leg(vehicle: MavsdkVehicle, north: float, east: float) -> None:
    """Fly 0.3 m in one direction, by the vehicle's own telemetry."""
    n, e, _ = vehicle.state.position_n_m
    setpoint = VelocitySetpoint((0.6 * north, 0.6 * east, 0.0), 0.5)

    def there() -> bool:
        at = vehicle.state.position_n_m
        return (at[0] - n) * north + (at[1] - e) * east > 0.3

    await until(there, lambda: vehicle.fly(setpoint))
    velocity = vehicle.state.velocity_n_mps
    assert velocity[0] * north + velocity[1] * east > 0.3


def test_when_python_hangs_the_setpoints_stop_and_the_vehicle_lands() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            await into_the_air(vehicle)
            await vehicle.start_offboard(STILL)
            await until(
                lambda: bench.drone.estimate.velocity_n_mps[0] > 0.25,
                lambda: vehicle.fly(VelocitySetpoint((0.3, 0.0, 0.0), 0.0)),
            )
            sent = len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED"))
            end_s = time.monotonic() + LIMIT_S
            while bench.autopilot.armed and time.monotonic() < end_s:
                time.sleep(0.01)  # noqa: ASYNC251 (this is the hang)
            assert len(bench.wire.of("SET_POSITION_TARGET_LOCAL_NED")) - sent <= 1
            await until(lambda: not vehicle.state.armed)

    with px4() as bench:
        asyncio.run(fly(bench))
        modes = [session.ended_by for session in bench.autopilot.offboard_sessions]
        texts = [text.text for text in bench.autopilot.status_texts]
    assert modes == [FlightMode.HOLD]
    assert "No offboard setpoints, landing" in texts


def test_the_pilot_and_a_lost_link_end_every_wait() -> None:
    async def fly(bench: Bench) -> None:
        autopilot, endpoint = bench.autopilot, bench.endpoint
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            await vehicle.arm()
            climb = asyncio.create_task(vehicle.take_off(HEIGHT_M, LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.TAKEOFF)
            autopilot.request_mode(bench.drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            with pytest.raises(VehicleError, match="take-off ended on the way: mode other"):
                await climb
            await vehicle.hold()
            landing = asyncio.create_task(vehicle.land(LIMIT_S))
            await until(lambda: vehicle.state.mode is FlightMode.LAND)
            autopilot.request_mode(bench.drone.estimate.time_s, FlightMode.OTHER, by_pilot=True)
            with pytest.raises(VehicleError, match="landing ended by a change to mode other"):
                await landing
            endpoint.silent = True
            seen_ns = vehicle.state.stamp_ns
            with pytest.raises(VehicleError, match=rf"heartbeat of vehicle {SYSID} lost"):
                await vehicle.hold()
            state = vehicle.state  # still answers, and shows its age
            assert LoopClock().now_ns() - state.heartbeat_ns > 1_000_000_000
            assert state.stamp_ns - seen_ns < 500_000_000
            endpoint.silent = False
            await until(lambda: LoopClock().now_ns() - vehicle.state.heartbeat_ns < 300_000_000)
            await vehicle.land(LIMIT_S)

    with px4() as bench:
        asyncio.run(fly(bench))


# --- closing ---


def test_closing_ends_the_plugins_before_mavsdk_however_the_garbage_collector_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A plugin that the collector ends in one thread while MAVSDK ends in another takes the process down."""
    alive: list[bool] = []
    destroy = Mavsdk.destroy

    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            session = vehicle._session
            assert session.parameters is not None
            plugins = [weakref.ref(plugin) for plugin in (session._plugin, session._direct, session.parameters._plugin)]

            def collected_before(mavsdk: Mavsdk) -> None:
                gc.collect()
                alive.extend(plugin() is not None for plugin in plugins)
                destroy(mavsdk)

            monkeypatch.setattr(Mavsdk, "destroy", collected_before)

    with px4() as bench:
        asyncio.run(fly(bench))
    assert alive == [True, True, True]


def test_closing_waits_for_a_parameter_that_is_being_read() -> None:
    """A read blocks in MAVSDK in a thread of its own, which cancelling does not end."""

    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            session = vehicle._session
            assert session.parameters is not None
            plugin = session.parameters._plugin
            get, reading, ended = plugin.get_param_int, threading.Event(), threading.Event()

            def watched(name: str) -> int:
                reading.set()
                try:
                    return get(name)
                finally:
                    ended.set()

            plugin.get_param_int = watched
            read = asyncio.create_task(session.parameters.read(["NOT_THERE"]))
            await until(reading.is_set)
            read.cancel()
            destroyed_after_it: list[bool] = []
            destroy = plugin.destroy

            def watched_destroy() -> None:
                destroyed_after_it.append(ended.is_set())
                destroy()

            plugin.destroy = watched_destroy
        assert destroyed_after_it[0]

    with px4() as bench:
        asyncio.run(fly(bench))


# --- refusals ---


def test_a_refused_arm_says_why() -> None:
    async def fly(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            with pytest.raises(VehicleError, match=r"not ready to arm after 0\.2 s: waiting for arming checks"):
                await vehicle.wait_armable(0.2)
            with pytest.raises(VehicleError, match=r"refused to arm \(denied\): Arming denied: compass inconsistent"):
                await vehicle.arm()
            with pytest.raises(VehicleError, match="not armed"):
                await vehicle.take_off(HEIGHT_M, LIMIT_S)
            with pytest.raises(VehicleError, match="never sent"):
                await vehicle._session.command(ARM_DISARM, (0.0, 21196.0))

    with px4(AutopilotConfig(settle_s=0.2, arming_fault="compass inconsistent")) as bench:
        asyncio.run(fly(bench))
        assert len(bench.wire.commands(ARM_DISARM)) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sysid": SYSID + 1, "connect_timeout_s": 0.8}, rf"vehicle {SYSID + 1} is not on .*heard only {SYSID}"),
        ({"autopilot": "ardupilot"}, "is px4, the rig says ardupilot"),
    ],
)
def test_the_wrong_vehicle_is_refused_and_the_port_given_back(options: dict[str, Any], message: str) -> None:
    async def fly(bench: Bench) -> None:
        with pytest.raises(VehicleError, match=message):
            await bench.vehicle(**options).__aenter__()
        async with bench.vehicle() as vehicle:
            assert vehicle.state.mode is FlightMode.HOLD

    with px4() as bench:
        asyncio.run(fly(bench))


def test_without_a_heartbeat_the_error_names_url_and_wait() -> None:
    port = free_port()
    with pytest.raises(VehicleError, match=rf"no heartbeat on udpin://127.0.0.1:{port} in 0.2 s") as caught:
        asyncio.run(vehicle_at(port, connect_timeout_s=0.2).__aenter__())
    assert "powered" in caught.value.remedy


def test_a_port_has_one_owner() -> None:
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        stranger.bind(("127.0.0.1", port))
        with pytest.raises(VehicleError, match=rf"UDP port {port} is already in use") as caught:
            asyncio.run(vehicle_at(port).__aenter__())
        assert "choose another port" in caught.value.remedy
    with (
        PortLock(f"udpin://127.0.0.1:{port}"),
        pytest.raises(VehicleError, match=rf"UDP port {port} is already used by another vehicle"),
    ):
        PortLock(f"udpin://0.0.0.0:{port}")
    with PortLock("serial:///dev/ttyX7:57600"), pytest.raises(VehicleError, match="already used"):
        PortLock("serial:///dev/ttyX7:57600")


@pytest.mark.parametrize("url", ["", "udpin://127.0.0.1", "http://127.0.0.1:80", "14541"])
def test_a_malformed_url_is_refused(url: str) -> None:
    with pytest.raises(VehicleError, match="no MAVLink connection") as caught:
        PortLock(url)
    assert "udpin://" in caught.value.remedy


@pytest.mark.parametrize("options", [{"sysid": 0}, {"sysid": 256}, {"sysid": 245}])
def test_impossible_system_ids_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="sysid"):
        MavsdkVehicleConfig(url="udpin://127.0.0.1:14541", **options)


# --- ArduCopter, as far as its own rules on the wire go ---


class ArduCopter:
    """Answers as ArduCopter would. It flies only up and down, and not at all when ``deaf`` to a command.

    Every rate must be asked for, arming and take-off want GUIDED, the height is param7, BRAKE is its hold.
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
                    self._send(mavlink.MAVLink_command_ack_message(message.command, self._command(message, now_s)))
        for message_id, due_s in self._due_s.items():
            if now_s >= due_s:
                self._due_s[message_id] = now_s + self._interval_s[message_id]
                self._send(self._telemetry(message_id, int(now_s * 1e3)))

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
            return mavlink.MAV_RESULT_ACCEPTED if made is not None else mavlink.MAV_RESULT_UNSUPPORTED
        return mavlink.MAV_RESULT_ACCEPTED

    def _telemetry(self, message_id: int, boot_ms: int) -> Any:
        position = (474_000_000, 85_000_000, round(480_000 + 1e3 * self.height_m))
        healthy = 0x1000_003F
        made: dict[int, Callable[[], Any]] = {
            0: lambda: mavlink.MAVLink_heartbeat_message(2, 3, 1 | 128 * self.armed, self.mode, 4, 3),
            1: lambda: mavlink.MAVLink_sys_status_message(
                healthy, healthy, healthy, 0, 16_000, 0, 80, 0, 0, 0, 0, 0, 0
            ),
            24: lambda: mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 3, *position, 80, 80, 0, 0, 12),
            31: lambda: mavlink.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            32: lambda: mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, -self.height_m, 0.0, 0.0, 0.0),
            33: lambda: mavlink.MAVLink_global_position_int_message(
                boot_ms, *position, round(1e3 * self.height_m), 0, 0, 0, 0
            ),
            242: lambda: mavlink.MAVLink_home_position_message(
                474_000_000, 85_000_000, 480_000, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
            ),
            245: lambda: mavlink.MAVLink_extended_sys_state_message(0, 2 if self.height_m > 0.0 else 1),
        }
        return made[message_id]() if message_id in made else None

    def _send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._mav), self._remote)
        self._mav.seq = (self._mav.seq + 1) % 256


def test_arducopter_is_guided_before_it_arms_and_brakes_to_hold() -> None:
    async def fly(copter: ArduCopter, port: int, wire: Wire) -> None:
        async with vehicle_at(port, command_timeout_s=0.3) as vehicle:
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
            assert [message.confirmation for message in landings] == [0, 1, 2]  # what ends motion is resent
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


# --- pieces ---


def test_modes_of_both_autopilots() -> None:
    assert PX4.mode(4 << 16 | 6 << 24) is FlightMode.LAND
    assert PX4.mode(3 << 16) is FlightMode.OTHER
    assert ARDUPILOT.mode(4) is FlightMode.OFFBOARD
    assert ARDUPILOT.mode(5) is FlightMode.OTHER  # LOITER needs a pilot's sticks
    for kind in (PX4, ARDUPILOT):
        for mode, (main, sub) in kind.set_mode.items():
            custom = main << 16 | sub << 24 if kind is PX4 else main
            assert kind.mode(custom) is mode


def ecef(latitude_deg: float, longitude_deg: float, height_m: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    return np.array(
        [
            (normal + height_m) * math.cos(latitude) * math.cos(longitude),
            (normal + height_m) * math.cos(latitude) * math.sin(longitude),
            (normal * (1.0 - ECCENTRICITY_SQUARED) + height_m) * math.sin(latitude),
        ]
    )


@pytest.mark.parametrize(("latitude", "longitude", "altitude"), [(47.4, 8.5, 480.0), (-33.9, 179.9999, 20.0)])
@pytest.mark.parametrize("at", [(100.0, 0.0, 0.0), (0.0, 100.0, -30.0), (-60.0, 80.0, -5.0)])
def test_local_frame_agrees_with_earth_centred_coordinates(
    latitude: float, longitude: float, altitude: float, at: tuple[float, float, float]
) -> None:
    tangent = LocalTangent(latitude, longitude, altitude)
    place = tangent.to_global(*at)
    assert tangent.to_ned(*place) == pytest.approx(at, abs=1e-6)
    f, g = math.radians(latitude), math.radians(longitude)
    north = np.array([-math.sin(f) * math.cos(g), -math.sin(f) * math.sin(g), math.cos(f)])
    east = np.array([-math.sin(g), math.cos(g), 0.0])
    down = -np.array([math.cos(f) * math.cos(g), math.cos(f) * math.sin(g), math.sin(f)])
    away = ecef(*place) - ecef(latitude, longitude, altitude)
    assert (away @ north, away @ east, away @ down) == pytest.approx(at, abs=3e-3)


def test_an_exception_in_a_callback_comes_out_at_the_next_look() -> None:
    async def look() -> None:
        telemetry = Telemetry(SYSID, LoopClock(), TANGENT)
        telemetry._guarded(telemetry._on_battery)(object(), None)  # MAVSDK itself would print it and go on
        with pytest.raises(VehicleError, match=r"telemetry cannot be understood.*remaining_percent"):
            telemetry.state()

    asyncio.run(look())


def test_heartbeats_of_others_are_not_the_vehicles() -> None:
    telemetry = Telemetry(SYSID, LoopClock(), TANGENT)

    class Message:
        system_id, component_id, fields_json = SYSID, 191, '{"autopilot":8,"base_mode":0,"custom_mode":0}'

    telemetry._guarded(telemetry._on_heartbeat)(Message(), None)
    assert telemetry.heartbeat is None  # a companion computer on the vehicle's own system id


def test_the_callback_threads_clock_follows_the_roles() -> None:
    class Stepping:
        ahead_ns = AHEAD_NS

        def now_ns(self) -> int:
            return time.monotonic_ns() + self.ahead_ns

    role = Stepping()
    clock = ThreadClock(role)

    def together() -> bool:
        clock.follow()
        return abs(role.now_ns() - clock.now_ns()) < 1_000_000

    asyncio.run(until(together))
    role.ahead_ns += 50_000_000
    asyncio.run(until(together))
