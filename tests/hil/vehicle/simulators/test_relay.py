"""The relay between an autopilot and its companion: every byte passes, and what it sees is what was
on the wire.
"""

import socket
import time
from collections.abc import Callable, Generator
from types import SimpleNamespace
from typing import cast

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.modes import ARDUPILOT, PX4, px4_custom_mode
from hil.vehicle.simulators.followed_world import RemoteAutopilot
from hil.vehicle.simulators.link import SimulatorLink
from hil.vehicle.simulators.relay import DO_SET_MODE, NAV_LAND, FlightWatch, MavlinkRelay
from tests.kernel_stamps import wait_for_stamps

ARMED, DISARMED = 0x81, 0x01
OFFBOARD, HOLD = px4_custom_mode(6, 0), px4_custom_mode(4, 3)
SYSID = 5
CLOCKS_S = 0.005  # between the kernel's stamps and the monotonic clock


def px4_in_offboard() -> FlightWatch:
    watch = FlightWatch(PX4)
    watch.on_heartbeat(0.0, OFFBOARD, ARMED)
    watch.on_setpoint(1.0)
    return watch


def test_the_longest_time_between_setpoints_is_found() -> None:
    watch = px4_in_offboard()
    for at_s in (1.05, 1.10, 1.45, 1.5):
        watch.on_setpoint(at_s)
    watch.on_heartbeat(1.6, HOLD, ARMED)
    (session,) = watch.offboard_sessions
    assert session.max_gap_s == pytest.approx(0.35)
    assert (session.end_s, session.ended_by) == (1.6, FlightMode.HOLD)


def test_setpoints_that_stop_are_a_gap_until_the_vehicle_leaves_the_mode() -> None:
    watch = px4_in_offboard()
    watch.on_heartbeat(1.9, HOLD, ARMED)
    assert watch.setpoint_gap_s == pytest.approx(0.9)


def test_a_session_ends_when_the_mode_is_told_and_not_a_heartbeat_later() -> None:
    watch = px4_in_offboard()
    watch.on_setpoint(1.05)
    watch.on_mode(1.5, HOLD)
    watch.on_heartbeat(2.0, HOLD, ARMED)
    (session,) = watch.offboard_sessions
    assert (session.end_s, session.ended_by, session.max_gap_s) == (
        1.5,
        FlightMode.HOLD,
        pytest.approx(0.45),
    )


@pytest.mark.parametrize(("command", "param2"), [(NAV_LAND, 0.0), (DO_SET_MODE, 4.0)])
def test_leaving_by_command_is_no_gap_however_late_the_heartbeat(
    command: int, param2: float
) -> None:
    watch = px4_in_offboard()
    watch.on_command(1.02, command, param2)
    watch.on_setpoint(1.04)  # one that was under way
    watch.on_heartbeat(2.0, HOLD, ARMED)
    assert watch.setpoint_gap_s == pytest.approx(0.02)
    assert len(watch.offboard_sessions) == 1


def test_ardupilot_climbs_in_guided_without_setpoints() -> None:
    watch = FlightWatch(ARDUPILOT)
    watch.on_heartbeat(0.0, 4, ARMED)
    watch.on_heartbeat(9.0, 4, ARMED)
    assert watch.offboard_sessions == []
    watch.on_setpoint(9.0)
    watch.on_setpoint(9.05)
    assert watch.setpoint_gap_s == pytest.approx(0.05)


def test_to_a_vehicle_whose_motors_its_pilot_stopped_nobody_owes_a_setpoint() -> None:
    watch = px4_in_offboard()
    watch.on_setpoint(1.05)
    for at_s in (1.1, 1.11):  # the switch stays where it is
        watch.on_kill_switch(at_s)
    watch.on_setpoint(1.3)  # sent before the script could know
    watch.on_heartbeat(1.9, OFFBOARD, ARMED)  # and so it says for 5 s
    watch.on_heartbeat(6.2, OFFBOARD, DISARMED)
    (session,) = watch.offboard_sessions
    assert session.max_gap_s == pytest.approx(0.05)
    assert (session.end_s, watch.newest_setpoint_s) == (1.1, 1.3)
    watch.on_heartbeat(9.0, OFFBOARD, ARMED)
    watch.on_setpoint(9.1)
    assert len(watch.offboard_sessions) == 2


def test_setpoints_on_the_ground_are_no_flight() -> None:
    watch = FlightWatch(PX4)
    watch.on_heartbeat(0.0, OFFBOARD, DISARMED)
    watch.on_setpoint(1.0)
    assert watch.offboard_sessions == []


class Ends:
    """A relay with the autopilot's socket on one side and the companion's on the other."""

    def __init__(self) -> None:
        self.companion = _socket()
        self.vehicle = _socket()
        self.relay = MavlinkRelay("px4", SYSID, ("127.0.0.1", 0), self.companion.getsockname())
        self.vehicle_side = self.relay.sockets[0].getsockname()
        self.mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)

    def pass_on(self, to: socket.socket) -> bytes:
        """Returns what arrives there next; b'' when nothing does."""
        self.relay.receive(0.0)
        try:
            return to.recv(4096)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        self.relay.close()
        self.companion.close()
        self.vehicle.close()


