"""The autopilot's parameters against the rig's: compared over the wire, refused where they differ,
set when told to.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import PartError, VehicleError
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.preflight.geofence import Geofence
from drivers.mavlink.preflight.parameters import Difference, differences
from drivers.mavlink.vehicle import MavsdkVehicle
from drivers.rig.parts import Rig, create, part_context
from hil.autopilot.autopilot import AutopilotConfig
from hil.autopilot.radio import RadioConfig
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.field.doctor import command as doctor
from missions.field.doctor import vehicle as doctor_vehicle
from missions.ground import rig_library
from missions.ground.options.field import DoctorOptions
from path.messages import Role
from tests.free_ports import free_port
from tests.steady_time import SteadyTime

LIMIT_S = 60.0
AS_IT_IS = {"COM_RC_IN_MODE": 0.0, "COM_OF_LOSS_T": 0.5}


def test_differences_are_named_in_the_order_of_the_rig() -> None:
    wanted = {"A": 1.0, "B": 0.5, "C": 3.0}
    wrong = differences(wanted, {"C": 2.0, "B": 0.5000001, "A": None})
    assert wrong == (Difference("A", 1.0, None), Difference("C", 3.0, 2.0))
    assert [str(each) for each in wrong] == [
        "A is not there, the rig wants 1",
        "C is 2, the rig wants 3",
    ]


@pytest.fixture
def embedded(request: pytest.FixtureRequest) -> AutopilotConfig:
    return getattr(request, "param", AutopilotConfig(settle_s=0.1))


@pytest.fixture
def url(embedded: AutopilotConfig) -> Generator[str]:
    """The URL that an embedded vehicle, system 5, sends to; it lives in a thread."""
    port = free_port()
    world = World(WorldConfig(autopilot=embedded), seed=1)
    tangent = LocalTangent(47.3977, 8.5456, 488.0)
    endpoint = MavlinkVehicle(
        MavlinkVehicleConfig(5, ("127.0.0.1", port)), world.drone(Role.SENDER), tangent
    )
    stop, passed = threading.Event(), SteadyTime()

    def run() -> None:
        while not stop.wait(0.004):
            world.advance(passed.now_s())
            endpoint.pump(world.time_s)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield f"udpin://127.0.0.1:{port}"
    finally:
        stop.set()
        thread.join()
        endpoint.close()


def rig_with(url: str, parameters: dict[str, float]) -> Rig:
    rig = rig_library.load("sitl-px4")
    options: dict[str, Any] = {
        **rig.sender.vehicle.options,
        "url": url,
        "parameters": parameters,
        "rc": "required",
    }
    return replace(
        rig, sender=replace(rig.sender, vehicle=replace(rig.sender.vehicle, options=options))
    )


def opened(rig: Rig) -> MavsdkVehicle:
    return create(rig.sender.vehicle, part_context(rig, Role.SENDER))


def test_nothing_is_armed_with_other_parameters_than_the_rigs(url: str) -> None:
    async def fly() -> None:
        async with opened(rig_with(url, AS_IT_IS)) as vehicle:
            assert await vehicle.parameter_differences() == ()
            await vehicle.wait_armable(LIMIT_S)
        wrong = {**AS_IT_IS, "COM_OBL_RC_ACT": 3.0, "NO_SUCH": 1.0}
        async with opened(rig_with(url, wrong)) as vehicle:
            with pytest.raises(
                VehicleError, match="COM_OBL_RC_ACT is 4, the rig wants 3; NO_SUCH is not there"
            ) as caught:
                await vehicle.wait_armable(LIMIT_S)
            assert "--set-parameters" in caught.value.remedy

    asyncio.run(fly())


def test_the_doctor_compares_sets_and_records(url: str, tmp_path: Path) -> None:
    rig = rig_with(url, {**AS_IT_IS, "MIS_TAKEOFF_ALT": 2.75})
    before, _ = doctor_vehicle.check_vehicle(rig, Role.SENDER, False, tmp_path)
    assert (before.state, before.detail) == ("fault", "MIS_TAKEOFF_ALT is 1.5, the rig wants 2.75")
    done = list(doctor_vehicle.check_vehicle(rig, Role.SENDER, True, tmp_path))
    assert [finding.state for finding in done] == ["note", "note", "note", "ok", "ok"]
    (file,) = tmp_path.iterdir()
    assert json.loads(file.read_text())["parameters"] == [
        {"name": "MIS_TAKEOFF_ALT", "before": 1.5, "after": 2.75},
        # it stands 0.3 m from the origin, as it believes
        {"name": "GF_MAX_HOR_DIST", "before": 0.0, "after": 29.0},
        {"name": "GF_MAX_VER_DIST", "before": 0.0, "after": 9.0},
    ]
    after, pilot = doctor_vehicle.check_vehicle(rig, Role.SENDER, False, tmp_path)
    assert (after.state, after.detail) == ("ok", "parameters are as the rig wants them")
    assert (pilot.state, pilot.name) == ("ok", "sender pilot")


BARE = AutopilotConfig(settle_s=0.1, radio=RadioConfig(in_mode=3, override=1, loss_act=2))
"""As PX4 is delivered."""

WANTED = {
    "COM_RC_IN_MODE": 0.0,
    "COM_RC_OVERRIDE": 3.0,
    "COM_RCL_EXCEPT": 0.0,
    "NAV_RCL_ACT": 3.0,
    "GF_ACTION": 2.0,
}


@pytest.mark.parametrize("embedded", [BARE], indirect=True)
def test_the_doctor_makes_a_bare_vehicle_one_that_a_pilot_can_take(
    url: str, tmp_path: Path
) -> None:
    rig = rig_with(url, WANTED)

    async def ready() -> None:
        async with opened(rig) as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert await vehicle.keep_geofence(Geofence(25.0, 6.0)) == {}

    with pytest.raises(VehicleError, match="COM_RC_IN_MODE is 3, the rig wants 0"):
        asyncio.run(ready())
    done = list(doctor_vehicle.check_vehicle(rig, Role.SENDER, True, tmp_path))
    assert {finding.state for finding in done} == {"note", "ok"}
    (file,) = tmp_path.iterdir()
    written = {
        each["name"]: (each["before"], each["after"])
        for each in json.loads(file.read_text())["parameters"]
    }
    assert written["COM_RC_IN_MODE"] == (3.0, 0.0)
    assert written["NAV_RCL_ACT"] == (2.0, 3.0)
    assert set(written) == {
        "COM_RC_IN_MODE",
        "COM_RC_OVERRIDE",
        "NAV_RCL_ACT",
        "GF_MAX_HOR_DIST",
        "GF_MAX_VER_DIST",
    }
    asyncio.run(ready())


@pytest.mark.parametrize(
    ("embedded", "why"),
    [
        (replace(BARE, radio=RadioConfig(fitted=False)), "no radio is heard"),
        (
            replace(BARE, radio=RadioConfig(in_mode=4)),
            "COM_RC_IN_MODE is 4: 1 and 4 ignore every radio",
        ),
        (
            replace(BARE, radio=RadioConfig(kill_channel=0)),
            "RC_MAP_KILL_SW is 0: no channel is the kill switch",
        ),
    ],
    indirect=["embedded"],
)
def test_nothing_is_armed_that_its_pilot_cannot_take(url: str, why: str) -> None:
    async def fly(**options: Any) -> None:
        rig = rig_with(url, {})
        alone = {**rig.sender.vehicle.options, "mode_timeout_s": 0.5, **options}
        rig = replace(
            rig, sender=replace(rig.sender, vehicle=replace(rig.sender.vehicle, options=alone))
        )
        async with opened(rig) as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            (told,) = await vehicle.pilot_findings()
            assert told.state == "note"
            assert "NO REMOTE CONTROL" in told.detail

    with pytest.raises(VehicleError, match=why):
        asyncio.run(fly())
    asyncio.run(fly(rc="none"))


def test_the_fence_is_given_before_arming_and_a_crews_narrower_one_is_left(url: str) -> None:
    async def fly() -> None:
        async with opened(rig_with(url, {})) as vehicle:
            await vehicle.wait_armable(LIMIT_S)
            assert await vehicle.keep_geofence(Geofence(25.0, 6.0)) == {
                "GF_MAX_HOR_DIST": 29.0,
                "GF_MAX_VER_DIST": 9.0,
            }
            assert await vehicle.keep_geofence(Geofence(25.0, 6.0)) == {}
            with pytest.raises(
                VehicleError, match="GF_MAX_VER_DIST is 9 m, inside the script's own fence of 20"
            ):
                await vehicle.keep_geofence(Geofence(25.0, 20.0))

    asyncio.run(fly())


def test_a_parameter_that_is_not_taken_is_a_fault(url: str, tmp_path: Path) -> None:
    rig = rig_with(url, {"COM_OF_LOSS_T": 70.0})
    (finding,) = doctor_vehicle.check_vehicle(rig, Role.SENDER, True, tmp_path)
    assert finding.state == "fault"
    assert "COM_OF_LOSS_T" in finding.detail
    assert list(tmp_path.iterdir()) == []


def test_setting_needs_to_know_whose() -> None:
    with pytest.raises(PartError, match="whose parameters"):
        list(doctor.asked(DoctorOptions("sitl-px4", set_parameters=True), lambda _: None))
