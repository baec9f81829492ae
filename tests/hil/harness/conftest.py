"""What the tests of the harness fly with."""

from pathlib import Path
from typing import Any

import pytest

from missions.ground import rig_library
from tests.hil.harness.programs_on_stage import Stage


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sitl")


@pytest.fixture
def stage(rig: Any, tmp_path: Path) -> Stage:
    return Stage(rig, tmp_path)
