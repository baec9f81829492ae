"""What a stranger's ground station asks the embedded vehicle that MAVSDK does not, answered as PX4
answers it.
"""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from tests.hil.vehicle.mavlink_bench import START, STEP_S, SYSID, TANGENT, Bench


def test_a_ground_station_is_told_how_often_a_message_comes(bench: Bench) -> None:
    ask = mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
    assert bench.command(ask, mavlink.MAVLINK_MSG_ID_ATTITUDE) == mavlink.MAV_RESULT_ACCEPTED
    assert [each.interval_us for each in bench.of("MESSAGE_INTERVAL")] == [100_000]
    bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, -1)
    bench.command(ask, mavlink.MAVLINK_MSG_ID_ATTITUDE)
    assert [each.interval_us for each in bench.of("MESSAGE_INTERVAL")] == [-1]
    bench.command(ask, 9999.0)
    assert [each.interval_us for each in bench.of("MESSAGE_INTERVAL")] == [0]
    assert bench.command(ask, math.nan) == mavlink.MAV_RESULT_DENIED


def test_the_older_request_for_what_it_can_do_is_answered(bench: Bench) -> None:
    assert (
        bench.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0)
        == mavlink.MAV_RESULT_ACCEPTED
    )
    assert len(bench.of("AUTOPILOT_VERSION")) == 1


def test_commands_for_another_component_or_for_every_system_are_not_obeyed(bench: Bench) -> None:
    """As by PX4: only who asks for a message may leave open whom."""
    bench.run(0.5)
    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert bench.command(arm, 1.0, 0.0, target=0) is None
    for system, component in ((SYSID, 50), (SYSID + 1, 1)):
        bench.send(
            mavlink.MAVLink_command_long_message(system, component, arm, 0, 1.0, 0.0, 0, 0, 0, 0, 0)
        )
        bench.run(STEP_S)
    assert not bench.of("COMMAND_ACK")
    assert not bench.drone.autopilot.armed
    version = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    assert (
        bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, version, target=0)
        == mavlink.MAV_RESULT_ACCEPTED
    )
    bench.heard.clear()
    bench.send(mavlink.MAVLink_param_request_read_message(SYSID, 50, b"RTL_RETURN_ALT", -1))
    bench.run(STEP_S)
    assert not bench.of("PARAM_VALUE")


def test_a_pilots_mode_by_the_old_message_is_obeyed(bench: Bench) -> None:
    bench.fly_at()
    bench.heard.clear()
    bench.send(
        mavlink.MAVLink_set_mode_message(SYSID, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 3 << 16)
    )
    bench.run(STEP_S)
    (ack,) = bench.of("COMMAND_ACK")
    assert (ack.command, ack.result) == (mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_RESULT_ACCEPTED)
    assert bench.drone.autopilot.mode is FlightMode.OTHER


def test_an_upload_of_nothing_clears_and_one_of_something_is_refused(bench: Bench) -> None:
    for count, result in ((0, mavlink.MAV_MISSION_ACCEPTED), (3, mavlink.MAV_MISSION_UNSUPPORTED)):
        bench.heard.clear()
        bench.send(
            mavlink.MAVLink_mission_count_message(SYSID, 1, count, mavlink.MAV_MISSION_TYPE_MISSION)
        )
        bench.run(STEP_S)
        assert [ack.type for ack in bench.of("MISSION_ACK")] == [result]


def test_pings_and_lists_of_logs_are_answered(bench: Bench) -> None:
    bench.send(mavlink.MAVLink_ping_message(5, 9, 0, 0))
    bench.send(mavlink.MAVLink_ping_message(6, 10, SYSID, 1))  # an answer is not answered
    bench.send(mavlink.MAVLink_log_request_list_message(SYSID, 1, 0, 0xFFFF))
    bench.run(STEP_S)
    assert [(each.time_usec, each.seq, each.target_system) for each in bench.of("PING")] == [
        (5, 9, 245)
    ]
    assert [each.num_logs for each in bench.of("LOG_ENTRY")] == [0]


def test_setpoints_that_are_not_followed_are_said_to_be(bench: Bench) -> None:
    """MAVSDK's set_position_global and set_attitude: they have no answer of their own."""
    bench.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, SYSID, 1, 6, 0b110111111000, 474000000, 85000000, 10, 0, 0, 0, 0, 0, 0, 0, 0
        )
    )
    bench.run(1.5)
    bench.send(
        mavlink.MAVLink_set_attitude_target_message(
            0, SYSID, 1, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.5
        )
    )
    bench.run(STEP_S)
    said = [each.text for each in bench.of("STATUSTEXT") if "unsupported" in each.text]
    assert said == ["SET_POSITION_TARGET_GLOBAL_INT unsupported", "SET_ATTITUDE_TARGET unsupported"]


def test_a_take_off_as_an_integer_command_goes_to_its_own_altitude(bench: Bench) -> None:
    """In COMMAND_INT the altitude is ``z``; over home it is not taken for one over the sea."""
    bench.run(0.5)
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    )
    (home,) = (
        message.altitude * 1e-3
        for message in requested(bench, mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    )
    for frame, z, result in (
        (6, 2.0, mavlink.MAV_RESULT_DENIED),
        (5, home + 2.0, mavlink.MAV_RESULT_ACCEPTED),
    ):
        bench.heard.clear()
        take_off = mavlink.MAV_CMD_NAV_TAKEOFF
        bench.send(
            mavlink.MAVLink_command_int_message(
                SYSID, 1, frame, take_off, 0, 0, 0, 0, 0, math.nan, 0, 0, z
            )
        )
        bench.run(STEP_S)
        assert [ack.result for ack in bench.of("COMMAND_ACK")] == [result]
    bench.run(5.0)
    assert bench.of("GLOBAL_POSITION_INT")[-1].relative_alt * 1e-3 == pytest.approx(2.0, abs=0.2)


def requested(bench: Bench, message: int) -> list[Any]:
    bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message)
    return bench.of("HOME_POSITION")


