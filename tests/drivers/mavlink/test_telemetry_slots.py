"""What is made of each thing a vehicle tells, slot by slot, without MAVSDK."""

from __future__ import annotations

import json
import math
import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.interfaces import FlightMode, VehicleError
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.telemetry import KEPT_TEXTS, RC_RECEIVER, TelemetrySlots
from tests.doubles import WallClock
from tests.drivers.mavlink.mavsdk_bench import SYSID, TANGENT

ARMED, OFFBOARD = 129, 6 << 16
PARTS = ("present", "enabled", "health")


class Slots:
    """The slots of one vehicle, and a way to tell them things."""

    def __init__(self, **options: Any) -> None:
        self.telemetry = TelemetrySlots(SYSID, WallClock(), TANGENT, **options)
        self.telemetry.kind = PX4
        self.telemetry.check()

    def message(
        self, name: str, fields: dict[str, Any], sysid: int = SYSID, component: int = 1
    ) -> None:
        handler = getattr(self.telemetry, f"_on_{name}")
        handler(
            SimpleNamespace(system_id=sysid, component_id=component, fields_json=json.dumps(fields))
        )

    def beat(self, base: int = ARMED, mode: int = OFFBOARD, **more: int) -> None:
        self.message("heartbeat", {"autopilot": 12, "base_mode": base, "custom_mode": mode, **more})

    def text(self, said: str, severity: int = 4) -> None:
        self.telemetry._on_text(SimpleNamespace(text=said, type=severity))

    def attitude(self) -> None:
        self.telemetry._on_attitude(SimpleNamespace(w=0.5, x=-0.5, y=0.5, z=-0.5))

    def position(
        self, north_m: float = 3.0, east_m: float = -4.0, down_m: float = -2.0, above_m: float = 2.5
    ) -> None:
        latitude, longitude, altitude_m = TANGENT.to_global(north_m, east_m, down_m)
        self.telemetry._on_position(
            SimpleNamespace(
                latitude_deg=latitude,
                longitude_deg=longitude,
                absolute_altitude_m=altitude_m,
                relative_altitude_m=above_m,
            )
        )

    def velocity(self, down_m: float = -1.0) -> None:
        self.telemetry._on_velocity(
            SimpleNamespace(
                position=SimpleNamespace(down_m=down_m),
                velocity=SimpleNamespace(north_m_s=0.1, east_m_s=0.2, down_m_s=0.3),
            )
        )


def test_the_state_is_all_that_was_told() -> None:
    slots = Slots()
    slots.beat()
    time.sleep(0.002)
    slots.attitude()
    without = slots.telemetry.state()
    assert (
        without.stamp_ns == 0
        and math.isnan(without.position_n_m[0])
        and math.isnan(without.velocity_n_mps[0])
    )
    assert not without.armable and not without.in_air
    time.sleep(0.002)
    slots.position()
    slots.velocity()
    slots.telemetry._on_in_air(1)
    state, telemetry = slots.telemetry.state(), slots.telemetry
    assert (
        telemetry.attitude is not None
        and telemetry.position is not None
        and telemetry.heartbeat is not None
    )
    assert (
        telemetry.heartbeat.arrival_ns
        < telemetry.attitude.arrival_ns
        < telemetry.position.arrival_ns
    )
    assert state.stamp_ns == telemetry.attitude.arrival_ns  # the older of the two
    assert state.heartbeat_ns == telemetry.heartbeat.arrival_ns
    assert state.position_n_m == pytest.approx((3.0, -4.0, -2.0), abs=1e-6)
    assert state.velocity_n_mps == (0.1, 0.2, 0.3) and state.q_n_b == (0.5, -0.5, 0.5, -0.5)
    assert (state.armed, state.in_air, state.mode) == (True, True, FlightMode.OFFBOARD)
    assert (state.mode_told, state.armed_told, state.resets) == (1, 1, None)
    assert telemetry.attitude_at(state.stamp_ns) == pytest.approx((0.5, -0.5, 0.5, -0.5))
    slots.attitude()
    assert slots.telemetry.state().stamp_ns == telemetry.position.arrival_ns


@pytest.mark.parametrize("told", ["", "heartbeat", "attitude"])
def test_there_is_no_state_before_heartbeat_and_attitude(told: str) -> None:
    slots = Slots()
    if told == "heartbeat":
        slots.beat()
    if told == "attitude":
        slots.attitude()
    with pytest.raises(VehicleError, match="not connected"):
        slots.telemetry.state()


