"""The suite on the embedded vehicle, faster than real time; on the real ones where their simulators
are named.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from hil.vehicle.bench import EmbeddedBench
from missions import cli
from missions.ground import rig_library
from missions.proofs.conformance.measure import FlightSuite, VehicleMeasures, chosen
from missions.proofs.conformance.run import BINARY, RIGS
from tests.pauses import undisturbed

SPEED = 4.0
PAUSE_S = 0.1  # four times as much of the vehicle's time


def flown(vehicle: str, folder: Path, words: list[str], speed: float = 1.0) -> VehicleMeasures:
    rig = rig_library.load(RIGS[vehicle])
    suite = FlightSuite(lambda: EmbeddedBench(rig, folder, speed), lambda _: None)
    return asyncio.run(suite.run(chosen(words)))


def test_the_embedded_vehicle_as_it_starts_and_when_setpoints_stop(tmp_path: Path) -> None:
    measured = undisturbed(lambda: flown("embedded", tmp_path, ["silent"], SPEED), PAUSE_S)
    values = measured.values
    assert (measured.failed, measured.restarts, measured.what) == ({}, 0, "embedded")
    assert values["early_arm"] == "temporarily rejected"
    assert values["early_arm_text"] == "Arming denied: position estimate is settling"
    assert values["armable_s"] == pytest.approx(2.5, abs=1.0)
    assert values["silent_modes"] in ("land → disarmed", "hold → land → disarmed")
    assert values["silent_land_s"] == pytest.approx(1.0, abs=1.1)  # shown once a second
    assert values["silent_stand_m"] == pytest.approx(0.5, abs=0.4)
    assert values["silent_down_s"] == pytest.approx(6.0, abs=1.5)


def named(vehicle: str) -> pytest.MarkDecorator:
    variable = BINARY[vehicle]
    return pytest.mark.skipif(
        not os.environ.get(variable), reason=f"{variable} names no simulator of {vehicle}"
    )


@pytest.mark.parametrize(
    "vehicle", [pytest.param(vehicle, marks=named(vehicle)) for vehicle in BINARY]
)
def test_a_real_one_answers_on_the_ground(vehicle: str, tmp_path: Path) -> None:
    measured = flown(vehicle, tmp_path, ["ground"])
    assert measured.failed == {}
    assert measured.values["early_arm"] != "accepted"
    assert measured.values["idle_disarm_s"] == pytest.approx(10.0, abs=2.0)


def test_a_flight_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(PartError, match="no flight is called loop") as caught:
        chosen(["loop"])
    assert "course, silent" in caught.value.remedy


def test_without_a_binary_a_vehicle_is_skipped_and_said_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for variable in BINARY.values():
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(SystemExit) as ended:
        cli.main(["conformance", "--vehicle", "px4", "ardupilot", "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    assert "px4: skipped, no simulator is named (--px4 PATH, or PATH_PX4)" in said
    assert "ardupilot: skipped" in said
    assert ended.value.code == CommandEnd.FAILED.exit_code
