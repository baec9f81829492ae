"""The embedded MAVLink vehicle, pumped in simulated time, against a raw socket; and under MAVSDK's own plugins."""

import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.telemetry import Telemetry
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.modes import powered
from hil.autopilot.autopilot import AutopilotConfig
from hil.autopilot.radio import STICKS_SLOT
from hil.vehicle.channel import Address, UdpChannel
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.estimator import EstimatorConfig, WindConfig
from hil.world.world import HomeConfig, World, WorldConfig
from path.messages import Role
from tests.steady_time import SteadyTime

SYSID = 7
START = (3.0, -2.0, -0.1)  # not the mission's origin: local and mission frames must not be mixed up
HOME = HomeConfig(position_m=(START[1], START[0]))
QUICK = AutopilotConfig(settle_s=0.2, spool_s=0.1, climb_mps=1.5, land_mps=1.0, touchdown_mps=0.8, land_disarm_s=0.2)
TANGENT = LocalTangent(47.4, 8.5, 480.0)
STEP_S = 0.005


class Bench:
    """A vehicle and a ground station's socket, both in simulated time."""

    def __init__(self, config: AutopilotConfig = QUICK) -> None:
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(("127.0.0.1", 0))
        self.ground.settimeout(0.0)
        exact = EstimatorConfig(**dict.fromkeys(EstimatorConfig.__slots__, 0.0))
        self.world = World(
            WorldConfig(wind=WindConfig(0.0, gust_mps=0.0), estimator=exact, autopilot=config, sender_home=HOME), seed=1
        )
        self.drone = self.world.drone(Role.SENDER)
        self.vehicle = MavlinkVehicle(MavlinkVehicleConfig(SYSID, self.ground.getsockname()), self.drone, TANGENT)
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

    def setpoint(self, velocity: tuple[float, float, float], mask: int = 2503, **fields: float) -> None:
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
        assert self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_ACCEPTED
        self.run(4.0)
        assert self.drone.autopilot.mode is FlightMode.HOLD
        assert not self.drone.autopilot.landed


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_streams_come_at_the_rates_asked_for_and_stop_when_told(bench: Bench) -> None:
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert bench.command(interval, 31.0, 20_000.0) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.command(interval, 0.0, 200_000.0) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.command(interval, 30.0, -1.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(0.5)
    bench.heard.clear()
    bench.run(2.0)
    assert len(bench.of("ATTITUDE_QUATERNION")) == pytest.approx(100, abs=1)
    assert len(bench.of("HEARTBEAT")) == pytest.approx(10, abs=1)
    assert len(bench.of("LOCAL_POSITION_NED")) == pytest.approx(60, abs=1)  # untouched default
    assert bench.of("ATTITUDE") == []
    assert bench.command(interval, 30.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED  # 0: the default again
    bench.run(1.0)
    assert len(bench.of("ATTITUDE")) == pytest.approx(10, abs=1)


def test_what_is_due_at_one_instant_is_one_datagram(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    datagrams: list[tuple[float, int]] = []
    send = UdpChannel.send

    def noted(channel: UdpChannel, packet: bytes, to: Address | None = None) -> None:
        datagrams.append((bench.now_s, len(packet)))
        send(channel, packet, to)

    monkeypatch.setattr(UdpChannel, "send", noted)
    bench.run(2.0)
    assert len({now_s for now_s, _ in datagrams}) == len(datagrams)
    assert len(bench.heard) > 1.5 * len(datagrams)
    assert max(size for _, size in datagrams) < 1400


def test_a_stalled_world_goes_on_without_a_burst(bench: Bench) -> None:
    bench.run(0.5)
    bench.heard.clear()
    bench.now_s += 3.0
    bench.run(0.2)
    assert len(bench.of("LOCAL_POSITION_NED")) <= 7  # 30 Hz, and the one that was due


def test_a_changed_mode_is_told_at_once(bench: Bench) -> None:
    bench.run(0.6)
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.of("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert bench.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.of("HEARTBEAT")[-1].custom_mode == 4 << 16 | 2 << 24


def test_arming_too_early_is_denied_with_its_reason_in_text(bench: Bench) -> None:
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert [text.text for text in bench.of("STATUSTEXT")] == ["Arming denied: position estimate is settling"]
    assert not bench.drone.autopilot.armed


def test_there_is_no_global_position_before_the_estimate_has_settled(bench: Bench) -> None:
    bench.run(0.1)
    assert bench.of("GLOBAL_POSITION_INT") == []
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    bench.run(0.6)
    there = bench.of("GLOBAL_POSITION_INT")[-1]
    assert TANGENT.to_ned(there.lat * 1e-7, there.lon * 1e-7, there.alt * 1e-3) == pytest.approx(START, abs=0.012)
    assert bench.of("LOCAL_POSITION_NED")[-1].x == pytest.approx(0.0, abs=1e-6)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242.0) == mavlink.MAV_RESULT_ACCEPTED
    assert len(bench.of("HOME_POSITION")) == 1
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0) == mavlink.MAV_RESULT_ACCEPTED
    assert len(bench.of("AUTOPILOT_VERSION")) == 1


def test_the_prearm_bit_follows_the_autopilot(bench: Bench) -> None:
    bench.run(0.1)
    assert not bench.of("SYS_STATUS")[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    bench.run(0.6)
    assert bench.of("SYS_STATUS")[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK


def test_parameters_are_listed_and_what_is_set_takes_effect(bench: Bench) -> None:
    bench.send(mavlink.MAVLink_param_request_list_message(SYSID, 1))
    bench.run(STEP_S)
    listed = bench.of("PARAM_VALUE")
    assert [value.param_index for value in listed] == list(range(listed[0].param_count))
    whole = next(value for value in listed if value.param_id == "COM_RC_IN_MODE")
    assert struct.unpack("<i", struct.pack("<f", whole.param_value)) == (0,)

    def set_to(name: bytes, value: float, kind: int = 9) -> float:
        bench.heard.clear()
        bench.send(mavlink.MAVLink_param_set_message(SYSID, 1, name, value, kind))
        bench.run(STEP_S)
        return bench.of("PARAM_VALUE")[-1].param_value

    assert set_to(b"MIS_TAKEOFF_ALT", 2.25) == 2.25
    assert set_to(b"MIS_TAKEOFF_ALT", math.nan) == 2.25
    assert set_to(b"MIS_TAKEOFF_ALT", 1e6) == 2.25
    assert set_to(b"COM_OF_LOSS_T", 60.5) == pytest.approx(QUICK.offboard_loss_s)  # out of its bounds
    assert set_to(b"COM_OF_LOSS_T", 2.0) == 2.0
    assert bench.drone.autopilot.config.offboard_loss_s == 2.0
    assert set_to(b"COM_RC_IN_MODE", 4.0) == 0.0  # of another type
    ignored = struct.unpack("<f", struct.pack("<i", 4))[0]
    assert set_to(b"COM_RC_IN_MODE", ignored, 6) == ignored
    assert not bench.drone.autopilot.config.radio.hears
    set_to(b"COM_OBL_RC_ACT", struct.unpack("<f", struct.pack("<i", 0))[0], 6)
    assert struct.unpack("<i", struct.pack("<f", bench.of("PARAM_VALUE")[-1].param_value)) == (4,)  # it lands


def test_velocity_and_position_setpoints_fly(bench: Bench) -> None:
    bench.fly_at(0.8)
    assert (
        bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    )  # no setpoint yet
    bench.setpoint((0.5, 0.0, 0.0), yaw=1.0)
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(3.0, lambda: bench.setpoint((0.5, 0.0, 0.0), yaw=1.0))
    assert bench.drone.estimate.velocity_n_mps[0] == pytest.approx(0.5, abs=0.05)
    assert bench.of("ATTITUDE")[-1].yaw == pytest.approx(1.0, abs=0.02)
    bench.run(12.0, lambda: bench.setpoint((0.0, 0.0, 0.0), 2552, x=-1.0, y=1.0, z=-1.2))
    local = bench.of("LOCAL_POSITION_NED")[-1]
    assert (local.x, local.y, local.z) == pytest.approx((-1.0, 1.0, -1.2), abs=0.05)


@pytest.mark.parametrize(
    ("velocity", "mask", "yaw"),
    [((math.nan, 0.0, 0.0), 2503, 0.0), ((0.0, math.inf, 0.0), 2503, 0.0), ((1.0, 0.0, 0.0), 2503, math.nan)],
)
def test_a_setpoint_that_is_not_finite_does_not_count(
    bench: Bench, velocity: tuple[float, float, float], mask: int, yaw: float
) -> None:
    bench.fly_at()
    bench.setpoint(velocity, mask, yaw=yaw)
    bench.run(STEP_S)
    assert bench.vehicle.malformed == 1
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def test_without_setpoints_it_holds_then_lands(bench: Bench) -> None:
    bench.fly_at()
    bench.setpoint((0.0, 0.0, 0.0))
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(5.0)
    modes = list(dict.fromkeys(beat.custom_mode for beat in bench.of("HEARTBEAT")))
    assert modes == [6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 6 << 24]
    assert not bench.drone.autopilot.armed


def test_only_force_stops_the_motors_in_the_air(bench: Bench) -> None:
    bench.fly_at()
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 0.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(1.0)
    assert bench.drone.on_ground


@pytest.fixture
def slow_beat() -> Iterator[Bench]:
    made = Bench(replace(QUICK, heartbeat_hz=1.0, companion_loss_s=0.5))
    yield made
    made.close()


def test_one_that_beats_at_its_own_rate_shows_a_change_with_the_next_beat(slow_beat: Bench) -> None:
    bench = slow_beat
    assert bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0.0, 2e5) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(0.6)
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.of("HEARTBEAT") == []
    bench.run(4.0)
    assert len(bench.of("HEARTBEAT")) == 4
    assert bench.of("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_a_ground_stations_heartbeat_is_heard_and_a_companions_is_none(slow_beat: Bench) -> None:
    bench = slow_beat

    def beat(kind: int) -> None:
        bench.send(mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    bench.fly_at()
    bench.run(1.0, lambda: beat(mavlink.MAV_TYPE_GCS))
    assert bench.drone.autopilot.mode is FlightMode.HOLD
    bench.run(0.7, lambda: beat(mavlink.MAV_TYPE_ONBOARD_CONTROLLER))
    assert bench.drone.autopilot.mode is FlightMode.LAND


def test_a_pilots_mode_from_a_second_ground_station_is_obeyed(bench: Bench) -> None:
    bench.fly_at()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.settimeout(60.0)
        mav: Any = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        message = mavlink.MAVLink_command_long_message(SYSID, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
        second.sendto(message.pack(mav), bench.vehicle.address)
        bench.run(STEP_S)
        (ack,) = mav.parse_buffer(second.recv(2048))
    assert (ack.get_type(), ack.result, ack.target_system) == ("COMMAND_ACK", mavlink.MAV_RESULT_ACCEPTED, 255)
    assert bench.drone.autopilot.mode is FlightMode.OTHER
    assert bench.drone.autopilot.pilot_in_control


def test_what_is_meant_for_another_vehicle_is_left_alone(bench: Bench) -> None:
    bench.run(0.5)
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0, target=SYSID + 1) is None
    assert not bench.drone.autopilot.armed


@pytest.mark.parametrize("command", [176, 400, 511, 512])
def test_commands_of_nothing_but_nan_are_refused(bench: Bench, command: int) -> None:
    assert bench.command(command) == mavlink.MAV_RESULT_DENIED


@pytest.mark.parametrize(
    "command",
    [
        mavlink.MAV_CMD_DO_ORBIT,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_MISSION_START,
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    ],
)
def test_unknown_commands_are_unsupported(bench: Bench, command: int) -> None:
    assert bench.command(command) == mavlink.MAV_RESULT_UNSUPPORTED


def test_velocity_in_the_body_s_frame_is_ahead_and_right_of_the_heading(bench: Bench) -> None:
    """MAVSDK's set_velocity_body: the yaw is ignored, its rate is not. It was accepted and not followed."""
    bench.fly_at(1.5)
    body, mask = mavlink.MAV_FRAME_BODY_NED, 0b010111000111
    bench.setpoint((0.0, 0.0, 0.0), mask, frame=body)
    bench.run(0.1)
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(3.0, lambda: bench.setpoint((0.0, 0.0, 0.0), mask, frame=body, yaw_rate=0.5))
    assert bench.of("ATTITUDE")[-1].yaw == pytest.approx(1.5, abs=0.3)
    yaw = bench.of("ATTITUDE")[-1].yaw
    bench.run(3.0, lambda: bench.setpoint((0.5, 0.2, 0.0), mask, frame=body))
    north, east, _ = bench.drone.estimate.velocity_n_mps
    heading = bench.of("ATTITUDE")[-1].yaw
    assert heading == pytest.approx(yaw, abs=0.3)
    ahead, right = 0.5, 0.2
    assert north == pytest.approx(math.cos(heading) * ahead - math.sin(heading) * right, abs=0.06)
    assert east == pytest.approx(math.sin(heading) * ahead + math.cos(heading) * right, abs=0.06)


def test_a_setpoint_in_a_frame_that_is_not_followed_is_told_of(bench: Bench) -> None:
    bench.run(0.5)
    bench.run(1.5, lambda: bench.setpoint((0.5, 0.0, 0.0), frame=mavlink.MAV_FRAME_BODY_OFFSET_NED))
    texts = [text.text for text in bench.of("STATUSTEXT") if "unsupported" in text.text]
    assert len(texts) == 2
    assert texts[0].startswith("SET_POSITION_TARGET_LOCAL_NED frame 9")


def test_a_silent_vehicle_neither_sends_nor_hears(bench: Bench) -> None:
    bench.run(0.5)
    bench.vehicle.silent = True
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) is None
    bench.run(1.0)
    assert bench.heard == []
    bench.vehicle.silent = False
    bench.run(0.6)
    assert bench.of("HEARTBEAT")
    assert not bench.drone.autopilot.armed  # what came during the silence is lost


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.integers(0, 60), st.integers(0, 255))
def test_noise_never_stops_it(bench: Bench, noise: bytes, at: int, byte: int) -> None:
    arm = bytearray(mavlink.MAVLink_command_long_message(SYSID, 1, 400, 0, *[1.0] * 7).pack(bench.mav))
    arm[at % len(arm)] ^= byte or 1
    bench.send_raw(noise)
    bench.send_raw(bytes(arm))
    bench.run(STEP_S)
    assert not bench.drone.autopilot.armed  # a damaged command is no command


def test_half_a_packet_does_not_swallow_the_next_one(bench: Bench) -> None:
    bench.run(0.5)
    bench.send_raw(b"\xfd\xff\x00\x00")
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.vehicle.malformed == 1


# --- unmodified MAVSDK ---


class RealTime:
    """Steps a bench in a thread, in real time. Keeps the largest pause, and every message that reached the vehicle."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.wire: list[Any] = []
        bench.vehicle.tap = lambda _, message: self.wire.append(message)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "RealTime":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        passed = SteadyTime()
        while not self._stop.wait(0.004):
            now_s = passed.now_s()
            self.bench.world.advance(now_s)
            self.bench.vehicle.pump(now_s)


def until(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "the condition did not come"
        time.sleep(0.01)


@contextmanager
def connected(bench: Bench) -> Generator[tuple[RealTime, Any]]:
    """MAVSDK on the port the bench sends to."""
    port = bench.ground.getsockname()[1]
    bench.ground.close()
    with RealTime(bench) as world, Mavsdk(Configuration.create_manual(245, 190, True)) as mavsdk:
        mavsdk.add_any_connection_with_handle(f"udpin://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(60.0)
        assert system is not None
        yield world, system


def test_mavsdks_own_plugins_fly_it(bench: Bench) -> None:
    with ExitStack() as stack:
        world, system = stack.enter_context(connected(bench))
        action, offboard, telemetry = Action(system), Offboard(system), Telemetry(system)
        seen: dict[str, Any] = {}

        def keep(name: str) -> Callable[[Any, Any], None]:
            return lambda value, _: seen.__setitem__(name, value)  # type: ignore[reportUnknownLambdaType]

        telemetry.subscribe_health(keep("health"))
        telemetry.subscribe_flight_mode(keep("mode"))
        telemetry.subscribe_in_air(keep("in_air"))
        telemetry.subscribe_position_velocity_ned(keep("ned"))
        until(lambda: "health" in seen and seen["health"].is_armable and seen["health"].is_home_position_ok)
        assert seen["health"].is_global_position_ok and seen["health"].is_local_position_ok
        action.set_takeoff_altitude(0.7)
        assert action.get_takeoff_altitude() == pytest.approx(0.7)
        action.arm()
        action.takeoff()
        until(lambda: seen["mode"].name == "HOLD" and seen["in_air"])
        offboard.set_velocity_ned(VelocityNedYaw(0.5, 0.0, 0.0, 90.0))
        offboard.start()
        until(lambda: seen["ned"].position.north_m > 0.3)
        assert bench.drone.estimate.position_n_m[0] > START[0] + 0.3
        offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -0.7, 0.0))
        until(lambda: abs(seen["ned"].position.north_m) < 0.1)
        offboard.stop()  # selects HOLD
        until(lambda: seen["mode"].name == "HOLD")
        action.land()
        until(lambda: not bench.drone.autopilot.armed)
        assert bench.drone.autopilot.setpoint_gap_s < QUICK.offboard_loss_s
    kinds = {message.get_type() for message in world.wire}
    assert {"COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED"} <= kinds


def test_the_transmitter_is_told_of_and_takes_the_vehicle(bench: Bench) -> None:
    bench.fly_at(0.8)
    receiver = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    assert bench.of("SYS_STATUS")[-1].onboard_control_sensors_health & receiver
    assert bench.of("RC_CHANNELS")[-1].chan7_raw == 1000
    bench.drone.autopilot.radio.transmitter.slot = STICKS_SLOT
    bench.run(0.7)
    assert bench.of("HEARTBEAT")[-1].custom_mode == 3 << 16
    bench.drone.autopilot.radio.transmitter.on = False
    bench.run(1.2)
    assert not bench.of("SYS_STATUS")[-1].onboard_control_sensors_present & receiver
    assert bench.of("RC_CHANNELS")[-1].rssi == 0


def test_a_kill_switch_shows_as_flight_termination_while_the_vehicle_calls_itself_armed(bench: Bench) -> None:
    """By channels of a ground station: seven is the kill switch."""
    bench.fly_at(0.8)

    def thrown(kill_us: int) -> None:
        channels = [1500, 1500, 1500, 1500, 65535, 65535, kill_us, 65535]
        bench.send(mavlink.MAVLink_rc_channels_override_message(SYSID, 1, *channels))

    bench.run(0.1, lambda: thrown(1000))
    bench.run(0.7, lambda: thrown(2000))
    told = bench.of("HEARTBEAT")[-1]
    assert told.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION
    assert told.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert not powered(told.base_mode, told.system_status)
