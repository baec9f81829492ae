"""What the guard makes of each message of a vehicle, what it asks for and when, on a port that
stands in.
"""

from __future__ import annotations

import asyncio
import math
from types import SimpleNamespace
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView
from drivers.mavlink.guard_link import GuardMavlink, GuardMavlinkConfig
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, SYSID, TANGENT
from tests.drivers.mavlink.test_answers import Port

S = 1_000_000_000
ARMED = 128 | 1
PX4_OFFBOARD, PX4_HOLD, PX4_POSCTL = 6 << 16, 4 << 16 | 3 << 24, 3 << 16
PX4, ARDUPILOT = 12, 3


class Guard:
    """The guard's link to one vehicle, on a clock that stands still until it is told."""

    def __init__(self, **options: Any) -> None:
        config = GuardMavlinkConfig(
            url="udpin://127.0.0.1:14551", bind="127.0.0.1:14561", vehicle_sysid=SYSID, **options
        )
        self.now_ns = 1000 * S
        clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        context = cast(Any, SimpleNamespace(clock=clock, origin=CONTEXT.origin))
        self.link, self.port = GuardMavlink(config, context), Port()
        cast(Any, self.link)._port = self.port

    def hears(self, *messages: Any, component: int = 1) -> GuardView | None:
        for message in messages:
            mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=component)
            self.port.waiting.append(mav.decode(bytearray(message.pack(mav))))
        return self.link.view()

    def view(self, *messages: Any, component: int = 1) -> GuardView:
        view = self.hears(*messages, component=component)
        assert view is not None
        return view

    def sent(self, kind: str) -> list[Any]:
        """What was sent since the last time, of one kind."""
        found = [each for each in self.port.sent if each.get_type() == kind]
        self.port.sent = [each for each in self.port.sent if each.get_type() != kind]
        return found


def beat(base: int = ARMED, mode: int = PX4_OFFBOARD, autopilot: int = PX4, status: int = 4) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, autopilot, base, mode, status, 3)


def place(north_m: float, east_m: float, down_m: float, above_m: float = 0.0) -> Any:
    latitude, longitude, altitude_m = TANGENT.to_global(north_m, east_m, down_m)
    return mavlink.MAVLink_global_position_int_message(
        0,
        round(latitude * 1e7),
        round(longitude * 1e7),
        round(altitude_m * 1e3),
        round(above_m * 1e3),
        0,
        0,
        0,
        0,
    )


def local(down_m: float) -> Any:
    return mavlink.MAVLink_local_position_ned_message(0, 7.0, 8.0, down_m, 0.0, 0.0, 0.0)


def text(said: str) -> Any:
    return mavlink.MAVLink_statustext_message(2, said.encode())


def test_a_vehicle_that_was_never_heard_is_not_seen_and_not_commanded() -> None:
    guard = Guard()
    assert guard.hears(place(1.0, 2.0, -3.0)) is None
    guard.link.hold()
    guard.link.land()
    assert guard.sent("COMMAND_LONG") == []
    assert guard.hears(beat(autopilot=8)) is None  # a gimbal's, or a camera's


def test_the_view_is_what_the_vehicle_told() -> None:
    guard = Guard()
    beat_ns = guard.now_ns
    before = guard.view(beat())
    assert (before.heartbeat_ns, before.position_ns, before.armed, before.in_air) == (
        beat_ns,
        0,
        True,
        True,
    )
    north, east, down = before.position_n_m
    assert all(map(math.isnan, (north, east, down, before.battery)))
    assert (before.mode, before.mode_told, before.acked) == (FlightMode.OFFBOARD, 1, None)
    guard.now_ns += S
    view = guard.view(
        place(12.0, -7.0, -3.0),
        mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND),
    )
    assert view.position_n_m == pytest.approx((12.0, -7.0, -3.0), abs=0.02)
    assert (view.heartbeat_ns, view.position_ns, view.in_air) == (beat_ns, beat_ns + S, False)


@pytest.mark.parametrize(
    ("base", "status", "armed"), [(ARMED, 4, True), (1, 4, False), (ARMED, 8, False)]
)
def test_a_vehicle_whose_motors_were_stopped_is_not_armed(
    base: int, status: int, armed: bool
) -> None:
    assert Guard().view(beat(base, status=status)).armed is armed


