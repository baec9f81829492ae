"""Which object is acquired, in the ground traffic of many seeds: the one that was pointed at, or none, however late."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flight.config import Designated, TargetDesignation, off_from
from flight.guidance import Vec3
from flight.tracking.acquisition import acquire
from hil.world.targets import GroundVehicles, LookAlikeConfig, TargetConfig
from path.geometry.transforms import Pose
from path.observations import MissReason
from tests.flight.following_bench import CAMERA, MOUNT, Seen

SEEDS = 150
POINTED = TargetDesignation()
PARKED_S = TargetConfig().start_time_s


def acquired(seed: int, time_s: float, designated: Designated, up: float = 1.0) -> int | None:
    """Which object (0: the target) D1 takes from its first place, its position wrong by 0.25 m each way; None: none.

    ``up``: times as high and as far off.
    """
    rng = np.random.default_rng(10_000 + seed)
    off = np.array([*rng.normal(0.0, 0.25, 2).tolist(), 0.0])
    traffic = GroundVehicles(TargetConfig(), LookAlikeConfig(), [(0.0, 0.0), (1.5, -3.0)], np.random.SeedSequence(seed))
    objects: list[Vec3] = [(o.position_w_m[1], o.position_w_m[0], -0.1) for o in traffic.at(time_s)]
    at = np.array((4.0 - 1.45 * up, 0.0, -0.1 - 1.4 * up))
    true = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + at - off)
    found = acquire(Seen(0, objects, true, rng), Pose(true.R, true.t + off), CAMERA, designated)
    if not isinstance(found, tuple):
        return None
    place = np.array(found[1]) - off
    return min(range(len(objects)), key=lambda k: math.dist(objects[k], place.tolist()))


def test_in_time_the_target_is_acquired_and_nothing_else() -> None:
    taken = [acquired(seed, 12.0, POINTED.at(12.0)) for seed in range(SEEDS)]
    assert set(taken) <= {0, None}
    assert taken.count(0) >= 0.9 * SEEDS


@pytest.mark.parametrize("late_s", [1.0, 3.0, 4.5, 8.0])
@pytest.mark.parametrize("up", [1.0, 2.0])
def test_however_late_no_look_alike_is_acquired(late_s: float, up: float) -> None:
    time_s = PARKED_S + late_s
    assert {acquired(seed, time_s, POINTED.at(time_s), up) for seed in range(SEEDS)} <= {0, None}


def test_a_place_alone_takes_the_look_alike_that_came_to_it() -> None:
    """The wrong objects that a designation's age is there to prevent: most seeds, when it is taken to hold for ever."""
    stale = TargetDesignation(holds_s=3600.0)
    taken = [acquired(seed, PARKED_S + 4.5, stale.at(PARKED_S + 4.5)) for seed in range(SEEDS)]
    assert sum(who not in (0, None) for who in taken) > 0.4 * SEEDS


def test_a_moving_object_is_acquired_where_it_has_come_to() -> None:
    told = TargetDesignation(north_m=3.0, east_m=-1.0, north_mps=0.2, east_mps=0.1, age_s=2.0, holds_s=12.0)
    assert told.at(8.0).place_n_m == pytest.approx((5.0, 0.0, -0.1))
    assert told.at(8.0).drift_m == 0.0
    assert told.at(13.0).drift_m == pytest.approx(0.5 * 3.0)
    assert told.at(13.0).radius_m == pytest.approx(0.9 + 1.5)


def test_one_alone_is_taken_only_where_all_the_ground_is_seen() -> None:
    """A second after the place stopped to hold: from twice as high all of it is in the image."""
    later = Designated((4.0, 0.0, -0.1), 0.5, 0.5)

    def alone(up: float) -> bool:
        at = np.array((4.0 - 1.45 * up, 0.0, -0.1 - 1.4 * up))
        pose = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + at)
        return isinstance(
            acquire(Seen(0, [(4.1, 0.2, -0.1)], pose, np.random.default_rng(0)), pose, CAMERA, later), tuple
        )

    assert alone(2.0)
    assert not alone(1.0)


def test_what_a_position_is_off_at_home_is_taken_out_of_the_place() -> None:
    pointed = TargetDesignation(north_mps=0.5, home_m=(1.0, -2.0))
    off_m = off_from(pointed.home_m, (1.4, -2.7, 0.1))
    assert off_m == pytest.approx((0.4, -0.7))
    assert pointed.at(2.0, off_m).place_n_m == pytest.approx((5.4, -0.7, -0.1))
    assert off_from(None, (1.4, -2.7, 0.1)) == off_from((), (1.4, -2.7, 0.1)) == (0.0, 0.0)


def test_with_a_known_home_a_position_far_off_takes_the_target_and_without_it_nothing_or_another_one() -> None:
    """1.2 m behind the target a look-alike stands where a drone that is off so much takes the place to be."""
    away = np.array([-1.2, 0.0, 0.0])
    objects: list[Vec3] = [(4.0, 0.0, -0.1), (5.2, 0.0, -0.1)]
    true = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + np.array((2.55, 0.0, -1.5)))
    seen = Seen(0, objects, true, np.random.default_rng(1))
    for pointed, taken in ((TargetDesignation(), 1), (TargetDesignation(home_m=(0.0, 0.0)), 0)):
        designated = pointed.at(12.0, off_from(pointed.home_m, (-1.2, 0.0, 0.0)))
        found = acquire(seen, Pose(true.R, true.t + away), CAMERA, designated)
        assert not isinstance(found, MissReason)
        there = found[1][0] - away[0]
        assert there == pytest.approx(objects[taken][0], abs=0.15)
