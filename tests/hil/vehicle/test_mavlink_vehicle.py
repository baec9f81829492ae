"""The embedded MAVLink vehicle under commands, setpoints and noise, in simulated time, against a
raw socket.
"""

import math
import socket
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from tests.hil.vehicle.mavlink_bench import STEP_S, SYSID, Bench


def test_velocity_and_position_setpoints_fly(bench: Bench) -> None:
    bench.fly_at(0.8)
    assert (
        bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0)
        == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
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
    [
        ((math.nan, 0.0, 0.0), 2503, 0.0),
        ((0.0, math.inf, 0.0), 2503, 0.0),
        ((1.0, 0.0, 0.0), 2503, math.nan),
    ],
)
def test_a_setpoint_that_is_not_finite_does_not_count(
    bench: Bench, velocity: tuple[float, float, float], mask: int, yaw: float
) -> None:
    bench.fly_at()
    bench.setpoint(velocity, mask, yaw=yaw)
    bench.run(STEP_S)
    assert bench.vehicle.malformed == 1
    assert (
        bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0)
        == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    )


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
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 0.0)
        == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    )
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)
        == mavlink.MAV_RESULT_ACCEPTED
    )
    bench.run(1.0)
    assert bench.drone.on_ground


def test_a_pilots_mode_from_a_second_ground_station_is_obeyed(bench: Bench) -> None:
    bench.fly_at()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        second.settimeout(60.0)
        mav: Any = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        message = mavlink.MAVLink_command_long_message(SYSID, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
        second.sendto(message.pack(mav), bench.vehicle.address)
        bench.run(STEP_S)
        (ack,) = mav.parse_buffer(second.recv(2048))
    assert (ack.get_type(), ack.result, ack.target_system) == (
        "COMMAND_ACK",
        mavlink.MAV_RESULT_ACCEPTED,
        255,
    )
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
        mavlink.MAV_CMD_MISSION_START,
        mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    ],
)
def test_unknown_commands_are_unsupported(bench: Bench, command: int) -> None:
    assert bench.command(command) == mavlink.MAV_RESULT_UNSUPPORTED


def test_velocity_in_the_body_s_frame_is_ahead_and_right_of_the_heading(bench: Bench) -> None:
    """MAVSDK's set_velocity_body: the yaw is ignored, its rate is not. It was accepted and not
    followed.
    """
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
    arm = bytearray(
        mavlink.MAVLink_command_long_message(SYSID, 1, 400, 0, *[1.0] * 7).pack(bench.mav)
    )
    arm[at % len(arm)] ^= byte or 1
    bench.send_raw(noise)
    bench.send_raw(bytes(arm))
    bench.run(STEP_S)
    assert not bench.drone.autopilot.armed  # a damaged command is no command


def test_half_a_packet_does_not_swallow_the_next_one(bench: Bench) -> None:
    bench.run(0.5)
    bench.send_raw(b"\xfd\xff\x00\x00")
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    )
    assert bench.vehicle.malformed == 1
