"""A world in real time: for how long it stood still while drones flew."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.rig.tables import decode_table
from hil.harness.realtime.world import RealTimeWorld
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.ground import rig_library


class Paced(RealTimeWorld):
    """A world whose clock is set by the test."""

    def __init__(self) -> None:
        rig = rig_library.load("sim")
        super().__init__(rig, ["sender"])
        self.clock_s = 0.0
        self.in_air = False
        self._fleet = World(decode_table(rig.world, WorldConfig, rig.where("[world]")), 1)

    @property
    def fleet(self) -> World:
        return self._fleet

    def now_s(self) -> float:
        return self.clock_s

    def landed(self) -> bool:
        return not self.in_air

    async def open(self, stack: AsyncExitStack) -> Mapping[str, Any]:
        return {}

    def seen_by(self, name: str) -> Any:
        raise NotImplementedError

    def inject(self, order: Mapping[str, Any], at_s: float) -> None: ...

    def watch(self, steps: int, now_s: float) -> None: ...

    def findings(self) -> dict[str, Any]:
        return {}


def test_the_longest_time_between_two_steps_of_a_flight_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "orders").touch()
    with (tmp_path / "orders").open() as orders:
        monkeypatch.setattr("sys.stdin", orders)
        world = Paced()
    for k, (clock_s, in_air) in enumerate(
        [(0.1, False), (3.0, False), (3.05, True), (5.25, True), (5.3, True)]
    ):
        world.clock_s, world.in_air = clock_s, in_air
        world.step(k)
    assert world.stood_s == pytest.approx(2.2, abs=0.02)  # not the 2.9 s on the ground
