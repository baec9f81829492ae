"""The rig of all tests of a leg."""

from __future__ import annotations

import pytest

from drivers.rig.parts import Rig
from missions.ground import rig_library


@pytest.fixture(scope="package")
def rig() -> Rig:
    return rig_library.load("sim")
