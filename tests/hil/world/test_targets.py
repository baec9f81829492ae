"""Target and look-alikes: smooth, bounded, apart from each other, and the one that is sent comes
close but not too.
"""

import math
from itertools import pairwise

import numpy as np
import pytest

from hil.world.snapshot import ObjectTruth
from hil.world.targets import (
    CROSSING_S,
    HIGHEST_M,
    LOWEST_M,
    GroundVehicles,
    LookAlikeConfig,
    TargetConfig,
)

TARGET = TargetConfig(start_time_s=20.0, stands_s=(0.0, 0.0))  # steadily, once it has started
HOMES = ((0.0, 0.0), (1.5, -3.0))
SEEDS = range(25)


def traffic(
    seed: int, target: TargetConfig = TARGET, look_alikes: LookAlikeConfig | None = None
) -> GroundVehicles:
    return GroundVehicles(
        target, look_alikes or LookAlikeConfig(), HOMES, np.random.SeedSequence(seed)
    )


def apart(a: ObjectTruth, b: ObjectTruth) -> float:
    return math.dist(a.position_w_m, b.position_w_m)


@pytest.mark.parametrize("seed", SEEDS)
def test_look_alikes_keep_away_and_the_target_stays_in_its_radius(seed: int) -> None:
    world = traffic(seed)
    for k in range(300):
        target, *others = world.at(0.4 * k)
        assert len(others) == 3
        assert min(apart(target, other) for other in others) >= 1.199
        assert math.dist(target.position_w_m[:2], TARGET.start_m) <= TARGET.radius_m


@pytest.mark.parametrize("seed", SEEDS)
def test_the_one_that_is_sent_passes_close_without_touching_anything(seed: int) -> None:
    world = traffic(seed)
    world.send_lookalike(30.0)
    assert len(world.at(29.9)) == 4
    times = np.linspace(30.0, 30.0 + CROSSING_S, 701)[1:-1]
    to_target: list[float] = []
    to_others: list[float] = []
    for time_s in times:
        target, *others, sent = world.at(float(time_s))
        to_target.append(apart(target, sent))
        to_others.append(min(apart(sent, other) for other in others))
        assert sent.object_id == 4
    assert 0.355 <= min(to_target) <= 0.405
    assert to_target[0] > 3.0
    assert to_target[-1] > 3.0
    assert min(to_others) > 0.4
    assert len(world.at(30.0 + CROSSING_S + 0.1)) == 4


def test_the_target_waits_then_drives_smoothly_at_its_speed() -> None:
    world = traffic(3)
    parked = world.at(0.0)[0]
    assert parked.position_w_m == pytest.approx((*TARGET.start_m, 0.0), abs=1e-9)
    assert world.at(TARGET.start_time_s)[0] == parked
    dt = 0.05
    track = [world.at(TARGET.start_time_s + dt * k)[0] for k in range(1200)]
    speeds = [apart(b, a) / dt for a, b in pairwise(track)]
    assert max(speeds) < TARGET.speed_mps * 1.01
    assert max(abs(b - a) / dt for a, b in pairwise(speeds)) < 0.4
    turns = [math.remainder(b.yaw_rad - a.yaw_rad, 2 * math.pi) / dt for a, b in pairwise(track)]
    assert math.degrees(max(map(abs, turns))) < 25.0
    assert track[-1].speed_mps == TARGET.speed_mps


def test_targets_move_from_the_start_stand_now_and_then_and_start_and_stop_smoothly() -> None:
    dt = 0.05
    first_stands = 0
    for seed in SEEDS:
        world = traffic(seed, TargetConfig())
        track = [world.at(dt * k)[0] for k in range(2400)]
        speeds = np.array([apart(b, a) / dt for a, b in pairwise(track)])
        assert speeds.max() < TARGET.speed_mps * 1.01
        assert np.abs(np.diff(speeds)).max() / dt < 0.4
        stands = speeds < 1e-6
        assert 0.02 < stands[200:].mean() < 0.4
        assert speeds[:120].max() > 0.0  # within six seconds
        first_stands += bool(stands[:19].all())
        said = np.array([thing.speed_mps for thing in track[1:]])
        assert np.abs(said - speeds).max() < 0.02
    assert 0 < first_stands < len(SEEDS) // 2


