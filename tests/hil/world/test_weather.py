"""The weather that a flight can be given by name; without it nothing changes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.interfaces import PartError
from hil.harness.inject import inject_in_world
from hil.render.spoilt import spoil
from hil.world.config import WorldConfig
from hil.world.faults import parse_faults
from hil.world.weather import COMPASS_S, SWING_S, Weather
from hil.world.world import World
from path.geometry.rotation import yaw_of
from path.messages import Role


def world_with(name: str, value: float) -> World:
    world = World(WorldConfig(), 4)
    inject_in_world(name, None, world, value)
    return world


def test_compasses_go_off_to_a_side_of_their_own_and_then_no_further() -> None:
    plain, off = World(WorldConfig(), 4), world_with("compass", 20.0)
    for until_s in (COMPASS_S + 1.0, COMPASS_S + 5.0):
        for world in (plain, off):
            world.advance(until_s)
        for role in Role:
            yaws = [yaw_of(world.drone(role).estimate.q_n_b) for world in (plain, off)]
            assert abs(yaws[1] - yaws[0]) == pytest.approx(math.radians(20.0), rel=0.02)


def test_a_leg_is_before_the_marker_for_its_share_of_the_time_by_seed() -> None:
    hidden = [[Weather(seed, leg=0.3).hides_marker(0.2 * k) for k in range(400)] for seed in (1, 2)]
    assert 0.2 < np.mean(hidden[0]) < 0.4
    assert hidden[0] != hidden[1]
    world = world_with("leg", 1.0)
    assert world.snapshot().marker_hidden
    assert not World(WorldConfig(), 4).snapshot().marker_hidden


def test_on_a_slope_what_is_on_the_ground_stands_higher_to_the_north() -> None:
    plain, sloping = World(WorldConfig(), 4), world_with("slope", 0.15)
    for level, there in zip(plain.all_objects, sloping.all_objects, strict=True):
        east, north, up = level.position_w_m
        assert there.position_w_m == pytest.approx((east, north, up + 0.15 * north))
    assert sloping.target() == sloping.all_objects[0]


def test_exposures_swing_and_come_back() -> None:
    weather = Weather(1, exposure=1.0)
    assert weather.light(0.25 * SWING_S) == pytest.approx(2.0)
    assert weather.light(0.75 * SWING_S) == pytest.approx(0.5)
    assert Weather(1).light(3.0) == 1.0
    light = np.full((3, 8, 8), 100, np.uint8)
    spoil(light, 2.0, 0.0, 1)
    assert (light == 200).all()
    spoil(light, 2.0, 0.0, 1)
    assert (light == 255).all()


def test_a_smudge_veils_one_place_of_the_image_and_nothing_else() -> None:
    light = np.zeros((3, 120, 160), np.uint8)
    light[:, :, ::8] = 240
    before = light.copy()
    spoil(light, 1.0, 0.3, 1)
    changed = (light != before).any(axis=0)
    rows, columns = np.nonzero(changed)
    assert 20 < np.ptp(rows) <= 36
    assert 20 < np.ptp(columns) <= 36
    assert float(np.ptp(light[0][changed])) < float(np.ptp(before[0][changed])) + 1.0
    untouched = before.copy()
    spoil(untouched, 1.0, 0.0, 1)
    assert np.array_equal(untouched, before)


@pytest.mark.parametrize(
    ("fault", "level", "said"),
    [
        ("smudge=0.3", "sim", "draws no frames"),
        ("exposure=1", "sim", "draws no frames"),
        ("slope=0.15", "sim-rendered", "real detectors"),
        ("slope=0.9", "sim", "not from -0.5 to 0.5"),
    ],
)
def test_weather_that_a_level_cannot_show_is_refused(fault: str, level: str, said: str) -> None:
    with pytest.raises(PartError, match=said):
        parse_faults([fault], level)
