"""The world: the same floats for a seed however it is advanced, hover in wind, estimate errors,
faults, truth.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import FlightMode, VelocitySetpoint
from drivers.rig.tables import RigError, decode_table
from flight.guidance import subtract
from hil.harness.inject import inject_in_world
from hil.world.config import HomeConfig, PositionOffsetConfig, WorldConfig
from hil.world.errors import ErrorsConfig
from hil.world.estimator import EstimatorConfig, WindConfig
from hil.world.world import World
from path.geometry.rotation import yaw_of
from path.messages import Role

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)


def until(world: World, condition: Callable[[], bool], within_s: float = 40.0) -> None:
    end_s = world.time_s + within_s
    while not condition():
        assert world.time_s < end_s, f"not within {within_s} s"
        world.advance(world.time_s + 0.02)


def take_off(world: World, *roles: Role, height_m: float = 1.5) -> None:
    drones = [world.drone(role) for role in roles]
    until(world, lambda: all(drone.autopilot.armable for drone in drones))
    for drone in drones:
        assert drone.autopilot.request_arm(world.time_s, True).accepted
        assert drone.autopilot.request_takeoff(world.time_s, height_m).accepted
    until(world, lambda: all(drone.autopilot.mode is FlightMode.HOLD for drone in drones))


def fingerprint(world: World) -> tuple[Any, ...]:
    """Every float that could differ."""
    snapshot = world.snapshot()
    drones = [
        (d.T_w_b.R.tolist(), d.T_w_b.t.tolist(), d.velocity_w_mps, d.rotor_phase_rad)
        for d in snapshot.drones.values()
    ]
    return snapshot.objects, drones, [world.drone(role).estimate for role in Role]


def history(seed: int, steps: list[float]) -> tuple[Any, ...]:
    """A short flight advanced in the given steps, repeated; commands at fixed times."""
    world = World(WorldConfig(), seed)
    pilots = [world.drone(role).autopilot for role in Role]
    for time_s in (3.0, 3.2, 8.0, 9.0):
        for step in itertools.cycle(steps):
            if world.time_s + step >= time_s:
                break
            world.advance(world.time_s + step)
        world.advance(time_s)
        for own in pilots:
            if time_s == 3.0:
                own.request_arm(time_s, True)
            elif time_s == 3.2:
                own.request_takeoff(time_s, 1.5)
            elif time_s == 8.0:
                own.request_mode(time_s, FlightMode.RETURN)
    return fingerprint(world)


def test_one_seed_gives_the_same_floats_however_finely_it_is_advanced() -> None:
    coarse = history(5, [0.02])
    assert history(5, [0.02]) == coarse
    assert history(5, [0.003, 0.011, 0.001]) == coarse
    assert history(5, [1.7]) == coarse
    assert history(6, [0.02]) != coarse


def test_the_drones_random_numbers_do_not_depend_on_each_others_flight() -> None:
    alone, both = World(WorldConfig(), 3), World(WorldConfig(), 3)
    take_off(alone, Role.SENDER)
    take_off(both, Role.SENDER, Role.RECEIVER)
    end_s = max(alone.time_s, both.time_s) + 1.0
    alone.advance(end_s)
    both.advance(end_s)
    assert alone.drone(Role.SENDER).true_position_n_m == both.drone(Role.SENDER).true_position_n_m
    assert alone.drone(Role.SENDER).estimate == both.drone(Role.SENDER).estimate


@pytest.mark.parametrize("seed", range(3))
def test_hovers_in_gusty_wind(seed: int) -> None:
    config = WorldConfig(wind=WindConfig(speed_mps=4.0, gust_mps=1.0))
    world = World(config, seed)
    take_off(world, Role.SENDER)
    world.advance(world.time_s + 4.0)
    drone = world.drone(Role.SENDER)
    start = drone.true_position_n_m
    for _ in range(1500):
        world.advance(world.time_s + 0.02)
        assert math.dist(drone.true_position_n_m, start) < 0.8
    assert drone.autopilot.mode is FlightMode.HOLD


def test_tracks_a_commanded_velocity() -> None:
    world = World(WorldConfig(wind=WindConfig(speed_mps=3.0)), 2)
    take_off(world, Role.SENDER)
    drone = world.drone(Role.SENDER)
    drone.autopilot.setpoint(world.time_s, STILL)
    assert drone.autopilot.request_mode(world.time_s, FlightMode.OFFBOARD).accepted
    speeds: list[tuple[float, float, float]] = []
    for _ in range(400):
        drone.autopilot.setpoint(world.time_s, VelocitySetpoint((0.5, -0.3, 0.0), 0.0))
        world.advance(world.time_s + 0.02)
        speeds.append(drone.true_velocity_n_mps)
    mean = np.mean(speeds[150:], axis=0)
    assert mean == pytest.approx((0.5, -0.3, 0.0), abs=0.12)
    assert drone.autopilot.setpoint_gap_s < 0.03


def test_a_companion_that_dies_ends_landed_and_disarmed() -> None:
    world = World(WorldConfig(), 4)
    take_off(world, Role.SENDER, Role.RECEIVER)
    drone = world.drone(Role.RECEIVER)
    drone.autopilot.setpoint(world.time_s, STILL)
    drone.autopilot.request_mode(world.time_s, FlightMode.OFFBOARD)
    until(world, lambda: drone.on_ground and not drone.autopilot.armed, within_s=15.0)
    assert not world.drone(Role.SENDER).on_ground


def test_estimates_are_off_by_as_much_as_the_table_says_and_positions_wander() -> None:
    errors: list[list[float]] = []
    later: list[list[float]] = []
    tilts: list[float] = []
    for seed in range(60):
        world = World(WorldConfig(), seed)
        for role in Role:
            drone = world.drone(role)
            estimate, truth = drone.estimate, drone.true_position_n_m
            errors.append([e - t for e, t in zip(estimate.position_n_m, truth, strict=True)])
            tilts += [2.0 * math.degrees(component) for component in estimate.q_n_b[1:3]]
        world.advance(12.0)
        estimates = (world.drone(role).estimate.position_n_m for role in Role)
        truths = (world.drone(role).true_position_n_m for role in Role)
        later += [
            [e - t for e, t in zip(*both, strict=True)]
            for both in zip(estimates, truths, strict=True)
        ]
    sizes = np.array((0.5, 0.5, 1.0))
    for spread in (np.std(errors, axis=0), np.std(later, axis=0)):
        assert spread == pytest.approx(sizes, rel=0.25)
    wandered = sizes * math.sqrt(2.0 * (1.0 - math.exp(-12.0 / 1200.0)))
    assert np.std(np.subtract(later, errors), axis=0) == pytest.approx(wandered, rel=0.25)
    assert np.std(tilts) == pytest.approx(math.hypot(0.5, 0.2), rel=0.2)


def test_a_perfect_estimator_is_the_truth() -> None:
    names = [each.name for each in fields(EstimatorConfig)]
    world = World(WorldConfig(estimator=EstimatorConfig(**dict.fromkeys(names, 0.0))), 1)
    take_off(world, Role.SENDER)
    world.advance(math.ceil(world.time_s / 0.02) * 0.02)
    drone = world.drone(Role.SENDER)
    assert drone.estimate.position_n_m == pytest.approx(drone.true_position_n_m, abs=1e-12)
    assert drone.estimate.q_n_b == pytest.approx(drone.true_q_n_b, abs=1e-12)


def test_the_snapshot_is_the_same_truth_in_enu() -> None:
    world = World(
        WorldConfig(errors=ErrorsConfig("exact"), sender_home=HomeConfig((2.0, 5.0), 90.0)), 1
    )
    drone = world.snapshot().drones[Role.SENDER]
    assert drone.T_w_b.t == pytest.approx((2.0, 5.0, 0.1))
    nose, belly = drone.T_w_b.R[:, 0], drone.T_w_b.R[:, 2]
    assert nose == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)  # nose to the east
    assert belly == pytest.approx((0.0, 0.0, -1.0), abs=1e-12)
    take_off(world, Role.SENDER)
    north, east, down = world.drone(Role.SENDER).true_position_n_m
    world.advance(math.ceil(world.time_s / 0.02) * 0.02)
    north, east, down = world.drone(Role.SENDER).true_position_n_m
    assert world.snapshot().drones[Role.SENDER].T_w_b.t == pytest.approx(
        (east, north, -down), abs=1e-9
    )
    R = world.snapshot().drones[Role.SENDER].T_w_b.R
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_a_drone_stands_where_the_crew_put_it_and_not_quite_where_they_say() -> None:
    said = HomeConfig((2.0, 5.0), 90.0)
    off: list[float] = []
    for seed in range(40):
        world = World(WorldConfig(sender_home=said), seed)
        north, east, down = world.drone(Role.SENDER).true_position_n_m
        assert down == -0.1
        off += [east - 2.0, north - 5.0]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(0.05, rel=0.25)


def test_the_snapshot_moves_on_between_physics_steps() -> None:
    world = World(WorldConfig(), 1)
    take_off(world, Role.SENDER)
    drone = world.drone(Role.SENDER)
    for _ in range(50):
        drone.autopilot.setpoint(world.time_s, VelocitySetpoint((2.0, 0.0, 0.0), 0.0))
        drone.autopilot.request_mode(world.time_s, FlightMode.OFFBOARD)
        world.advance(world.time_s + 0.02)
    start_s = math.floor(world.time_s / 0.005) * 0.005 + 0.01
    north: list[float] = []
    for k in range(21):
        world.advance(start_s + 0.001 * k)
        snapshot = world.snapshot()
        assert snapshot.time_s == world.time_s
        north.append(float(snapshot.drones[Role.SENDER].T_w_b.t[1]))
    steps = np.diff(north)
    assert steps == pytest.approx(np.full(20, 0.002), rel=0.3)


def test_the_closest_two_are_looked_for_only_in_the_air() -> None:
    near = WorldConfig(errors=ErrorsConfig("exact"), receiver_home=HomeConfig((1.2, 0.0)))
    world = World(near, 1)
    take_off(world, Role.SENDER)
    assert world.closest(0.0).closest_m == math.inf
    take_off(world, Role.RECEIVER)
    assert 0.3 < world.closest(0.0).closest_m < 2.0


def test_faults_of_the_world() -> None:
    world = World(WorldConfig(), 1)
    world.advance(1.0)
    before = world.snapshot()
    assert not before.marker_hidden
    assert not before.depth_holes
    world.hide_marker(Role.SENDER)
    world.depth_holes(*Role)
    world.send_lookalike()
    after = world.snapshot()
    assert after.marker_hidden
    assert after.depth_holes
    assert len(after.objects) == len(before.objects) + 1
    world.uncover(*Role)
    assert not world.snapshot().marker_hidden
    world.hide_marker(Role.SENDER, 0.5)
    world.advance(world.time_s + 0.4)
    assert world.snapshot().marker_hidden
    world.advance(world.time_s + 0.2)
    assert not world.snapshot().marker_hidden
    world.battery(Role.SENDER, 0.05)
    assert world.drone(Role.SENDER).autopilot.battery == 0.05
    assert world.drone(Role.RECEIVER).autopilot.battery == 1.0


def test_an_estimator_steps_and_the_drone_does_not() -> None:
    world, plain = World(WorldConfig(), 1), World(WorldConfig(), 1)
    for each in (world, plain):
        each.advance(1.0)
    world.step_estimator(Role.RECEIVER, (1.0, -0.5, -0.2), 0.3)
    for each in (world, plain):
        each.advance(1.1)
    stepped, before = world.drone(Role.RECEIVER), plain.drone(Role.RECEIVER)
    moved = np.subtract(stepped.estimate.position_n_m, before.estimate.position_n_m)
    assert moved == pytest.approx((1.0, -0.5, -0.2))
    assert yaw_of(stepped.estimate.q_n_b) - yaw_of(before.estimate.q_n_b) == pytest.approx(
        0.3, abs=0.01
    )
    assert (stepped.estimate.resets, before.estimate.resets) == (1, 0)
    assert stepped.true_position_n_m == before.true_position_n_m
    assert world.drone(Role.SENDER).estimate == plain.drone(Role.SENDER).estimate


def test_time_does_not_go_back() -> None:
    world = World(WorldConfig(), 1)
    world.advance(1.0)
    with pytest.raises(ValueError, match="go back"):
        world.advance(0.5)


def test_the_configuration_is_a_table_and_wrong_keys_are_named() -> None:
    table = {
        "wind": {"speed_mps": 2},
        "target": {"start_m": [1, 6]},
        "autopilot": {"settle_s": 1.0},
    }
    config = decode_table(table, WorldConfig, "rig.toml: world")
    assert config == replace(
        WorldConfig(),
        wind=replace(WindConfig(), speed_mps=2.0),
        target=replace(WorldConfig().target, start_m=(1.0, 6.0)),
        autopilot=replace(WorldConfig().autopilot, settle_s=1.0),
    )
    with pytest.raises(RigError, match=r"speed_mps"):
        decode_table({"wind": {"speed": 2}}, WorldConfig, "rig.toml: world")
    with pytest.raises(RigError, match="at least 1 m apart"):
        decode_table({"receiver_home": {"position_m": [0.5, 0]}}, WorldConfig, "rig.toml: world")


def test_positions_that_are_apart_differ_by_as_much_as_is_told_and_change_nothing_else() -> None:
    names = [each.name for each in fields(EstimatorConfig)]
    exact = WorldConfig(estimator=EstimatorConfig(**dict.fromkeys(names, 0.0)))
    apart = replace(exact, position_offset=PositionOffsetConfig(across_m=2.0, height_m=1.0))
    angles: set[float] = set()
    for seed in range(5):
        right, wrong = World(exact, seed), World(apart, seed)
        assert wrong.drone(Role.SENDER).estimate == right.drone(Role.SENDER).estimate
        off, on = (world.drone(Role.RECEIVER).estimate.position_n_m for world in (wrong, right))
        n, e, d = subtract(off, on)
        assert (math.hypot(n, e), abs(d)) == pytest.approx((2.0, 1.0))
        angles.add(round(math.atan2(e, n), 3))
    assert len(angles) == 5


def test_positions_cannot_be_apart_by_less_than_nothing() -> None:
    with pytest.raises(ValueError, match="across_m"):
        PositionOffsetConfig(across_m=-1.0)


def test_what_is_on_the_ground_waits_until_it_is_told_to_begin() -> None:
    """However long a busy computer takes to start the drones' programs, the target is where it was
    said to be.
    """
    late, prompt = World(WorldConfig(), 3), World(WorldConfig(), 3)
    late.hold_traffic()
    late.advance(60.0)
    assert late.snapshot().objects[0].position_w_m == pytest.approx(
        prompt.snapshot().objects[0].position_w_m
    )
    late.begin_traffic()
    late.advance(90.0)
    prompt.advance(30.0)
    assert late.snapshot().objects[0].position_w_m == pytest.approx(
        prompt.snapshot().objects[0].position_w_m
    )


def test_a_fault_makes_the_air_of_drones_stronger() -> None:
    world = World(WorldConfig(), 1)
    assert world.air.wash == 1.0
    inject_in_world("wash", None, world, 2.0)
    assert world.air.wash == 2.0