def test_a_pilot_s_stop_is_believed_by_its_text_until_it_is_taken_back_or_disarmed() -> None:
    guard = Guard()
    assert (
        guard.view(beat(autopilot=ARDUPILOT, mode=4), text("RC7: MotorEStop HIGH")).armed is False
    )
    assert guard.view(beat(autopilot=ARDUPILOT, mode=4)).armed is False
    assert guard.view(text("EKF3 IMU0 is using GPS")).armed is False
    assert guard.view(text("RC7: MotorEStop LOW")).armed is True
    guard.view(text("RC7: MotorEStop HIGH"), beat(1, 4, ARDUPILOT))
    assert guard.view(beat(ARMED, 4, ARDUPILOT)).armed is True


def test_modes_are_counted_by_how_many_messages_in_a_row_say_them() -> None:
    guard = Guard()
    assert guard.view(beat(), beat()).mode_told == 2
    view = guard.view(beat(mode=PX4_POSCTL))
    assert (view.mode, view.mode_told) == (FlightMode.OTHER, 1)
    said = mavlink.MAVLink_current_mode_message(0, PX4_HOLD, PX4_HOLD)
    view = guard.view(said)
    assert (view.mode, view.mode_told) == (FlightMode.HOLD, 1)
    again = mavlink.MAVLink_current_mode_message(0, PX4_OFFBOARD, PX4_OFFBOARD)
    assert guard.view(again).mode is FlightMode.HOLD  # that only a heartbeat is believed


def test_a_mode_before_any_heartbeat_says_nothing() -> None:
    guard = Guard()
    assert guard.hears(mavlink.MAVLink_current_mode_message(0, PX4_HOLD, PX4_HOLD)) is None
    assert guard.view(beat()).mode_told == 1


@pytest.mark.parametrize(("autopilot", "height_m"), [(PX4, 1.75), (ARDUPILOT, 2.25)])
def test_a_height_from_home_is_the_local_frame_s_on_a_px4_and_the_told_one_else(
    autopilot: int, height_m: float
) -> None:
    guard = Guard(height_from="home")
    guard.view(beat(1, 0, autopilot), local(0.5), local(0.25))
    guard.view(beat(ARMED, 0, autopilot), local(-1.5))
    view = guard.view(place(12.0, -7.0, -9.0, above_m=2.25))
    assert view.position_n_m[:2] == pytest.approx((12.0, -7.0), abs=0.02)
    assert view.position_n_m[2] == pytest.approx(-height_m)


def test_a_px4_that_was_met_in_the_air_is_believed_its_height() -> None:
    guard = Guard(height_from="home")
    guard.view(local(-1.0), beat(), local(-1.5))
    assert guard.view(place(0.0, 0.0, -9.0, above_m=2.25)).position_n_m[2] == pytest.approx(-2.25)


def battery(percent: int, component: int = 1) -> Any:
    del component
    return mavlink.MAVLink_battery_status_message(0, 0, 1, 0, [0] * 10, 0, 0, 0, percent)


def test_the_battery_is_the_autopilot_s_own() -> None:
    guard = Guard()
    guard.view(beat())
    assert math.isnan(guard.view(battery(8), component=180).battery)
    assert guard.view(battery(80)).battery == pytest.approx(0.8)
    assert guard.view().battery_ns == guard.now_ns


def test_a_battery_that_only_sys_status_tells_of_is_told_of() -> None:
    guard = Guard()
    guard.view(beat())
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 55, 0, 0, 0, 0, 0, 0)
    assert guard.view(status).battery == pytest.approx(0.55)


# --- what it sends


