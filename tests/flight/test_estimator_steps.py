"""What counts as a step of an estimator, and what is flown, noise, or a glitch that is walked
off.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode, VehicleState
from flight.estimator_steps import SETTLED_NS, Step, StepWatch
from flight.guidance import Vec3, add
from path.geometry.rotation import multiply, quat_from_rpy

PERIOD_NS = 20_000_000
FASTEST_MPS = 1.2
NOISE_M, NOISE_RAD = 0.006, 0.0015  # from one state to the next, as the simulated estimators have


def states(
    count: int, *, seed: int = 1, turning_rps: float = 0.0, period_ns: int = PERIOD_NS
) -> list[VehicleState]:
    """A drone in the air that flies to and fro, speeds up, brakes and turns, as a noisy estimator
    says.
    """
    rng = random.Random(seed)
    made: list[VehicleState] = []
    drift: Vec3 = (0.0, 0.0, 0.0)
    yaw_error = 0.0
    for k in range(count):
        t_s = k * period_ns * 1e-9
        drift = add(
            drift, (rng.gauss(0.0, NOISE_M), rng.gauss(0.0, NOISE_M), rng.gauss(0.0, NOISE_M))
        )
        yaw_error += rng.gauss(0.0, NOISE_RAD)
        place = add((1.2 * math.sin(t_s), 0.0, -1.5 + 0.2 * math.cos(t_s)), drift)
        velocity = 1.2 * math.cos(t_s), 0.0, -0.2 * math.sin(t_s)
        yaw_rad = turning_rps * math.sin(2.0 * t_s) / 2.0 + yaw_error
        q_n_b = quat_from_rpy(0.05, -0.05, yaw_rad)
        stamp_ns = k * period_ns + 1
        made.append(
            VehicleState(
                stamp_ns,
                stamp_ns,
                place,
                velocity,
                q_n_b,
                True,
                True,
                True,
                FlightMode.OFFBOARD,
                0.9,
            )
        )
    return made


def stepped(
    made: Sequence[VehicleState], at: int, shift_n_m: Vec3, turn_rad: float = 0.0
) -> list[VehicleState]:
    """The same, but for an estimator that steps before the state of a number."""
    turn = quat_from_rpy(0.0, 0.0, turn_rad)
    return [
        replace(
            each,
            position_n_m=add(each.position_n_m, shift_n_m),
            q_n_b=multiply(turn, each.q_n_b),
        )
        if k >= at
        else each
        for k, each in enumerate(made)
    ]


def seen(made: Iterable[VehicleState]) -> list[Step]:
    watch = StepWatch(FASTEST_MPS)
    return [step for each in made if (step := watch.look(each)) is not None]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("period_ns", [PERIOD_NS, 50_000_000])
def test_a_drone_that_flies_and_turns_has_no_steps(seed: int, period_ns: int) -> None:
    assert seen(states(3000, seed=seed, turning_rps=1.0, period_ns=period_ns)) == []


@pytest.mark.parametrize("size_m", [0.25, 0.6, 1.54, 3.0])
@pytest.mark.parametrize("towards_deg", range(0, 360, 45))
def test_a_place_that_steps_in_any_direction_is_seen_with_its_size(
    size_m: float, towards_deg: int
) -> None:
    shift = (
        size_m * math.cos(math.radians(towards_deg)),
        size_m * math.sin(math.radians(towards_deg)),
        0.0,
    )
    made = stepped(states(400), 200, shift)
    (step,) = seen(made)
    assert math.dist(step.shift_n_m, shift) < 0.04
    assert step.turn_rad == 0.0
    assert (step.before_ns, step.stamp_ns) == (made[199].stamp_ns, made[200].stamp_ns)
    assert str(step) == f"its place by {math.hypot(*step.shift_n_m):.2f} m"


@pytest.mark.parametrize("up_m", [-3.0, -0.25, 0.25, 1.0])
def test_a_height_that_steps_is_seen_with_its_size(up_m: float) -> None:
    (step,) = seen(stepped(states(400), 200, (0.0, 0.0, -up_m)))
    assert step.shift_n_m[:2] == (0.0, 0.0)
    assert step.shift_n_m[2] == pytest.approx(-up_m, abs=0.04)
    assert str(step).startswith("its height by ")


@pytest.mark.parametrize("turn_deg", [-40.0, -5.0, 5.0, 20.0, 170.0])
@pytest.mark.parametrize("turning_rps", [0.0, 0.8])
def test_a_heading_that_steps_is_seen_with_its_size_while_the_drone_turns_too(
    turn_deg: float, turning_rps: float
) -> None:
    (step,) = seen(
        stepped(states(400, turning_rps=turning_rps), 200, (0.0, 0.0, 0.0), math.radians(turn_deg))
    )
    assert step.shift_n_m == (0.0, 0.0, 0.0)
    assert math.degrees(step.turn_rad) == pytest.approx(turn_deg, abs=1.0)


def test_a_place_and_a_heading_may_step_at_once() -> None:
    (step,) = seen(stepped(states(400), 200, (0.8, -0.5, 0.4), 0.3))
    assert math.dist(step.shift_n_m, (0.8, -0.5, 0.4)) < 0.06
    assert step.turn_rad == pytest.approx(0.3, abs=0.02)


def test_a_glitch_that_the_estimator_walks_off_is_no_step() -> None:
    made = states(600)
    walked = [
        replace(
            each,
            position_n_m=add(each.position_n_m, (0.9 * min(1.0, max(0, k - 200) / 135), 0.0, 0.0)),
        )
        for k, each in enumerate(made)
    ]
    assert seen(walked) == []


def test_a_packet_that_is_wrong_once_steps_there_and_back_again() -> None:
    made = states(400)
    made[200] = replace(made[200], position_n_m=add(made[200].position_n_m, (2.0, 0.0, 0.0)))
    there, back = seen(made)
    assert math.dist(add(there.shift_n_m, back.shift_n_m), (0.0, 0.0, 0.0)) < 0.05


def test_what_moves_while_nothing_is_heard_is_no_step() -> None:
    made = states(400)
    # half a second without telemetry
    made = [*made[:200], *stepped(made, 225, (0.3, 0.0, 0.0), 0.2)[225:]]
    assert seen(made) == []


def test_a_vehicle_that_still_finds_its_place_has_no_steps() -> None:
    made = [replace(each, armable=False, armed=False, in_air=False) for each in states(400)]
    assert seen(stepped(made, 200, (5.0, 0.0, 0.0), 1.0)) == []
    unknown = [replace(each, position_n_m=(math.nan, math.nan, math.nan)) for each in states(200)]
    assert seen([*unknown, *states(400)[200:]]) == []


def test_the_height_of_one_that_stands_on_the_ground_is_counted_anew_when_it_arms() -> None:
    standing = [replace(each, armed=False, in_air=False) for each in states(200)]
    armed = [
        replace(each, in_air=False) for each in stepped(states(400), 200, (0.0, 0.0, 1.0))[200:]
    ]
    assert seen([*standing, *armed]) == []
    settled = SETTLED_NS // PERIOD_NS + 10
    late = stepped([*standing, *armed], 200 + settled, (0.0, 0.0, 1.0))
    assert [step.shift_n_m[2] for step in seen(late)] == [pytest.approx(1.0, abs=0.04)]


def test_a_place_steps_on_the_ground_too() -> None:
    standing = [replace(each, armed=False, in_air=False) for each in states(400)]
    assert len(seen(stepped(standing, 200, (0.0, 1.0, 0.0)))) == 1


def test_where_the_autopilot_counts_its_resets_a_smaller_step_is_seen() -> None:
    size_m = 0.09
    made = stepped(states(400), 200, (0.0, size_m, 0.0))
    assert seen(made) == []
    counting = [replace(each, resets=3 if k < 195 else 4) for k, each in enumerate(made)]
    (step,) = seen(counting)
    assert step.counted
    assert step.shift_n_m[1] == pytest.approx(size_m, abs=0.03)
    assert seen([replace(each, resets=3) for each in made]) == []


def test_a_count_of_resets_without_a_step_is_none() -> None:
    assert seen([replace(each, resets=k // 100) for k, each in enumerate(states(1000))]) == []


def test_states_of_one_burst_are_held_against_the_next_that_is_later() -> None:
    made = states(400)
    burst = [*made[:200], replace(made[200], stamp_ns=made[199].stamp_ns + 1), *made[201:]]
    assert seen(burst) == []


@pytest.mark.parametrize("late_s", [0.03, 0.08])
def test_telemetry_that_comes_late_and_then_at_once_is_no_step(late_s: float) -> None:
    made = states(3000, turning_rps=1.0)
    late_ns = round(late_s * 1e9)
    for begin in range(100, 2900, 97):
        held_until_ns = made[begin].stamp_ns + late_ns
        for k in range(begin, begin + late_ns // PERIOD_NS + 1):
            made[k] = replace(made[k], stamp_ns=max(made[k].stamp_ns, held_until_ns + k - begin))
    assert seen(made) == []


def test_noise_that_grows_is_learned_and_not_taken_for_steps_for_ever() -> None:
    made = states(1500)
    rng = random.Random(2)
    noisy = [
        replace(
            each,
            position_n_m=add(each.position_n_m, (rng.gauss(0.0, 0.2), rng.gauss(0.0, 0.2), 0.0)),
        )
        if k > 300
        else each
        for k, each in enumerate(made)
    ]
    steps = seen(noisy)
    assert 0 < len(steps) < 20
    assert steps[-1].stamp_ns < made[400].stamp_ns


def test_a_height_that_becomes_the_grounds_at_a_landing_is_no_step() -> None:
    made = states(400)
    down = [replace(each, in_air=False) for each in stepped(made, 200, (0.0, 0.0, 0.14))[200:]]
    assert seen([*made[:200], *down]) == []
