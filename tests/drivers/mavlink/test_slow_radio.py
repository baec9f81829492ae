"""A telemetry radio that brings too little for a flight: refused before anything is armed, with
rate and need.
"""

from __future__ import annotations

import asyncio
import re

import pytest

from drivers.arrivals import WINDOW_S
from drivers.interfaces import VehicleError
from hil.vehicle import messages
from tests.drivers.mavlink.mavsdk_bench import LIMIT_S, Bench, px4, until

POSITION, LOCAL, ATTITUDE = 33, 32, 31
ACCEPTED, DENIED = 0, 2  # to a wish for another rate; either way nothing changes


@pytest.mark.parametrize(
    ("slow", "rate_hz", "named", "answer"),
    [
        ((POSITION, LOCAL, ATTITUDE), 1.0, "position", ACCEPTED),
        ((POSITION,), 2.0, "position", DENIED),
        ((ATTITUDE,), 2.0, "attitude", ACCEPTED),
        ((LOCAL,), 1.0, "local position", DENIED),
    ],
)
def test_a_vehicle_that_tells_too_little_is_not_armable(
    monkeypatch: pytest.MonkeyPatch, slow: tuple[int, ...], rate_hz: float, named: str, answer: int
) -> None:
    for number in slow:
        make, _ = messages.STREAMS[number]
        monkeypatch.setitem(messages.STREAMS, number, (make, rate_hz))

    async def main(bench: Bench) -> None:
        bench.endpoint._set_interval = lambda *_: answer  # type: ignore[assignment,method-assign]  # pyright: ignore
        async with bench.vehicle() as vehicle:
            await until(
                lambda: not vehicle._telemetry.missing() and vehicle._telemetry.battery.known
            )
            with pytest.raises(VehicleError, match=r"this flight needs 4\.0 a second") as caught:
                await vehicle.wait_armable(WINDOW_S)
            assert "telemetry_hz" in caught.value.remedy
            told = re.search(rf"tells its {named} ([0-9.]+) times a second", str(caught.value))
            assert told is not None, caught.value
            # fewer where this computer was busy
            assert 0.0 < float(told[1]) <= rate_hz + 1.0 / WINDOW_S

    with px4() as bench:
        asyncio.run(main(bench))


def test_a_mission_that_bears_older_telemetry_flies_by_less(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for number in (POSITION, LOCAL, ATTITUDE):
        make, _ = messages.STREAMS[number]
        monkeypatch.setitem(messages.STREAMS, number, (make, 2.0))

    async def main(bench: Bench) -> None:
        bench.endpoint._set_interval = lambda *_: 0  # type: ignore[assignment,method-assign]  # pyright: ignore
        async with bench.vehicle() as vehicle:
            vehicle.expect_telemetry(2.0)
            await vehicle.wait_armable(LIMIT_S)

    with px4() as bench:
        asyncio.run(main(bench))
