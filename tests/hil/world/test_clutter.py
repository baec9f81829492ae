"""Crates beside the target's way."""

from __future__ import annotations

import math

from hil.world.clutter import ASIDE_M, CLEAR_M
from hil.world.config import SceneConfig, WorldConfig
from hil.world.world import World
from path.messages import Role

CONFIG = WorldConfig(scene=SceneConfig(crates=120))


def test_crates_are_beside_the_way_of_the_target_and_of_all_that_stands() -> None:
    for seed in range(3):
        world = World(CONFIG, seed)
        lying = world.snapshot().crates
        assert len(lying) > 60
        for crate in lying:
            world_clear_m = crate.half_m + CLEAR_M
            for role in Role:
                home = CONFIG.true_home(role, seed).position_m
                assert math.dist(crate.place_m, home) > world_clear_m
        for _ in range(40):
            world.advance(world.time_s + 2.0)
            target = world.snapshot().objects[0].position_w_m[:2]
            nearest = min(math.dist(each.place_m, target) - each.half_m for each in lying)
            assert nearest >= ASIDE_M - 0.02


def test_a_seed_has_its_crates_and_a_world_that_names_none_has_none() -> None:
    assert World(CONFIG, 4).snapshot().crates == World(CONFIG, 4).snapshot().crates
    assert World(CONFIG, 4).snapshot().crates != World(CONFIG, 5).snapshot().crates
    assert World(WorldConfig(), 4).snapshot().crates == ()
