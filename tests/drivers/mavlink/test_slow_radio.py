"""A telemetry radio that brings too little for a flight: refused before anything is armed, with rate and need."""

from __future__ import annotations

import asyncio

import pytest

from drivers.interfaces import VehicleError
from hil.vehicle import messages
from tests.drivers.mavlink.mavsdk_bench import Bench, px4

POSITION, LOCAL, ATTITUDE = 33, 32, 31
ACCEPTED, DENIED = 0, 2  # to a wish for another rate; either way nothing changes


@pytest.mark.parametrize(
    ("slow", "rate_hz", "named", "answer"),
    [
        ((POSITION, LOCAL, ATTITUDE), 1.0, "position 1", ACCEPTED),
        ((POSITION,), 2.0, "position 2", DENIED),
        ((ATTITUDE,), 2.0, "attitude 2", ACCEPTED),
        ((LOCAL,), 1.0, "local position 1", DENIED),
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
            with pytest.raises(VehicleError, match=rf"tells its {named}.*this flight needs 4\.0 a second") as caught:
                await vehicle.wait_armable(8.0)
            assert "telemetry_hz" in caught.value.remedy

    with px4() as bench:
        asyncio.run(main(bench))


def test_a_mission_that_bears_older_telemetry_flies_by_less(monkeypatch: pytest.MonkeyPatch) -> None:
    for number in (POSITION, LOCAL, ATTITUDE):
        make, _ = messages.STREAMS[number]
        monkeypatch.setitem(messages.STREAMS, number, (make, 2.0))

    async def main(bench: Bench) -> None:
        bench.endpoint._set_interval = lambda *_: 0  # type: ignore[assignment,method-assign]  # pyright: ignore
        async with bench.vehicle() as vehicle:
            vehicle.expect_telemetry(2.0)
            await vehicle.wait_armable(30.0)

    with px4() as bench:
        asyncio.run(main(bench))
