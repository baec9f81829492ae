"""The drones' air in the world: it pushes who is in it, leans with the wind, and is turbulent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.rig.facts import DroneFacts
from flight.plan.derive import held_mps2
from flight.wash import keep_out_m, rotors_of
from hil.world.air import Air, AirConfig
from hil.world.config import HomeConfig, WorldConfig
from hil.world.dynamics import (
    CONTACT,
    GRAVITY_MPS2,
    MOTORS_FLY,
    THRUST,
    AirframeConfig,
    Array,
    fly,
    standing,
)
from hil.world.targets import TargetConfig
from hil.world.world import Fleet

CALM = np.zeros((2, 3))
USUAL = AirConfig()


def hovering(*places_n_m: tuple[float, float, float]) -> Array:
    rows = np.stack([standing(north, east, 0.0, 0.1) for north, east, _ in places_n_m])
    rows[:, 2] = [down for _, _, down in places_n_m]
    rows[:, THRUST] = GRAVITY_MPS2
    rows[:, CONTACT] = 0.0
    return rows


def mean_push(states: Array, winds: Array = CALM, config: AirConfig = USUAL) -> Array:
    """Of two seconds: of each drone, NED."""
    air = Air(config, 0.3, len(states), 0, 1, 0.02)
    pushes: list[Array] = []
    for _ in range(100):
        air.tick(states, winds)
        pushes.append(air.pushes.copy())
    return np.mean(pushes, axis=0)


def test_the_lower_one_is_pushed_down_and_the_upper_one_not_at_all() -> None:
    upper, lower = mean_push(hovering((0.0, 0.0, -3.0), (0.0, 0.0, -2.0)))
    assert not upper.any()
    assert 2.0 < lower[2] < 4.0
    assert np.abs(lower[:2]).max() < 0.5


def test_side_by_side_and_well_beside_each_other_there_is_no_push_at_all() -> None:
    for lower in ((0.0, 0.9, -3.0), (0.0, 1.0, -2.2), (1.1, 0.0, -1.5)):
        assert not mean_push(hovering((0.0, 0.0, -3.0), lower)).any()


def test_wind_carries_the_air_aside() -> None:
    wind = np.array([[0.0, 3.0, 0.0]] * 2)
    below = hovering((0.0, 0.0, -4.0), (0.0, 0.0, -2.5))
    leeward = hovering((0.0, 0.0, -4.0), (0.0, 0.6, -2.5))
    assert mean_push(below, wind)[1, 2] < mean_push(below)[1, 2]
    assert mean_push(leeward, wind)[1, 2] > 2.0 * mean_push(leeward)[1, 2]
    # a drone that flies as fast as the wind throws it straight down
    with_it = below.copy()
    with_it[:, 4] = 3.0
    assert mean_push(with_it, wind) == pytest.approx(mean_push(below))


def test_the_ground_turns_the_air_outward() -> None:
    low = mean_push(hovering((0.0, 0.0, -1.2), (0.0, 0.3, -0.11)))[1]
    high = mean_push(hovering((0.0, 0.0, -3.2), (0.0, 0.3, -2.11)))[1]
    assert low[2] < 0.6 * high[2]
    assert low[1] > high[1] + 0.1


def test_what_stands_and_what_does_not_turn_its_rotors_is_left_alone() -> None:
    rows = hovering((0.0, 0.0, -2.0), (0.0, 0.0, -0.1))
    rows[1, CONTACT] = 1.0
    assert not mean_push(rows).any()
    rows = hovering((0.0, 0.0, -3.0), (0.0, 0.0, -2.0))
    rows[0, THRUST] = 0.0
    assert not mean_push(rows).any()


def test_turbulence_is_of_the_seed_and_stronger_air_pushes_harder() -> None:
    states = hovering((0.0, 0.0, -3.0), (0.0, 0.2, -2.0))
    rows: dict[int, list[Array]] = {}
    for run, seed in enumerate((5, 5, 6)):
        air = Air(AirConfig(), 0.3, 2, 0, seed, 0.02)
        rows[run] = []
        for _ in range(300):
            air.tick(states, CALM)
            rows[run].append(air.pushes[1].copy())
    assert np.array_equal(rows[0], rows[1])
    assert not np.array_equal(rows[0], rows[2])
    assert 0.2 < np.std(rows[0], axis=0)[2] < 1.5
    twice = mean_push(states, config=AirConfig(wash=2.0))[1, 2]
    assert twice > 1.3 * mean_push(states)[1, 2]
    assert not mean_push(states, config=AirConfig(wash=0.0)).any()


def test_air_that_comes_back_from_walls_shakes_a_drone_that_is_alone() -> None:
    states = hovering((0.0, 0.0, -2.0))
    air = Air(AirConfig(recirculated=0.1), 0.3, 1, 0, 1, 0.02)
    air.tick(states, CALM)
    assert air.pushes.any()


def test_a_small_drone_is_pushed_by_a_large_ones_air_from_farther() -> None:
    states = hovering((0.0, 0.0, -3.0), (0.0, 0.75, -2.0))
    large = AirConfig(drone=DroneFacts(diameter_m=0.8, mass_kg=2.5))
    assert mean_push(states, config=large)[1, 2] > mean_push(states)[1, 2]


def test_a_micro_uav_below_a_drone_is_pushed_off_its_way_and_comes_back() -> None:
    target = TargetConfig(kind="drone", speed_mps=0.0, start_m=(0.0, 4.0), climb_m=0.0)
    config = WorldConfig(target=target)
    world = Fleet(config, 1, {"one": HomeConfig(), "two": HomeConfig((3.0, 0.0))})
    x, y, z = world.target().position_w_m
    air = world.air
    states = hovering((y, x, -z - 1.0), (50.0, 0.0, -3.0))
    for _ in range(25):
        air.move_targets([(x, y, z)], states, CALM, 0.08)
    assert 0.1 < z - world.target().position_w_m[2] < 0.6
    assert world.objects_near("one")[0] == world.target() == world.all_objects[0]
    states[0, 1] += 5.0
    for _ in range(50):
        air.move_targets([(x, y, z)], states, CALM, 0.08)
    assert world.target().position_w_m == pytest.approx((x, y, z), abs=0.01)


def test_what_drives_is_not_pushed() -> None:
    world = Fleet(WorldConfig(), 1, {"one": HomeConfig()})
    assert len(world.air.shifts_w_m) == 0
    assert replace(world.target()) == world.target()


@pytest.mark.parametrize(("share", "least_m", "most_m"), [(0.0, 0.4, 0.8), (1.0, 0.05, 0.2)])
def test_a_drone_at_the_keep_out_sinks_by_less_than_it_wanders_and_below_the_middle_by_more(
    share: float, least_m: float, most_m: float
) -> None:
    drone = DroneFacts()
    beside_m = share * keep_out_m(rotors_of(drone), 1.0, held_mps2(drone))
    rows = hovering((0.0, 0.0, -4.0), (beside_m + 3.0, 0.0, -3.0))
    air = Air(USUAL, 0.3, 2, 0, 3, 0.02)
    goals = rows[:, :3].copy()
    command = np.zeros((2, 5))
    command[:, 0] = MOTORS_FLY
    sunk_m = 0.0
    for k in range(500):
        air.tick(rows, CALM)
        goals[1, 0] = beside_m + max(0.0, 3.0 - 0.03 * k)  # it flies in from aside
        command[:, 1:4] = 0.9 * (goals - rows[:, :3])
        fly(rows, command, CALM, air.pushes, CALM, CALM, AirframeConfig().row(), 0.005, 4)
        sunk_m = max(sunk_m, rows[1, 2] - goals[1, 2])
    assert least_m < sunk_m < most_m
