"""A vehicle driver from outside: one file, flown by the contract that ours are flown by."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.rig.parts import create, part_context
from hil.harness.virtual_time import run_virtual
from missions.fly.testing.vehicle import Stage, VehicleContract
from missions.ground import rig_library
from path.messages import Role

HERE = Path(__file__).parent
RIG = f"""
like = "sim"
name = "mine"

[both.vehicle]
factory = "{HERE / "copter.py"}:Copter"
"""


class LoopClock:
    """The clock of the loop that the contract is run on."""

    def now_ns(self) -> int:
        try:
            return round(asyncio.get_running_loop().time() * 1e9) + 10**12
        except RuntimeError:
            return time.monotonic_ns()


def made(folder: Path) -> Any:
    """The driver as a rig makes it, on the loop's clock."""
    (folder / "mine.toml").write_text(RIG, "utf-8")
    rig = rig_library.load(str(folder / "mine.toml"))
    context = replace(part_context(rig_library.load("sitl"), Role.SENDER), clock=LoopClock())
    return create(rig.sender.vehicle, context)


class TestCopter(VehicleContract):
    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        self.folder = tmp_path

    @contextmanager
    def stage(self) -> Generator[Stage]:
        vehicle = made(self.folder)
        airframe = vehicle.airframe

        def on_ground() -> bool:
            airframe.step()
            return airframe.on_ground

        yield Stage(
            vehicle,
            LoopClock(),
            on_ground,
            lambda: setattr(airframe, "plugged", False),
            lambda: airframe.heard,
            run_virtual,
        )


def test_a_driver_that_forgets_to_refuse_does_not_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite = TestCopter()
    suite.folder = tmp_path
    vehicle = type(made(tmp_path))

    def flies_anything(copter: object, setpoint: object) -> None: ...

    monkeypatch.setattr(vehicle, "fly", flies_anything)
    with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
        suite.test_on_the_ground_what_makes_no_sense_is_refused_and_moves_nothing()
