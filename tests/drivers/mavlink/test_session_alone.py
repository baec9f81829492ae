"""Which vehicle a session takes for its own, and that a wait ends when it falls silent, without
MAVSDK.
"""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.interfaces import VehicleError
from drivers.mavlink.modes import ARDUPILOT, PX4
from tests.drivers.mavlink.mavsdk_bench import SYSID
from tests.drivers.mavlink.test_answers import Session


def beat(session: Session, autopilot: int = 12) -> None:
    fields = json.dumps({"autopilot": autopilot, "base_mode": 1, "custom_mode": 0})
    session.telemetry._on_heartbeat(
        SimpleNamespace(system_id=SYSID, component_id=1, fields_json=fields)
    )


@pytest.mark.parametrize(
    ("autopilot", "wanted", "found"),
    [
        (12, "auto", PX4),
        (3, "auto", ARDUPILOT),
        (3, "ardupilot", ARDUPILOT),
        (3, "px4", "is ardupilot, the rig says px4"),
        (8, "auto", "neither PX4 nor ArduPilot"),
        (None, "auto", "stopped on"),
    ],
)
def test_the_autopilot_is_the_one_that_beats_and_the_one_that_the_rig_says(
    autopilot: int | None, wanted: Any, found: Any
) -> None:
    session: Any = Session(autopilot=wanted)
    if autopilot is not None:
        beat(session, autopilot)
    if isinstance(found, str):
        with pytest.raises(VehicleError, match=found):
            session.session._identify()
    else:
        assert session.session._identify() is found


@pytest.mark.parametrize(
    ("heard", "said"),
    [
        ([], "no heartbeat on"),
        ([(SYSID + 1, True), (SYSID + 2, True)], f"heard only {SYSID + 1}, {SYSID + 2}"),
        ([(SYSID, False)], "is not on"),
        ([(SYSID + 1, True), (SYSID, True)], ""),
    ],
)
def test_the_vehicle_is_the_one_of_its_number_that_has_an_autopilot(
    heard: list[tuple[int, bool]], said: str
) -> None:
    systems = [
        SimpleNamespace(
            get_system_id=lambda number=number: number, has_autopilot=lambda there=there: there
        )
        for number, there in heard
    ]
    session: Any = Session(connect_timeout_s=0.1)
    session.session._mavsdk = SimpleNamespace(get_systems=lambda: systems)
    if said:
        with pytest.raises(VehicleError, match=said):
            asyncio.run(session.session._find_system())
    else:
        assert asyncio.run(session.session._find_system()) is systems[-1]


def test_a_wait_ends_with_the_vehicle_s_last_heartbeat() -> None:
    session = Session(heartbeat_timeout_s=0.2)

    async def wait() -> None:
        session.telemetry.check()
        beat(session)
        await session.session.until(lambda: False, 60.0)

    with pytest.raises(VehicleError, match="heartbeat of vehicle 7 lost"):
        asyncio.run(wait())


def test_a_session_that_is_not_open_waits_for_nothing_and_sends_nothing() -> None:
    session: Any = Session()
    session.session._direct = None
    with pytest.raises(VehicleError, match="is not open"):
        session.session.send("PARAM_SET", {})
    with pytest.raises(VehicleError, match="is not open"):
        asyncio.run(session.session.until(lambda: False, 60.0))
