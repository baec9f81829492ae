"""Which battery flies a vehicle, and what is known of it: by message, and through MAVSDK and the
guard's own link.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import VehicleError
from drivers.mavlink.battery import FlightBattery
from flight.config import GuardConfig
from flight.guard.limits import check_vehicle
from hil.vehicle import messages
from tests.drivers.mavlink.mavsdk_bench import HEIGHT_M, Bench, px4

FLIGHT, PAYLOAD = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_FUNCTION_PAYLOAD
UNKNOWN = mavlink.MAV_BATTERY_FUNCTION_UNKNOWN
S = 10**9

Told = tuple[int, int, float]  # id, function, percent; id -1: a SYS_STATUS


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


# --- on the wire


@dataclass
class Said:
    """What the embedded vehicle says of its battery; None: the truth."""

    percent: int | None = None


@contextmanager
def saying(monkeypatch: pytest.MonkeyPatch) -> Generator[tuple[Bench, Said]]:
    said = Said()

    def altered(make: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def made(flight: Any) -> Any:
            message = make(flight)
            if said.percent is not None:
                message.battery_remaining = said.percent
            return message

        return made

    for number in (mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS):
        make, rate_hz = messages.STREAMS[number]
        monkeypatch.setitem(messages.STREAMS, number, (altered(make), rate_hz))
    with px4() as bench:
        yield bench, said


def second_battery(bench: Bench, function: int = UNKNOWN, percent: int = 8) -> None:
    """Send a BATTERY_STATUS of another battery of the same vehicle."""
    message = mavlink.MAVLink_battery_status_message
    volts = [7200, *[65535] * 9]
    packed = bench.endpoint._packed(message(1, function, 0, 32767, volts, -1, -1, -1, percent))  # pyright: ignore[reportPrivateUsage]
    bench.endpoint.send_raw(packed)


async def judged(
    vehicle: Any, seconds: float, beside: Callable[[], None] = lambda: None
) -> set[float]:
    """Return the levels seen meanwhile; the script's own limits are held against every state."""
    limits = GuardConfig(telemetry_age_s=5.0, heartbeat_age_s=10.0)
    levels: set[float] = set()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        beside()
        state = vehicle.state
        levels.add(round(state.battery, 2))
        check_vehicle(state, vehicle._clock.now_ns(), limits, state.mode)
        await asyncio.sleep(0.02)
    return levels


def test_a_second_battery_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(60.0)
            await vehicle.arm()
            await vehicle.take_off(HEIGHT_M, 60.0)
            levels = await judged(vehicle, 3.0, lambda: second_battery(bench))
            assert min(levels) > 0.9
            await vehicle.land(60.0)

    with saying(monkeypatch) as (bench, _):
        asyncio.run(main(bench))


@pytest.mark.parametrize("percent", [-1, 101])
def test_an_unknown_level_is_refused_before_take_off_by_name(
    monkeypatch: pytest.MonkeyPatch, percent: int
) -> None:
    async def main(bench: Bench) -> None:
        async with bench.vehicle() as vehicle:
            with pytest.raises(VehicleError, match="level of battery 0: it tells no percentage"):
                await vehicle.wait_armable(6.0)

    with saying(monkeypatch) as (bench, said):
        said.percent = percent
        asyncio.run(main(bench))


def test_a_level_that_is_not_told_any_more_in_the_air_is_kept_and_has_an_age(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def main(bench: Bench, said: Said) -> None:
        async with bench.vehicle() as vehicle:
            await vehicle.wait_armable(60.0)
            await vehicle.arm()
            await vehicle.take_off(HEIGHT_M, 60.0)
            said.percent = -1
            levels = await judged(vehicle, 3.5)
            assert min(levels) > 0.9
            age_s = (vehicle._clock.now_ns() - (vehicle.state.battery_ns or 0)) * 1e-9  # pyright: ignore[reportPrivateUsage]
            assert 1.5 < age_s < 6.0
            await vehicle.land(60.0)

    with saying(monkeypatch) as (bench, said):
        asyncio.run(main(bench, said))