@pytest.mark.parametrize(
    ("autopilot", "hold"), [(PX4, (176, 1, 4, 3)), (ARDUPILOT, (176, 1, 17, 0))]
)
def test_a_hold_and_a_landing_are_one_packet_each_to_the_autopilot(
    autopilot: int, hold: tuple[int, ...]
) -> None:
    guard = Guard()
    guard.view(beat(autopilot=autopilot))
    guard.port.sent.clear()
    guard.link.hold()
    (sent,) = guard.sent("COMMAND_LONG")
    assert (sent.command, sent.param1, sent.param2, sent.param3) == hold
    assert (sent.target_system, sent.target_component, sent.confirmation) == (SYSID, 1, 0)
    assert (sent.param4, sent.param5, sent.param6, sent.param7) == (0.0, 0.0, 0.0, 0.0)
    guard.link.land()
    (sent,) = guard.sent("COMMAND_LONG")
    unset = [sent.param4, sent.param5, sent.param6]
    assert (sent.command, sent.param1, sent.param2, sent.param3, sent.param7) == (
        21,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    assert all(math.isnan(value) for value in unset) if autopilot == PX4 else unset == [0.0] * 3


def test_what_its_port_ignores_is_told_while_it_is_open() -> None:
    guard = Guard()
    ignored = {"a second vehicle 7, at 127.0.0.1:2222": 5}
    cast(Any, guard.port).ignored = ignored
    assert guard.link.ignored == ignored
    cast(Any, guard.link)._port = None
    assert guard.link.ignored == {} and guard.link.view() is None


def test_it_says_once_a_second_who_it_is() -> None:
    guard = Guard()
    guard.link.view()
    (own,) = guard.sent("HEARTBEAT")
    assert (own.type, own.autopilot, own.base_mode, own.custom_mode, own.system_status) == (
        18,
        8,
        0,
        0,
        4,
    )
    guard.now_ns += S - 1
    guard.link.view()
    assert guard.sent("HEARTBEAT") == []
    guard.now_ns += 1
    guard.link.view()
    assert len(guard.sent("HEARTBEAT")) == 1


def asked(guard: Guard) -> dict[int, float]:
    """The messages that it has just asked for, and how often, in Hz."""
    sent = guard.sent("COMMAND_LONG")
    assert all(each.command == 511 for each in sent)
    return {int(each.param1): 1e6 / each.param2 for each in sent}


def test_everything_is_asked_for_again_every_three_seconds_while_positions_are_late() -> None:
    guard = Guard()
    guard.link.view()
    assert asked(guard) == {}  # there is nobody to ask
    guard.view(beat())
    everything = {0: 10.0, 436: 10.0, 32: 10.0, 33: 10.0, 245: 5.0, 1: 2.0, 147: 1.0}
    assert asked(guard) == pytest.approx(everything)
    guard.now_ns += 3 * S - 1
    guard.view(beat())
    assert asked(guard) == {}
    guard.now_ns += 1
    guard.view(beat())
    assert asked(guard) == pytest.approx(everything)


@pytest.mark.parametrize(("late_ns", "asks"), [(0, False), (1, True)])
def test_positions_are_late_after_a_second(late_ns: int, asks: bool) -> None:
    guard = Guard()
    guard.view(beat(), place(0.0, 0.0, -1.0), battery(80))
    asked(guard)
    guard.now_ns += 3 * S
    guard.view(place(0.0, 0.0, -1.0))
    guard.now_ns += S + late_ns
    asked(guard)
    guard.view(beat())
    assert bool(asked(guard)) is asks


def test_a_battery_that_is_not_told_of_is_asked_for_five_times() -> None:
    guard = Guard()
    times = 0
    for _ in range(12):
        guard.view(beat(), place(0.0, 0.0, -1.0))
        found = asked(guard)
        assert found in ({}, pytest.approx({147: 1.0}))
        times += bool(found)
        guard.now_ns += 3 * S
    assert times == 5


def test_a_battery_that_is_told_of_is_not_asked_for() -> None:
    guard = Guard()
    for _ in range(4):
        guard.view(beat(), place(0.0, 0.0, -1.0), battery(80))
        assert asked(guard) == {}
        guard.now_ns += 3 * S


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"bind": "192.168.1.5:14561"}, "own computer"),
        ({"vehicle_sysid": 246}, "must differ"),
        ({"url": "tcp://127.0.0.1:1"}, "is not like"),
        ({"vehicle_sysid": 0}, "vehicle_sysid"),
        ({"battery_id": -2}, "battery_id"),
    ],
)
def test_a_guard_s_table_that_cannot_be_is_refused(options: dict[str, Any], said: str) -> None:
    usual: dict[str, Any] = {"url": "udpin://127.0.0.1:14551", "bind": "127.0.0.1:14561"}
    with pytest.raises(ValueError, match=said):
        GuardMavlinkConfig(**(usual | options))


def test_the_guard_s_port_is_opened_for_its_vehicle_and_closed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[tuple[Any, ...]] = []
    closed: list[bool] = []

    def port(*args: Any) -> Any:
        opened.append(args)
        return SimpleNamespace(close=lambda: closed.append(True))

    monkeypatch.setattr("drivers.mavlink.guard_link.MavlinkPort", port)
    config = GuardMavlinkConfig(
        url="udpin://127.0.0.1:14551", bind="127.0.0.1:14561", vehicle_sysid=SYSID
    )

    async def main() -> None:
        link = GuardMavlink(config, CONTEXT)
        async with link as same:
            assert same is link and closed == []
        assert closed == [True]
        await link.__aexit__()
        assert closed == [True]

    asyncio.run(main())
    ((url, sysid, own, wanted, now_ns, key),) = opened
    assert (url, sysid, own, key) == (config.url, SYSID, (246, 191), None)
    assert wanted == {0, 1, 32, 33, 77, 147, 245, 253, 436}
    assert now_ns == CONTEXT.clock.now_ns
