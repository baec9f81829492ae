"""The looks before arming on a vehicle that stands in: who asks what, what is written, and what is
refused.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import VehicleError
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.preflight.before_arming import BeforeArming, access_of
from drivers.mavlink.preflight.geofence import ARDUPILOT_NAMES, PX4_NAMES, Geofence
from drivers.mavlink.preflight.parameters import Difference
from drivers.mavlink.preflight.pilot_rules import names_of

FENCE = Geofence(20.0, 6.0)
PX4_PILOT = {"COM_RC_IN_MODE": 0.0, "RC_MAP_FLTMODE": 5.0, "RC_MAP_KILL_SW": 6.0}
PX4_FENCE = {"GF_MAX_HOR_DIST": 23.0, "GF_MAX_VER_DIST": 9.0, "GF_ACTION": 2.0}


class Vehicle:
    """A vehicle's parameters, and what was done to them."""

    def __init__(self, rc: str = "radio", found: dict[str, float | None] | None = None) -> None:
        self.found: dict[str, float | None] = {**PX4_PILOT, **PX4_FENCE, **(found or {})}
        self.asked: list[list[str]] = []
        self.written: list[Difference] = []
        self.waited: list[float] = []
        self.keeps = True
        self.telemetry: Any = SimpleNamespace(
            known_kind=PX4,
            radio_heard=True,
            position=SimpleNamespace(n_m=(0.0, 0.0, 0.0)),
            state=lambda: SimpleNamespace(armed=self.armed),
        )
        self.armed = False
        config: Any = SimpleNamespace(
            rc=rc, url="udp", sysid=7, mode_timeout_s=3.0, connect_timeout_s=10.0
        )
        self.before = BeforeArming(cast(Any, self), self.telemetry, config)
        self.parameters = self

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        self.waited.append(timeout_s)
        return condition()

    async def read(self, names: Iterable[str]) -> dict[str, float | None]:
        self.asked.append(list(names))
        return {name: self.found.get(name) for name in self.asked[-1]}

    async def write(self, difference: Difference) -> None:
        self.written.append(difference)
        if self.keeps:
            self.found[difference.name] = difference.wanted


def refused(step: Any) -> str:
    with pytest.raises(VehicleError) as caught:
        asyncio.run(step)
    return str(caught.value)


def test_parameters_are_those_of_an_open_session() -> None:
    session: Any = SimpleNamespace(parameters=None)
    with pytest.raises(VehicleError, match="tty is not open"):
        access_of(session, "tty")
    session.parameters = "open"
    assert access_of(session, "tty") == "open"


# --- the pilot


def test_a_pilot_with_a_radio_that_can_take_it_is_found() -> None:
    vehicle = Vehicle()
    (finding,) = asyncio.run(vehicle.before.pilot_findings())
    assert (finding.state, finding.name) == ("ok", "pilot")
    assert vehicle.asked == [list(names_of(PX4))] and vehicle.waited == [3.0]
    asyncio.run(vehicle.before.check_pilot())


def test_without_a_radio_by_the_rig_nobody_is_looked_for_and_that_is_said() -> None:
    vehicle = Vehicle(rc="none")
    (finding,) = asyncio.run(vehicle.before.pilot_findings())
    assert finding.state == "note" and "NO REMOTE CONTROL" in finding.detail
    asyncio.run(vehicle.before.check_pilot())
    assert vehicle.asked == vehicle.waited == []


def test_a_radio_that_is_not_heard_and_a_value_that_keeps_the_pilot_out_are_both_faults() -> None:
    vehicle = Vehicle(found={"COM_RC_IN_MODE": 4.0})
    vehicle.telemetry.radio_heard = False
    findings = asyncio.run(vehicle.before.pilot_findings())
    assert [each.state for each in findings] == ["fault", "fault"]
    assert findings[0].detail.startswith("no radio is heard")
    assert findings[1].detail.startswith("COM_RC_IN_MODE is 4")
    said = refused(vehicle.before.check_pilot())
    assert "vehicle 7 cannot be taken by its pilot: no radio is heard" in said
    assert "; COM_RC_IN_MODE is 4" in said


# --- the fence


def test_a_fence_that_is_as_it_should_be_is_left() -> None:
    vehicle = Vehicle()
    assert asyncio.run(vehicle.before.keep_geofence(FENCE)) == {}
    assert vehicle.written == [] and vehicle.asked == [list(PX4_NAMES)] * 2
    assert vehicle.waited == [10.0] * 2


def test_a_fence_that_is_off_is_written_around_where_it_stands_and_read_back() -> None:
    vehicle = Vehicle(found={"GF_MAX_HOR_DIST": 0.0})
    vehicle.telemetry.position = SimpleNamespace(n_m=(3.0, 4.0, -1.0))
    assert asyncio.run(vehicle.before.keep_geofence(FENCE)) == {"GF_MAX_HOR_DIST": 28.0}
    assert vehicle.written == [Difference("GF_MAX_HOR_DIST", 28.0, None)]


@pytest.mark.parametrize(
    ("found", "armed", "said"),
    [
        ({"GF_ACTION": 4.0}, False, "vehicle 7: GF_ACTION"),
        ({"GF_MAX_HOR_DIST": 5.0}, False, "inside the script's own fence"),
        ({"GF_MAX_HOR_DIST": 0.0}, True, "is armed, and its fence is not set"),
        ({"GF_MAX_HOR_DIST": None}, False, "cannot be read back: GF_MAX_HOR_DIST"),
    ],
)
def test_a_fence_that_cannot_be_kept_is_refused_and_nothing_is_written(
    found: dict[str, float | None], armed: bool, said: str
) -> None:
    vehicle = Vehicle(found=found)
    vehicle.armed = armed
    assert said in refused(vehicle.before.keep_geofence(FENCE))
    assert vehicle.written == []


def test_a_vehicle_that_is_armed_may_have_the_fence_that_it_should_have() -> None:
    vehicle = Vehicle()
    vehicle.armed = True
    assert asyncio.run(vehicle.before.keep_geofence(FENCE)) == {}


def test_a_fence_that_is_not_kept_is_refused() -> None:
    vehicle = Vehicle(found={"GF_MAX_HOR_DIST": 0.0})
    vehicle.keeps = False
    assert "did not keep the fence" in refused(vehicle.before.keep_geofence(FENCE))
    broken = Vehicle(found={"GF_MAX_HOR_DIST": 0.0})
    write = broken.write

    async def break_it(difference: Difference) -> None:
        await write(difference)
        broken.found["GF_ACTION"] = 4.0

    broken.write = break_it
    assert "did not keep the fence" in refused(broken.before.keep_geofence(FENCE))


def test_a_vehicle_that_does_not_say_where_it_is_has_no_fence() -> None:
    vehicle = Vehicle()
    vehicle.telemetry.position = None
    assert "does not say where it is" in refused(vehicle.before.plan_geofence(FENCE))


def test_each_autopilot_is_asked_for_its_own_fence() -> None:
    vehicle = Vehicle()
    vehicle.telemetry.known_kind = ARDUPILOT
    plan = asyncio.run(vehicle.before.plan_geofence(FENCE))
    assert vehicle.asked == [list(ARDUPILOT_NAMES)]
    assert "FENCE_RADIUS" in plan.problems[0]
