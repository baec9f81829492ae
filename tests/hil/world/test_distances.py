"""The distance from a target's body to a drone's."""

from __future__ import annotations

import math

import pytest

from hil.world.config import WorldConfig
from hil.world.distances import DRONE_M, clearance
from hil.world.dynamics import CONTACT
from hil.world.snapshot import TargetKind
from hil.world.targets import TargetConfig
from hil.world.world import World
from path.messages import Role


class Above(World):
    """A world whose sender hangs at a place and whose receiver is on the ground."""

    def __init__(self, kind: TargetKind, north: float, east: float, height_m: float) -> None:
        super().__init__(WorldConfig(target=TargetConfig(kind=kind)), 1)
        state = self._states[0]
        state[:3] = north, east, -height_m
        state[CONTACT] = 0.0


@pytest.mark.parametrize(
    ("kind", "height_m", "expected_m"),
    [
        ("person", 1.75 + 1.0, 1.0),
        ("person", 0.5, 2.0 - 0.35),
        ("drone", 1.0, 2.0 - 0.16),
        ("car", 0.2, math.inf),
    ],
)
def test_it_is_between_the_bodies(kind: TargetKind, height_m: float, expected_m: float) -> None:
    """The target waits 4 m to the north: straight above it, or two metres to its side."""
    aside_m = 0.0 if height_m > 1.75 else 2.0
    world = Above(kind, 4.0, aside_m, height_m)
    assert world.drone(Role.RECEIVER).on_ground
    assert clearance(world) == pytest.approx(expected_m - DRONE_M)
