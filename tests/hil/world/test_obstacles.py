"""What stands in the way in a world, and what tells that something touches it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from drivers.rig.obstacle import Obstacle
from hil.geometric.scene import boxes_of
from hil.world.config import WorldConfig
from hil.world.distances import DRONE_M, obstacles_m
from hil.world.dynamics import CONTACT
from hil.world.errors import ErrorsConfig
from hil.world.obstacles import ASIDE_M, HOME_M, Kind, ObstaclesConfig, crates_of
from hil.world.world import World
from path.messages import Role

CONFIG = WorldConfig(obstacles=ObstaclesConfig(8))
WALL = Obstacle((2.0, 0.0), (0.2, 6.0), 3.0)


def test_obstacles_are_off_the_way_of_what_drives_and_off_where_drones_stand() -> None:
    for seed in range(4):
        world = World(CONFIG, seed)
        assert len(world.obstacles) >= 4
        for role in Role:
            east, north = CONFIG.true_home(role, seed).position_m
            away_m = min(each.distance_m((north, east, 0.0)) for each in world.obstacles)
            assert away_m >= HOME_M
        for _ in range(30):
            world.advance(world.time_s + 2.0)
            for thing in world.snapshot().objects:
                east, north, up = thing.position_w_m
                away_m = min(each.distance_m((north, east, -up)) for each in world.obstacles)
                assert away_m >= ASIDE_M - 0.02


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_seed_has_its_obstacles_and_a_world_that_names_none_has_none(kind: Kind) -> None:
    config = replace(CONFIG, obstacles=ObstaclesConfig(5, (kind,)))
    assert World(config, 4).obstacles == World(config, 4).obstacles
    assert World(config, 4).obstacles != World(config, 5).obstacles
    assert World(WorldConfig(), 4).obstacles == ()


def test_what_a_crew_measured_stands_there_off_by_its_tape() -> None:
    config = WorldConfig(obstacles=ObstaclesConfig(known=(WALL,)))
    (stands,) = World(config, 3).obstacles
    assert 0.0 < math.dist(stands.place_m, WALL.place_m) < 0.3
    exact = replace(config, errors=ErrorsConfig("exact"))
    assert World(exact, 3).obstacles == (WALL,)


def test_the_boxes_of_a_round_one_lie_in_it_and_reach_its_edge() -> None:
    tree = Obstacle((1.0, -2.0), (2.0, 2.0), 5.0, 3.0, round=True)
    boxes = boxes_of(crates_of((tree,)))
    corners = [
        box[:3] + box[6:15].reshape(3, 3) @ (box[3:6] * (x, y, 1.0))
        for box in boxes
        for x in (-1.0, 1.0)
        for y in (-1.0, 1.0)
    ]
    across_m = [math.hypot(north - 1.0, east + 2.0) for east, north, _ in corners]
    assert np.allclose(across_m, 1.0)
    assert np.allclose([up for _, _, up in corners], 5.0)


def test_a_world_tells_how_far_each_body_in_the_air_is_from_what_stands_there() -> None:
    config = replace(CONFIG, obstacles=ObstaclesConfig(known=(WALL,)), errors=ErrorsConfig("exact"))
    world = World(config, 0)
    assert obstacles_m(world) == {}  # they stand on the ground
    world._states[:, :3] = (1.0, 0.0, -2.0), (4.0, 0.0, -5.0)
    world._states[:, CONTACT] = 0.0
    world._changed()
    near = obstacles_m(world)
    assert near[Role.SENDER] == pytest.approx(0.9 - DRONE_M)
    assert near[Role.RECEIVER] == pytest.approx(math.hypot(1.9, 2.0) - DRONE_M)
