"""A drone comes down where nothing that it tracks can be by then, or where that is farthest."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flight.config import FollowConfig, GuardConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3
from flight.keep_out import Body, clear, followed, level_m, place_to_land
from flight.tracking.target_track import TargetTrack
from path.belief.motion import Motion

PERSON = MissionConfig(target=TargetDesignation(height_m=0.9, half_size_m=0.6, fastest_mps=0.5))
HERE = (0.0, 0.0, -3.5)


def body(north_m: float, speed_mps: float = 0.0, sigma_m: float = 0.05, **other: float) -> Body:
    mean = np.array((north_m, 0.0, -0.9, 0.0, speed_mps, 0.0))
    covariance = np.diag([sigma_m**2] * 3 + [0.01] * 3)
    return Body(Motion(mean, covariance, 0), 0.3, other.get("top_m", 1.75))


def room_m(
    one: Body, place: Vec3 = HERE, config: MissionConfig = PERSON, now_s: float = 0
) -> float:
    return clear(place, (one,), config, round(now_s * 1e9))


def test_there_is_room_for_ever_where_nobody_is() -> None:
    assert clear(HERE, (), PERSON, 0) == math.inf
    assert place_to_land(HERE, (), None, PERSON, 0) == HERE


def test_whoever_can_walk_there_before_the_landing_is_over_leaves_no_room() -> None:
    """From 3.5 m it takes 7 s, in which a person walks 3.5 m."""
    least_m = PERSON.separation.minimum_m + 0.3 + 3.5 + 2.0 * 0.05
    assert room_m(body(least_m + 0.01)) == pytest.approx(0.01)
    assert room_m(body(least_m - 0.01)) < 0.0
    assert room_m(body(least_m - 0.01), (0.0, 0.0, -2.0)) > 0.0


def test_who_was_seen_a_while_ago_or_is_known_worse_or_is_faster_may_have_come_nearer() -> None:
    assert room_m(body(6.0), now_s=1.0) == pytest.approx(room_m(body(6.0)) - 0.5)
    assert room_m(body(6.0, sigma_m=0.3)) == pytest.approx(room_m(body(6.0)) - 0.5)
    faster = replace(PERSON, target=replace(PERSON.target, fastest_mps=1.0))
    assert room_m(body(6.0), config=faster) < room_m(body(6.0)) - 2.0


def test_what_hardly_speeds_up_is_not_taken_to_be_as_fast_as_it_may_be_told_to_be() -> None:
    lazy = replace(PERSON, follow=FollowConfig(target_accel_mps2=0.0))
    still = body(6.0)
    still.motion.covariance[3:, 3:] = 0.0
    assert room_m(still, config=lazy) == pytest.approx(6.0 - 0.7 - 0.3 - 0.1)


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_a_world_so_many_times_as_large_leaves_so_many_times_the_room(k: float) -> None:
    """The drones' own descent is what it is: as long as that takes as long."""
    grown = body(6.0 * k, 0.3 * k, 0.05 * k)
    grown.motion.covariance[3:, 3:] *= k * k
    config = replace(
        PERSON,
        target=replace(PERSON.target, fastest_mps=0.5 * k),
        follow=FollowConfig(target_accel_mps2=0.6 * k),
        separation=replace(PERSON.separation, minimum_m=0.7 * k),
    )
    one = Body(grown.motion, 0.3 * k, 1.75 * k)
    assert room_m(one, config=config) == pytest.approx(k * room_m(body(6.0, 0.3)))


def test_it_goes_to_the_nearest_place_that_is_clear_down_to_where_it_is_in_nobody_s_way() -> None:
    near = body(2.0)
    there = place_to_land(HERE, (near,), None, PERSON, 0)
    assert there[2] == pytest.approx(-(1.75 + PERSON.separation.minimum_m))
    assert clear(there, (near,), PERSON, 0, level_m(HERE, there)) >= 0.0
    assert there[0] < 0.0
    nearer = (there[0] + 1.3, there[1], there[2])
    assert clear(nearer, (near,), PERSON, 0, level_m(HERE, nearer)) < 0.0


def test_among_many_it_goes_where_there_is_most_room() -> None:
    around = [
        Body(Motion(np.array((n, e, -0.9, 0, 0, 0.0)), 0.01 * np.eye(6), 0), 0.3, 1.75)
        for n, e in ((1.5, 0.0), (0.0, 1.5), (0.0, -1.5), (-7.0, 0.0))
    ]
    there = place_to_land(HERE, around, None, PERSON, 0)
    assert -4.0 < there[0] < -1.0
    assert clear(there, around, PERSON, 0) > clear((0.0, 0.0, there[2]), around, PERSON, 0)


def test_the_way_leads_neither_out_of_the_site_nor_nearer_to_the_other_drone() -> None:
    walled = replace(
        PERSON, guard=GuardConfig(corners_m=((9.0, 9.0), (9.0, -1.0), (-1.0, -1.0), (-1.0, 9.0)))
    )
    there = place_to_land(HERE, (body(2.0),), None, walled, 0)
    assert walled.fence.nearest(there) == pytest.approx(there)
    other = (-1.2, 0.0, -3.5)
    there = place_to_land(HERE, (body(2.0),), other, PERSON, 0)
    assert level_m(there, other) > level_m(HERE, other)


def test_what_flies_is_as_high_as_the_drone_and_the_way_does_not_lead_past_it() -> None:
    flier = body(-1.5, top_m=math.inf)
    there = place_to_land(HERE, (flier, body(2.0)), None, PERSON, 0)
    assert there[2] == HERE[2]
    assert abs(there[1]) > 1.0


def test_what_was_not_seen_for_long_is_anywhere_and_nothing_to_wait_for() -> None:
    track = TargetTrack((2.0, 0.0, -0.9), 0)
    assert [each.place_n_m for each in followed(track, PERSON, 0)] == [(2.0, 0.0, -0.9)]
    assert followed(track, PERSON, 5_000_000_001) == []