def test_a_joysticks_sticks_come_as_manual_control(bench: Bench) -> None:
    bench.send(mavlink.MAVLink_manual_control_message(SYSID, 500, -1000, 500, 250, 0))
    bench.run(0.1)
    assert bench.drone.autopilot.radio.channels[:4] == (1000, 1750, 1500, 1625)
    bench.send(mavlink.MAVLink_manual_control_message(SYSID + 1, 0, 0, 500, 0, 0))
    bench.run(0.1)
    assert bench.drone.autopilot.radio.channels[:4] == (1000, 1750, 1500, 1625)


def test_a_take_off_to_a_height_above_home_climbs_as_high_as_usual_and_says_so(
    bench: Bench,
) -> None:
    """MAVProxy's `takeoff 3`, where PX4 wants metres above the sea: it was denied as -483 m."""
    bench.run(3.0)
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
    assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, 3.0) == mavlink.MAV_RESULT_ACCEPTED
    bench.run(8.0)
    assert any("Using minimum takeoff altitude" in text.text for text in bench.of("STATUSTEXT"))
    height_m = bench.of("GLOBAL_POSITION_INT")[-1].relative_alt / 1e3
    assert bench.drone.autopilot.mode is FlightMode.HOLD
    assert 1.0 < height_m < 4.0


def test_a_ground_station_sends_it_somewhere_and_it_holds_there(bench: Bench) -> None:
    """MAVSDK's goto_location and QGroundControl's `Go to location`."""
    goal_n_m = (5.0, 1.0)
    there = TANGENT.to_global(*goal_n_m, -2.0)
    go = mavlink.MAV_CMD_DO_REPOSITION

    def asked(frame: int, z: float) -> list[int]:
        bench.heard.clear()
        at = round(there[0] * 1e7), round(there[1] * 1e7), z
        bench.send(
            mavlink.MAVLink_command_int_message(
                SYSID, 1, frame, go, 0, 0, -1.0, 1.0, 0.0, math.nan, *at
            )
        )
        bench.run(STEP_S)
        return [ack.result for ack in bench.of("COMMAND_ACK") if ack.command == go]

    bench.run(3.0)
    assert asked(mavlink.MAV_FRAME_GLOBAL, there[2]) == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]
    bench.fly_at(1.5)
    assert asked(mavlink.MAV_FRAME_MISSION, there[2]) == [mavlink.MAV_RESULT_DENIED]
    for frame, z, height_m in (
        (mavlink.MAV_FRAME_GLOBAL, there[2], 2.0 + START[2]),
        (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 3.0, 3.0),
    ):
        assert asked(frame, z) == [mavlink.MAV_RESULT_ACCEPTED]
        bench.run(10.0)
        north_m, east_m, down_m = bench.drone.estimate.position_n_m
        assert math.dist((north_m, east_m), goal_n_m) < 0.2
        assert START[2] - down_m == pytest.approx(height_m, abs=0.2)
        assert bench.drone.autopilot.mode is FlightMode.HOLD


def test_modes_are_listed_by_name_all_or_one(bench: Bench) -> None:
    bench.run(0.5)
    listed = mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES
    ask = mavlink.MAV_CMD_REQUEST_MESSAGE
    assert bench.command(ask, listed, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    modes = {mode.mode_name: mode for mode in bench.of("AVAILABLE_MODES")}
    assert set(modes) == {"Takeoff", "Hold", "Return", "Land", "Offboard", "Position"}
    assert modes["Hold"].custom_mode == 4 << 16 | 3 << 24
    assert {mode.number_modes for mode in modes.values()} == {len(modes)}
    assert bench.command(ask, listed, 2.0) == mavlink.MAV_RESULT_ACCEPTED
    assert [mode.mode_index for mode in bench.of("AVAILABLE_MODES")] == [2]
    assert bench.command(ask, listed, 99.0) == mavlink.MAV_RESULT_DENIED


def test_its_fence_is_well_until_it_is_outside(bench: Bench) -> None:
    """MAVProxy said "fence breach" of a vehicle that stood at home: it told of no fence at all."""
    fence = mavlink.MAV_SYS_STATUS_GEOFENCE

    def told() -> tuple[bool, bool]:
        bench.run(1.0)
        status = bench.of("SYS_STATUS")[-1]
        enabled = status.onboard_control_sensors_enabled & fence
        return bool(enabled), bool(status.onboard_control_sensors_health & fence)

    assert told() == (True, True)
    bench.drone.autopilot.outside = True  # it was on the ground: nothing looks again
    assert told() == (True, False)


def test_a_head_up_display_shows_heading_height_and_climb(bench: Bench) -> None:
    bench.fly_at(1.5)
    bench.run(1.0)
    shown = bench.of("VFR_HUD")[-1]
    place = bench.of("GLOBAL_POSITION_INT")[-1]
    assert shown.alt == pytest.approx(place.alt / 1e3, abs=0.2)
    assert shown.heading == pytest.approx(place.hdg / 100.0, abs=1.0)
    assert abs(shown.climb) < 0.5 and shown.groundspeed < 0.5
