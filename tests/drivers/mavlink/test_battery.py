"""Which battery flies a vehicle, through MAVSDK and the guard's own link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import VehicleError
from flight.config import GuardConfig
from flight.guard.limits import check_vehicle
from hil.vehicle import messages
from tests.drivers.mavlink.mavsdk_bench import HEIGHT_M, Bench, px4

FLIGHT, PAYLOAD = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_FUNCTION_PAYLOAD
UNKNOWN = mavlink.MAV_BATTERY_FUNCTION_UNKNOWN
S = 10**9


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