def test_where_a_target_is_does_not_depend_on_when_it_was_asked_before() -> None:
    asked_late, asked_often = traffic(8, TargetConfig()), traffic(8, TargetConfig())
    for k in range(100):
        asked_often.at(float(k))
    assert asked_late.at(77.3) == asked_often.at(77.3)
    assert asked_late.at(12.1) == asked_often.at(12.1)


def test_turns_of_driving_and_standing_are_checked() -> None:
    with pytest.raises(ValueError, match="the least comes first"):
        TargetConfig(stands_s=(5.0, 1.0))
    with pytest.raises(ValueError, match="to start and to stop in"):
        TargetConfig(drives_s=(2.0, 9.0))


def test_the_nose_points_where_it_drives() -> None:
    world = traffic(4)
    for k in range(200):
        a, b = world.at(25.0 + 0.2 * k)[0], world.at(25.01 + 0.2 * k)[0]
        course = math.atan2(
            b.position_w_m[1] - a.position_w_m[1], b.position_w_m[0] - a.position_w_m[0]
        )
        assert math.remainder(course - a.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=0.03)


def test_a_sent_look_alike_points_where_it_drives() -> None:
    world = traffic(5)
    world.send_lookalike(40.0)
    a, b = world.at(43.0)[-1], world.at(43.01)[-1]
    course = math.atan2(
        b.position_w_m[1] - a.position_w_m[1], b.position_w_m[0] - a.position_w_m[0]
    )
    assert math.remainder(course - a.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=0.02)
    assert apart(a, b) / 0.01 == pytest.approx(a.speed_mps, rel=0.02)


def test_sending_one_moves_no_other() -> None:
    plain, fault = traffic(6), traffic(6)
    fault.send_lookalike(10.0)
    assert fault.at(13.0)[:4] == plain.at(13.0)


def test_all_parked_or_all_driving() -> None:
    for driving, moving in ((0, 0), (3, 3)):
        world = traffic(7, look_alikes=LookAlikeConfig(driving=driving))
        before, after = world.at(30.0), world.at(31.0)
        assert sum(apart(a, b) > 0.1 for a, b in zip(before[1:], after[1:], strict=True)) == moving


def test_says_so_when_there_is_no_room() -> None:
    with pytest.raises(ValueError, match="radius_m"):
        traffic(0, TargetConfig(radius_m=1.0), LookAlikeConfig(count=30, driving=0))
    with pytest.raises(ValueError, match="driving"):
        traffic(0, look_alikes=LookAlikeConfig(count=12, driving=12))


def test_what_flies_goes_up_and_down_and_its_look_alikes_hang_at_heights_of_their_own() -> None:
    flying = TargetConfig(kind="drone", start_time_s=20.0, height_m=0.8, climb_m=1.6, climb_s=20.0)
    world = traffic(7, flying)
    heights = [world.at(0.1 * k)[0].position_w_m[2] for k in range(1200)]
    assert (min(heights), max(heights)) == pytest.approx((0.8, 2.4), abs=0.01)
    assert heights[: round(10 * flying.start_time_s)] == [0.8] * round(10 * flying.start_time_s)
    before, after = world.at(33.0)[0], world.at(33.01)[0]
    assert (after.position_w_m[2] - before.position_w_m[2]) / 0.01 == pytest.approx(
        before.climb_mps, abs=0.01
    )
    parked = [thing.position_w_m[2] for thing in world.at(33.0)[2:]]
    assert all(LOWEST_M <= height <= HIGHEST_M for height in parked)
    assert len(set(parked)) == 2
    world.send_lookalike(33.0)
    assert world.at(36.0)[-1].position_w_m[2] == world.at(36.0)[0].position_w_m[2]


@pytest.mark.parametrize("seed", SEEDS)
def test_people_pass_each_other_an_arm_apart(seed: int) -> None:
    world = traffic(seed, TargetConfig(kind="person"))
    world.send_lookalike(30.0)
    passing = [world.at(30.0 + 0.01 * k) for k in range(1, 700)]
    assert 0.74 <= min(apart(target, sent) for target, *_, sent in passing) <= 0.81


def test_cars_and_people_stay_on_the_ground() -> None:
    for config in (TARGET, TargetConfig(kind="person")):
        assert {thing.position_w_m[2] for thing in traffic(7, config).at(50.0)} == {0.0}


def test_no_target_flies_higher_than_was_said() -> None:
    with pytest.raises(ValueError, match="must not be above 3 m"):
        TargetConfig(kind="drone", height_m=2.0, climb_m=1.5)
