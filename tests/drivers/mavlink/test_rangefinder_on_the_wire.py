"""DISTANCE_SENSOR of the embedded vehicle, through MAVSDK, to the state and to doctor's row."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from drivers.rig.facts import HeightFacts
from hil.world.rangefinder import RangefinderConfig, SimRangefinder
from missions.field.doctor import vehicle as doctor_vehicle
from missions.field.doctor.vehicle import check_flyer
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, Bench, px4
from tests.missions.field.doctor.doctor_findings import found

HEIGHT = HeightFacts(rangefinder_max_m=12.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.rig.part_check.COUNT_S", 0.3)
    for name, seconds in (("SAMPLE_S", 0.4), ("READY_S", 1.0), ("RANGEFINDER_S", 1.5)):
        monkeypatch.setattr(doctor_vehicle, name, seconds)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with px4() as made:
        yield made


def test_a_rangefinder_that_is_counted_on_and_not_heard_is_a_fault(bench: Bench) -> None:
    every = found(check_flyer(bench.vehicle(telemetry_hz=20.0), CONTEXT.clock, 0.2, height=HEIGHT))
    assert every["rangefinder"].state == "fault"
    assert "orientation 25" in every["rangefinder"].detail
    assert "[height]" in every["rangefinder"].fix


def test_one_that_is_heard_is_told_also_where_it_is_too_near_to_the_ground_to_measure(
    bench: Bench,
) -> None:
    bench.drone.rangefinder = SimRangefinder(RangefinderConfig(max_m=12.0, min_m=0.3), 0, 0)
    every = found(check_flyer(bench.vehicle(telemetry_hz=20.0), CONTEXT.clock, 0.2, height=HEIGHT))
    assert every["rangefinder"].state == "ok"
    assert "measures nothing at present" in every["rangefinder"].detail


def test_a_rig_without_one_is_told_nothing_of_it(bench: Bench) -> None:
    every = found(
        check_flyer(bench.vehicle(telemetry_hz=20.0), CONTEXT.clock, 0.2, height=HeightFacts())
    )
    assert "rangefinder" not in every
