"""The embedded MAVLink vehicle, for its tests."""

from collections.abc import Iterator

import pytest

from tests.hil.vehicle.mavlink_bench import Bench


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()
