"""A vehicle driver from outside: one file, flown by the contract that ours are flown by."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import VehicleError
from drivers.rig.parts import create, part_context
from hil.harness.virtual_time import run_virtual
from missions.fly.handoff.flight import fly_once
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

GONE = """
from dataclasses import dataclass
from drivers.interfaces import VehicleError

@dataclass(frozen=True)
class Config:
    pass

class Gone:
    Config = Config
    def __init__(self, config, context): ...
    async def __aenter__(self):
        raise VehicleError("it does not answer", "switch it on")
    async def __aexit__(self, *_): ...
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


def test_a_vehicle_that_does_not_open_is_told_once_and_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "gone.py").write_text(GONE, "utf-8")
    (tmp_path / "gone.toml").write_text(RIG.replace(f"{HERE / 'copter.py'}:Copter", "gone.py:Gone"))
    rig = rig_library.load(str(tmp_path / "gone.toml"))
    out = tmp_path / "run"
    out.mkdir()
    with pytest.raises(VehicleError, match="does not answer"):
        fly_once(rig, 7, (), out, lambda _: None)
    gc.collect()
    assert "never retrieved" not in caplog.text