def _socket() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.setblocking(False)
    return made


@pytest.fixture
def ends() -> Generator[Ends, None, None]:
    made = Ends()
    try:
        yield made
    finally:
        made.close()


def heartbeat(ends: Ends, mode: int = OFFBOARD, base_mode: int = ARMED) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(2, 12, base_mode, mode, 4, 3)
    return bytes(message.pack(ends.mav))


def test_packets_pass_unchanged_and_are_understood(ends: Ends) -> None:
    packet = heartbeat(ends) + heartbeat(ends)  # PX4 puts many messages into one datagram
    ends.vehicle.sendto(packet, ends.vehicle_side)
    assert ends.pass_on(ends.companion) == packet
    assert ends.relay.watch.armed
    assert ends.relay.watch.mode is FlightMode.OFFBOARD


def test_answers_go_back_to_the_vehicle(ends: Ends) -> None:
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    ends.relay.receive(0.0)
    ends.companion.sendto(b"anything", ends.relay.sockets[1].getsockname())
    assert ends.pass_on(ends.vehicle) == b"anything"


@pytest.mark.parametrize(
    "garbage", [b"", b"\xfd", b"\xfd\xff\x00", b"not mavlink at all", b"\xfe\x09\x00\x01\x01\x00"]
)
def test_what_is_no_mavlink_passes_too(ends: Ends, garbage: bytes) -> None:
    ends.vehicle.sendto(garbage, ends.vehicle_side)
    assert ends.pass_on(ends.companion) == garbage


def test_a_cut_cable_carries_nothing(ends: Ends) -> None:
    ends.relay.silent = True
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    assert ends.pass_on(ends.companion) == b""
    assert ends.relay.watch.armed  # the harness still sees what the vehicle does


def test_a_relay_that_was_busy_does_not_lengthen_the_gaps(ends: Ends) -> None:
    wait_for_stamps()
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    epoch_s = time.monotonic()
    ends.relay.receive(epoch_s)
    sent: list[tuple[float, float]] = []
    for _ in range(2):
        setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
            0, SYSID, 1, 1, 2503, *[0.0] * 11
        )
        before_s = time.monotonic()
        ends.companion.sendto(setpoint.pack(ends.mav), ends.relay.sockets[1].getsockname())
        sent.append((before_s, time.monotonic()))
        time.sleep(0.05)
    ends.relay.receive(epoch_s)  # both at once, the second one late
    (session,) = ends.relay.watch.offboard_sessions
    (first_before_s, first_after_s), (second_before_s, second_after_s) = sent
    assert session.start_s < first_after_s - epoch_s + CLOCKS_S
    assert (
        second_before_s - first_after_s - CLOCKS_S
        < session.max_gap_s
        < second_after_s - first_before_s + CLOCKS_S
    )


def test_a_mode_that_is_left_after_setpoints_was_not_left_before_them(ends: Ends) -> None:
    """However long the relay was busy, and from whichever side it reads first."""
    wait_for_stamps()
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    ends.relay.receive(0.0)
    for _ in range(3):
        setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
            0, SYSID, 1, 1, 2503, *[0.0] * 11
        )
        ends.companion.sendto(setpoint.pack(ends.mav), ends.relay.sockets[1].getsockname())
    ends.vehicle.sendto(heartbeat(ends, HOLD), ends.vehicle_side)
    ends.relay.receive(0.0)
    (session,) = ends.relay.watch.offboard_sessions
    assert session.end_s is not None
    assert session.end_s >= ends.relay.watch.newest_setpoint_s


def test_a_pilot_changes_the_mode(ends: Ends) -> None:
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    ends.relay.receive(0.0)
    ends.relay.pilot_takes_over()
    decode: Callable[[bytearray], object] = ends.mav.decode
    command = decode(bytearray(ends.vehicle.recv(4096)))
    asked = command.command, command.param2, command.param3  # type: ignore[attr-defined]
    # HOLD: a PX4 without sticks refuses a pilot's own modes
    assert asked == (DO_SET_MODE, 4.0, 3.0)
    assert command.get_srcSystem() != SYSID  # type: ignore[attr-defined]


def test_a_vehicle_that_was_told_to_hold_is_its_pilots(ends: Ends) -> None:
    autopilot = RemoteAutopilot(ends.relay, cast(SimulatorLink, SimpleNamespace(battery=1.0)))
    ends.vehicle.sendto(heartbeat(ends), ends.vehicle_side)
    ends.relay.receive(0.0)
    assert autopilot.armed and not autopilot.pilot_in_control
    autopilot.request_mode(0.0, FlightMode.OTHER, by_pilot=True)
    assert autopilot.pilot_in_control  # from then on, whatever mode a script would select again