def test_who_the_vehicle_is_is_not_known_before_it_is_opened() -> None:
    slots = Slots()
    assert slots.telemetry.known_kind is PX4
    slots.telemetry.kind = None
    with pytest.raises(VehicleError, match="not connected"):
        _ = slots.telemetry.known_kind
    assert (slots.telemetry.mode, slots.telemetry.mode_told) == (FlightMode.OTHER, 0)


def test_it_is_counted_how_many_messages_in_a_row_say_the_same() -> None:
    slots = Slots()
    told: list[tuple[int, int]] = []
    for base, mode in (
        (ARMED, OFFBOARD),
        (ARMED, OFFBOARD),
        (1, OFFBOARD),
        (1, 3 << 16),
        (ARMED, 3 << 16),
    ):
        slots.beat(base, mode)
        assert slots.telemetry.heartbeat is not None
        told.append((slots.telemetry.heartbeat.told, slots.telemetry.mode_told))
    assert told == [(1, 1), (2, 2), (1, 3), (2, 1), (1, 2)]


@pytest.mark.parametrize(
    ("base", "more", "armed", "disarmed"),
    [(ARMED, {}, True, False), (1, {}, False, True), (ARMED, {"system_status": 8}, False, False)],
)
def test_motors_that_a_pilot_stopped_are_not_disarmed(
    base: int, more: dict[str, int], armed: bool, disarmed: bool
) -> None:
    slots = Slots()
    slots.beat(base, **more)
    heartbeat = slots.telemetry.heartbeat
    assert heartbeat is not None
    assert (heartbeat.armed, heartbeat.disarmed, heartbeat.autopilot) == (armed, disarmed, 12)


def test_a_stop_that_a_text_tells_of_holds_until_it_is_taken_back_or_disarmed() -> None:
    slots = Slots()

    def armed_after(text: str = "", base: int = ARMED) -> bool:
        if text:
            slots.text(text)
        slots.beat(base)
        assert slots.telemetry.heartbeat is not None
        return slots.telemetry.heartbeat.armed

    assert armed_after()
    assert not armed_after("RC7: MotorEStop HIGH")
    assert not armed_after()
    assert armed_after("RC7: MotorEStop LOW")
    assert not armed_after("RC7: MotorEStop HIGH")
    assert not armed_after(base=1)
    assert armed_after()  # a new flight


def test_texts_of_warning_and_worse_are_told_once_each_in_their_order() -> None:
    slots = Slots()
    slots.text("long ago")
    time.sleep(0.002)
    since_ns = slots.telemetry.clock.now_ns()
    for said, severity in (("compass", 3), ("hello", 2), ("crash", 5), ("compass", 4)):
        slots.text(said, severity)
    assert slots.telemetry.texts_since(since_ns) == ["compass", "crash"]
    assert slots.telemetry.texts_since(since_ns, 4) == ["crash", "compass"]
    assert slots.telemetry.texts_since(0)[0] == "long ago"
    for number in range(2 * KEPT_TEXTS):
        slots.text(f"text {number}")
    kept = slots.telemetry.texts_since(0)
    assert len(kept) == KEPT_TEXTS and kept[-1] == f"text {2 * KEPT_TEXTS - 1}"


@pytest.mark.parametrize("without_gps", [False, True])
def test_what_is_missing_for_a_flight_is_named(without_gps: bool) -> None:
    slots = Slots(without_gps=without_gps)
    gps = [] if without_gps else ["global position"]
    parts = ["position telemetry", "local position telemetry"]
    assert slots.telemetry.missing() == [
        "arming checks",
        "local position",
        *gps,
        "home position",
        *parts,
    ]
    names = ("is_armable", "is_local_position_ok", "is_global_position_ok", "is_home_position_ok")
    slots.telemetry._on_health(SimpleNamespace(**dict.fromkeys(names, True)))
    assert slots.telemetry.missing() == parts
    slots.position()
    assert slots.telemetry.missing() == parts[1:]
    slots.velocity()
    assert slots.telemetry.missing() == []
    slots.telemetry._on_health(SimpleNamespace(**dict.fromkeys(names, True), is_armable_too=False))
    assert slots.telemetry.missing() == []


