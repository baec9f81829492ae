"""The test of a vehicle: through MAVSDK to the embedded one, and judgements on what a vehicle may
say.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode, VehicleState
from missions.field.doctor import vehicle as doctor_vehicle
from missions.field.doctor.vehicle import VehicleReport, check_flyer, condition, streams
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, SYSID, px4, vehicle_at
from tests.free_ports import free_port
from tests.missions.field.doctor.doctor_findings import found, states

STATE = VehicleState(
    1,
    1,
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    False,
    False,
    True,
    FlightMode.HOLD,
    0.8,
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.rig.part_check.COUNT_S", 0.5)
    for name, seconds in (("SAMPLE_S", 0.7), ("READY_S", 30.0)):
        monkeypatch.setattr(doctor_vehicle, name, seconds)


def test_a_vehicle_that_is_well_is_told_by_its_firmware_rates_and_battery_and_nothing_is_commanded() -> (
    None
):
    with px4() as bench:
        every = found(check_flyer(bench.vehicle(telemetry_hz=20.0), CONTEXT.clock, 0.2))
        assert (
            bench.wire.commands(400) == bench.wire.commands(22) == bench.wire.of("PARAM_SET") == []
        )
        assert not bench.wire.of("SET_POSITION_TARGET_LOCAL_NED")
    assert every["autopilot"].detail == f"px4, firmware 1.16.0, system id {SYSID}"
    for name in ("connects", "heartbeat", "armed", "battery", "ready to arm", "parameters"):
        assert every[name].state == "ok", every
    for stream in ("attitude", "position"):
        assert "of 20 a second" in every[stream].detail
    assert every["telemetry"].detail.startswith("never older than")


def test_a_parameter_that_differs_is_a_fault_and_stays_as_it_is() -> None:
    with px4() as bench:
        every = found(
            check_flyer(bench.vehicle(parameters={"MIS_TAKEOFF_ALT": 99.0}), CONTEXT.clock, 0.2)
        )
        assert bench.wire.of("PARAM_SET") == []
    assert every["parameters"].state == "fault"
    assert "99" in every["parameters"].detail
    assert "--set-parameters" in every["parameters"].fix


def test_a_vehicle_that_is_not_there_or_cannot_be_armed_is_a_fault() -> None:
    every = found(check_flyer(vehicle_at(free_port(), connect_timeout_s=0.3), CONTEXT.clock, 0.2))
    assert states(every) == {"": "fault"}
    assert "no heartbeat" in every[""].detail


@pytest.mark.parametrize(
    ("changed", "name"),
    [({"armed": True}, "armed"), ({"in_air": True}, "armed"), ({"battery": 0.19}, "battery"),
     ({"armable": False}, "ready to arm")],
)  # fmt: skip
def test_what_forbids_a_flight_is_a_fault(changed: dict[str, object], name: str) -> None:
    assert {finding.state for finding in condition(STATE, 0.2)} == {"ok"}
    faults = [
        finding for finding in condition(replace(STATE, **changed), 0.2) if finding.state == "fault"
    ]  # type: ignore[arg-type]
    assert [finding.name for finding in faults] == [name]
    assert faults[0].fix


@pytest.mark.parametrize(
    ("heard", "told"),
    [
        (VehicleReport(0.05, 10, 2.0), ["ok", "ok"]),
        (VehicleReport(0.8, 10, 2.0), ["fault", "ok"]),
        (VehicleReport(None, 1, 2.0), ["fault"] * 2),
    ],
)
def test_old_telemetry_and_silence_are_faults(heard: VehicleReport, told: list[str]) -> None:
    assert [finding.state for finding in streams(heard)] == told
