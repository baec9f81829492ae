"""Which battery flies, and how full it is, from the messages alone."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.mavlink.battery import FlightBattery

FLIGHT, PAYLOAD = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_FUNCTION_PAYLOAD
UNKNOWN = mavlink.MAV_BATTERY_FUNCTION_UNKNOWN
NAN = math.nan
S = 10**9
Told = tuple[int, int, float]  # id, function, percent; id -1: a SYS_STATUS


def test_it_could_tell_since_the_vehicle_was_first_heard() -> None:
    battery = FlightBattery()
    battery.hear(5)
    battery.hear(9)
    assert battery.told_ns == 5 and not battery.heard
    battery.on_battery(0, 0, 80.0, 12)
    assert (battery.level, battery.told_ns) == (pytest.approx(0.8), 12)
    battery.hear(20)
    assert battery.told_ns == 12 and battery.trouble == ""


@pytest.mark.parametrize("percent", [-1.0, -0.1, 100.1, 255.0, NAN, math.inf])
def test_a_level_that_cannot_be_is_unknown_and_what_was_told_before_is_kept(percent: float) -> None:
    battery = FlightBattery()
    battery.on_battery(3, 0, percent, 5)
    assert not battery.known and battery.heard and battery.told_ns == 5
    assert battery.trouble.startswith("level of battery 3: it tells no percentage")
    battery.on_battery(3, 0, 40.0, 6)
    battery.on_battery(3, 0, percent, 7)
    assert (battery.level, battery.told_ns) == (pytest.approx(0.4), 6)
    empty = FlightBattery()
    empty.on_sys_status(percent, 5)
    assert not empty.known and empty.told_ns == 5


@pytest.mark.parametrize("percent", [0.0, 100.0])
def test_empty_and_full_are_levels(percent: float) -> None:
    battery = FlightBattery()
    battery.on_battery(0, 0, percent, 5)
    assert battery.level == percent / 100.0
    status = FlightBattery()
    status.on_sys_status(percent, 5)
    assert status.level == percent / 100.0 and not status.heard


@pytest.mark.parametrize(("function", "counts"), [(0, True), (1, True), (2, True), (3, False), (4, False)])  # fmt: skip
def test_what_serves_the_payload_or_the_avionics_does_not_fly_it(
    function: int, counts: bool
) -> None:
    battery = FlightBattery()
    battery.on_battery(0, function, 70.0, 5)
    assert battery.known is battery.heard is counts
    named = FlightBattery(0)  # the rig says that it flies it
    named.on_battery(0, function, 70.0, 5)
    assert named.level == pytest.approx(0.7)


def test_when_another_one_turns_out_to_fly_it_nothing_is_known_of_that_yet() -> None:
    battery = FlightBattery()
    battery.on_battery(2, 0, 90.0, 5)
    battery.on_battery(1, 0, -1.0, 6)
    assert math.isnan(battery.level) and battery.told_ns == 6
    assert "battery 1" in battery.trouble


def test_one_that_told_and_is_silent_again_is_not_named_for_it() -> None:
    battery = FlightBattery()
    battery.on_battery(0, 0, -1.0, 5)
    battery.on_battery(0, 0, 50.0, 6)
    battery.on_battery(1, 0, -1.0, 7)
    assert battery.known and battery.trouble == ""


@pytest.mark.parametrize(
    ("wanted", "told", "level"),
    [
        (-1, [(0, UNKNOWN, 90), (1, UNKNOWN, 8)], 0.9),
        (-1, [(1, UNKNOWN, 8), (0, UNKNOWN, 90)], 0.9),
        (-1, [(0, UNKNOWN, 90), (1, UNKNOWN, 8), (1, UNKNOWN, 8)], 0.9),
        (-1, [(0, PAYLOAD, 8), (1, FLIGHT, 90)], 0.9),
        (-1, [(1, FLIGHT, 90), (0, mavlink.MAV_BATTERY_FUNCTION_AVIONICS, 8)], 0.9),
        (-1, [(2, UNKNOWN, 70), (5, UNKNOWN, 8)], 0.7),
        (-1, [(0, UNKNOWN, 90), (-1, 0, 8)], 0.9),  # SYS_STATUS may be the emptiest of all
        (-1, [(0, UNKNOWN, 90), (1, UNKNOWN, 8), (-1, 0, 8)], 0.9),
        (-1, [(0, UNKNOWN, -1), (1, UNKNOWN, 8), (-1, 0, 8)], math.nan),
        (-1, [(-1, 0, 60)], 0.6),
        (-1, [(0, UNKNOWN, -1), (-1, 0, 60)], 0.6),
        (-1, [(0, UNKNOWN, 90), (0, UNKNOWN, -1), (-1, 0, -1)], 0.9),
        (-1, [(0, UNKNOWN, 90), (0, UNKNOWN, 255)], 0.9),
        (-1, [(0, UNKNOWN, 255), (-1, 0, -1)], math.nan),
        (-1, [(0, UNKNOWN, 0)], 0.0),
        (-1, [(0, UNKNOWN, 90), (0, UNKNOWN, 0)], 0.0),
        (1, [(0, UNKNOWN, 8), (1, PAYLOAD, 90)], 0.9),
        (1, [(0, UNKNOWN, 8), (-1, 0, 8)], math.nan),
    ],
)
def test_the_level_of_the_battery_that_flies(wanted: int, told: list[Told], level: float) -> None:
    battery = FlightBattery(wanted)
    for number, function, percent in told:
        if number < 0:
            battery.on_sys_status(percent, 1)
        else:
            battery.on_battery(number, function, percent, 1)
    assert battery.level == pytest.approx(level, nan_ok=True)
    assert battery.known is math.isfinite(level)


def test_when_it_was_told_is_kept_while_it_tells_nothing() -> None:
    battery = FlightBattery()
    battery.hear(3 * S)
    assert battery.told_ns == 3 * S
    battery.on_battery(0, UNKNOWN, 80, 5 * S)
    for second in range(6, 20):
        battery.on_battery(0, UNKNOWN, -1, second * S)
        battery.on_battery(1, UNKNOWN, 8, second * S)
    assert (battery.level, battery.told_ns) == (0.8, 5 * S)


@pytest.mark.parametrize(
    ("wanted", "told", "words"),
    [
        (-1, [], "battery level"),
        (-1, [(0, UNKNOWN, -1)], "battery 0: it tells no percentage"),
        (
            2,
            [(0, UNKNOWN, 90), (1, UNKNOWN, 90)],
            "battery 2, which battery_id names: it tells only of 0, 1",
        ),
        (2, [], "it tells only of none"),
        (-1, [(0, UNKNOWN, 90)], ""),
    ],
)
def test_why_no_level_is_known_is_said_by_name(wanted: int, told: list[Told], words: str) -> None:
    battery = FlightBattery(wanted)
    for number, function, percent in told:
        battery.on_battery(number, function, percent, 1)
    assert words in battery.trouble
    assert bool(battery.trouble) is bool(words)