def test_answers_parameters_and_versions_are_the_vehicle_s_own() -> None:
    slots = Slots()
    telemetry = slots.telemetry
    for sysid in (SYSID + 1, SYSID):
        slots.message("ack", {"command": 22, "result": 4}, sysid)
        slots.message("parameter", {"param_id": "MIS_TAKEOFF_ALT", "param_value": 2.5}, sysid)
        slots.message("version", {"flight_sw_version": 0x010E03FF}, sysid)
        if sysid != SYSID:
            assert (telemetry.acks, telemetry.parameter, telemetry.firmware) == ({}, None, None)
    assert (telemetry.acks[22].command, telemetry.acks[22].result) == (22, 4)
    assert telemetry.acks[22].arrival_ns <= telemetry.clock.now_ns()
    assert telemetry.parameter is not None
    assert (telemetry.parameter.name, telemetry.parameter.value) == ("MIS_TAKEOFF_ALT", 2.5)
    assert telemetry.firmware == "1.14.3"
    slots.message("parameter", {"param_id": "X", "param_value": None})
    assert math.isnan(telemetry.parameter.value)


@pytest.mark.parametrize("lacks", [None, *PARTS])
def test_a_pilot_s_radio_is_heard_when_it_is_there_and_on_and_well(lacks: str | None) -> None:
    slots = Slots()
    sensors = {
        f"onboard_control_sensors_{part}": 1 if part == lacks else RC_RECEIVER | 1 for part in PARTS
    }
    slots.message("sys_status", {"battery_remaining": None, **sensors}, component=2)
    assert not slots.telemetry.radio_heard and slots.telemetry.battery.told_ns is None  # a camera's
    slots.message("sys_status", {"battery_remaining": 40, **sensors})
    assert slots.telemetry.radio_heard is (lacks is None)
    slots.beat()
    slots.attitude()
    assert (slots.telemetry.state().radio, slots.telemetry.state().gps) == (lacks is None, None)
    slots.message("gps", {"fix_type": 5, "satellites_visible": 14})
    slots.message("gps", {"fix_type": 1, "satellites_visible": 2}, component=2)  # a beacon's
    assert slots.telemetry.state().gps == (5, 14)
    assert slots.telemetry.battery.level == pytest.approx(0.4)


def test_a_battery_without_a_percentage_is_of_an_unknown_level() -> None:
    slots = Slots()
    slots.message("battery", {"id": 0, "battery_function": 1, "battery_remaining": 70}, component=9)
    slots.message("battery", {"id": 0, "battery_function": 1, "battery_remaining": None})
    assert math.isnan(slots.telemetry.battery.level) and slots.telemetry.battery.heard
    slots.message("battery", {"id": 0, "battery_function": 1, "battery_remaining": 60})
    assert slots.telemetry.battery.level == pytest.approx(0.6)


@pytest.mark.parametrize(("from_home", "height_m"), [(False, 2.0), (True, 1.75)])
def test_heights_are_above_the_sea_or_above_where_a_px4_was_armed(
    from_home: bool, height_m: float
) -> None:
    slots = Slots(height_from_home=from_home)
    slots.beat(1)
    slots.velocity(0.25)
    slots.beat(ARMED)
    slots.velocity(-1.5)
    slots.position(above_m=9.0)
    position = slots.telemetry.position
    assert position is not None
    assert position.n_m == pytest.approx((3.0, -4.0, -height_m), abs=1e-6)
    assert position.above_home_m == pytest.approx(1.75)
    assert position.altitude_m == pytest.approx(TANGENT.to_global(0.0, 0.0, -2.0)[2])
    slots.telemetry.kind = ARDUPILOT
    slots.position(above_m=9.0)
    assert slots.telemetry.position is not None
    assert slots.telemetry.position.above_home_m == 9.0


def test_a_handler_that_fails_is_told_with_its_first_error() -> None:
    slots = Slots()

    def fail(value: object) -> None:
        raise ValueError(f"cannot read {value}")

    guarded = slots.telemetry._guarded(fail)
    guarded("this", None)
    guarded("that", None)
    with pytest.raises(VehicleError, match="cannot read this"):
        slots.telemetry.check()


def test_the_rate_of_each_stream_is_that_of_what_arrives() -> None:
    slots = Slots()
    counts: dict[str, list[int]] = {name: [] for name in slots.telemetry.arrivals}
    for name, arrivals in slots.telemetry.arrivals.items():
        setattr(arrivals, "add", counts[name].append)  # noqa: B010
    slots.position()
    slots.velocity()
    slots.velocity()
    slots.attitude()
    assert {name: len(stamps) for name, stamps in counts.items()} == {
        "position": 1, "local position": 2, "attitude": 1
    }  # fmt: skip
