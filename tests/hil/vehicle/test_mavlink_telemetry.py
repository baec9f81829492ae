"""The embedded MAVLink vehicle's streams, texts and parameters, in simulated time, against a raw
socket.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from hil.vehicle.arrival import Address
from hil.vehicle.channel import UdpChannel
from tests.exact_world import QUICK
from tests.hil.vehicle.mavlink_bench import START, STEP_S, SYSID, TANGENT, Bench


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


def test_what_is_due_at_one_instant_is_one_datagram(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    )
    assert bench.of("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert bench.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_ACCEPTED
    assert bench.of("HEARTBEAT")[-1].custom_mode == 4 << 16 | 2 << 24


def test_arming_too_early_is_denied_with_its_reason_in_text(bench: Bench) -> None:
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0)
        == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    )
    assert [text.text for text in bench.of("STATUSTEXT")] == [
        "Arming denied: position estimate is settling"
    ]
    assert not bench.drone.autopilot.armed


def test_there_is_no_global_position_before_the_estimate_has_settled(bench: Bench) -> None:
    bench.run(0.1)
    assert bench.of("GLOBAL_POSITION_INT") == []
    assert (
        bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242.0)
        == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    )
    bench.run(0.6)
    there = bench.of("GLOBAL_POSITION_INT")[-1]
    assert TANGENT.to_ned(there.lat * 1e-7, there.lon * 1e-7, there.alt * 1e-3) == pytest.approx(
        START, abs=0.012
    )
    assert bench.of("LOCAL_POSITION_NED")[-1].x == pytest.approx(0.0, abs=1e-6)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242.0) == mavlink.MAV_RESULT_ACCEPTED
    assert len(bench.of("HOME_POSITION")) == 1
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0) == mavlink.MAV_RESULT_ACCEPTED
    assert len(bench.of("AUTOPILOT_VERSION")) == 1


def test_the_prearm_bit_follows_the_autopilot(bench: Bench) -> None:
    bench.run(0.1)
    assert (
        not bench.of("SYS_STATUS")[-1].onboard_control_sensors_health
        & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    )
    bench.run(0.6)
    assert (
        bench.of("SYS_STATUS")[-1].onboard_control_sensors_health
        & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    )


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
    # out of its bounds
    assert set_to(b"COM_OF_LOSS_T", 60.5) == pytest.approx(QUICK.offboard_loss_s)
    assert set_to(b"COM_OF_LOSS_T", 2.0) == 2.0
    assert bench.drone.autopilot.config.offboard_loss_s == 2.0
    assert set_to(b"COM_RC_IN_MODE", 4.0) == 0.0  # of another type
    ignored = struct.unpack("<f", struct.pack("<i", 4))[0]
    assert set_to(b"COM_RC_IN_MODE", ignored, 6) == ignored
    assert not bench.drone.autopilot.config.radio.hears
    set_to(b"COM_OBL_RC_ACT", struct.unpack("<f", struct.pack("<i", 0))[0], 6)
    # it lands
    assert struct.unpack("<i", struct.pack("<f", bench.of("PARAM_VALUE")[-1].param_value)) == (4,)


@pytest.fixture
def slow_beat() -> Iterator[Bench]:
    made = Bench(replace(QUICK, heartbeat_hz=1.0, companion_loss_s=0.5))
    yield made
    made.close()


def test_one_that_beats_at_its_own_rate_shows_a_change_with_the_next_beat(slow_beat: Bench) -> None:
    bench = slow_beat
    assert (
        bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0.0, 2e5) == mavlink.MAV_RESULT_ACCEPTED
    )
    bench.run(0.6)
    assert (
        bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    )
    assert bench.of("HEARTBEAT") == []
    bench.run(4.0)
    assert len(bench.of("HEARTBEAT")) == 4
    assert bench.of("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_a_ground_stations_heartbeat_is_heard_and_a_companions_is_none(slow_beat: Bench) -> None:
    bench = slow_beat

    def beat(kind: int) -> None:
        bench.send(
            mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        )

    bench.fly_at()
    bench.run(1.0, lambda: beat(mavlink.MAV_TYPE_GCS))
    assert bench.drone.autopilot.mode is FlightMode.HOLD
    bench.run(0.7, lambda: beat(mavlink.MAV_TYPE_ONBOARD_CONTROLLER))
    assert bench.drone.autopilot.mode is FlightMode.LAND
