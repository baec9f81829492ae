"""What was said, as densities: each adds up to one, widens as it should, and counts as Bayes has it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.operator.interfaces import BearingTold, PlaceTold, RegionTold
from flight.config import GuardConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3
from flight.tracking import statements as file
from flight.tracking.candidates import Candidate, Observed
from flight.tracking.statements import Look, Motion, Statements, outside
from path.belief.motion import Motion as Moves
from path.geometry.transforms import Pose
from path.observations import Box
from tests.flight.following_bench import CAMERA

S = 1_000_000_000
MOTION = Motion(fastest_mps=2.0, accel_mps2=0.5, farthest_m=60.0, down_m=-0.9)
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.0, 2.0))
DOWN = Pose(
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([5.0, 1.0, -6.0])
)

AWAY = Pose(DOWN.R, np.array([305.0, 1.0, -6.0]))


def seen_at(
    place: Vec3, since_s: float = 0.0, until_s: float = 10.0, moves: Vec3 = (0.0, 0.0, 0.0)
) -> Candidate:
    """An object that went evenly and was last at a place."""
    observed = Observed(Box(0.0, 0.0, 1.0, 1.0), None, place, np.eye(3))
    covariance = np.diag([0.01] * 3 + [0.04] * 3)
    motion = Moves(np.array([*place, *moves]), covariance, round(until_s * S))
    one = Candidate(4, round(since_s * S), round(until_s * S), observed, motion, frames=9)
    first = tuple(p - v * (until_s - since_s) for p, v in zip(place, moves, strict=True))
    one.path.append((one.since_ns, (first[0], first[1], first[2])))
    one.path.append((one.stamp_ns, place))
    return one


def told(*statements: Any, motion: Motion = MOTION) -> Any:
    said: Any = Statements(motion)
    for each in statements:
        said.tell(each)
    return said


# --- what is kept


def test_places_that_come_more_often_than_once_a_second_are_one() -> None:
    """But the newest counts, however soon it came."""
    for every_s, kept_s in (
        (0.5, [0.0, 1.0, 2.0, 2.5]),
        (0.25, [0.0, 1.0, 2.0, 2.5]),
        (1.0, [0.0, 1.0, 2.0]),
    ):
        stamps = np.arange(0.0, 2.6, every_s).tolist()
        said = told(*(PlaceTold(round(s * S), (s, 0.0, 0.0), 0.3) for s in stamps))
        assert [each.stamp_ns / S for each in said._places] == kept_s


def test_a_place_is_forgotten_after_fifteen_seconds() -> None:
    first = PlaceTold(0, (0.0, 0.0, 0.0), 0.3)
    for later_ns, kept in ((15 * S, 2), (15 * S + 1, 1)):
        assert len(told(first, PlaceTold(later_ns, (0.0, 0.0, 0.0), 0.3))._places) == kept


def test_the_newest_word_is_the_newest_of_any_kind() -> None:
    assert told().newest_ns is None
    bearing, region = BearingTold(3 * S, (0.0, 0.0), 0.0, 0.1), RegionTold(2 * S, SQUARE)
    assert told(bearing, region).newest_ns == 3 * S
    assert told(region, PlaceTold(S, (0.0, 0.0, 0.0), 0.3)).newest_ns == 2 * S
    assert told(PlaceTold(5 * S, (0.0, 0.0, 0.0), 0.3), bearing).newest_ns == 5 * S


def test_a_mission_says_how_its_target_may_move() -> None:
    target = TargetDesignation(height_m=0.8, fastest_mps=3.0, flies=True)
    mission = MissionConfig(
        target=target, guard=GuardConfig(fence_radius_m=20.0, fence_height_m=7.0)
    )
    assert Motion.of(mission) == Motion(3.0, mission.follow.target_accel_mps2, 40.0, -0.8, 7.0)
    assert Motion.of(MissionConfig()).flies_to_m is None


# --- where to look


@pytest.mark.parametrize(
    ("options", "at_s", "north_m", "sigma_m"),
    [
        ({}, 5.0, 1.0, 0.4),
        ({}, 6.0, 1.0, math.hypot(0.4, 1.0)),
        ({}, 4.0, 1.0, math.hypot(0.4, 1.0)),
        ({"holds_s": 3.0}, 8.0, 1.0, 0.4),
        ({"holds_s": 3.0}, 9.0, 1.0, math.hypot(0.4, 1.0)),
        ({"holds_s": 3.0}, 4.0, 1.0, math.hypot(0.4, 1.0)),
        ({"velocity_n_mps": (0.5, 0.0)}, 7.0, 2.0, math.hypot(0.4, 0.5 * 1.0)),
        ({"velocity_n_mps": (0.5, 0.0)}, 25.0, 11.0, math.hypot(0.4, 0.5 * 50.0)),
    ],
)
def test_a_place_widens_by_how_fast_such_a_thing_can_be_and_a_velocity_carries_it_on(
    options: dict[str, Any], at_s: float, north_m: float, sigma_m: float
) -> None:
    said = told(PlaceTold(5 * S, (1.0, -2.0, -0.7), 0.4, **options))
    place, reach_m = said.where(round(at_s * S))
    assert place == pytest.approx((north_m, -2.0, -0.7))
    assert reach_m == pytest.approx(3.0 * sigma_m)


def test_of_edges_their_middle_is_looked_at_and_of_a_bearing_nothing() -> None:
    place, reach_m = told(RegionTold(5 * S, SQUARE)).where(7 * S)
    assert place == (2.0, 1.0, -0.9)
    assert reach_m == pytest.approx(math.hypot(2.0, 1.0) + 4.0)
    assert told(BearingTold(5 * S, (0.0, 0.0), 0.3, 0.1)).where(5 * S) is None


# --- densities


def spread_over(side_m: float, cells: int = 400) -> tuple[np.ndarray, float]:
    """Points all over a square around zero, and what each stands for."""
    axis = (np.arange(cells) + 0.5) / cells * 2.0 * side_m - side_m
    north, east = np.meshgrid(axis, axis)
    return np.column_stack((north.ravel(), east.ravel())), (2.0 * side_m / cells) ** 2


@pytest.mark.parametrize(("gap_s", "within"), [(0.0, 0.01), (0.5, 0.01)])
def test_edges_are_one_object_spread_over_what_they_enclose_and_a_way_around_it(
    gap_s: float, within: float
) -> None:
    region = RegionTold(0, SQUARE)
    points, area_m2 = spread_over(12.0)
    density = told(region)._density(region, points, gap_s)
    assert float(density.sum()) * area_m2 == pytest.approx(1.0, abs=within)
    inside, beside = told(region)._density(region, np.array([[2.0, 1.0], [2.0, 3.0]]), gap_s)
    spread_m = 2.0 * gap_s
    expected = math.exp(-0.5 * (1.0 / spread_m * 2.0) ** 2) if spread_m else 0.0
    assert beside / inside == pytest.approx(expected)
    # a way along each side, and a quarter of a turn at each corner
    around_m2 = math.sqrt(math.pi / 8.0) * spread_m * 12.0 + 0.5 * math.pi * spread_m**2
    assert inside == pytest.approx(1.0 / (8.0 + around_m2))


def test_a_bearing_is_one_object_somewhere_along_it_as_far_as_its_site_goes() -> None:
    bearing = BearingTold(0, (0.0, 0.0), 2.0, 0.1)
    said = told(bearing)
    angle, range_m = 2.15, 7.0
    point = np.array([[range_m * math.cos(angle), range_m * math.sin(angle)]])
    by_hand = math.exp(-0.5 * 1.5**2) / (math.sqrt(2.0 * math.pi) * 0.1) / (range_m * 60.0)
    assert said._density(bearing, point, 0.0)[0] == pytest.approx(by_hand)
    sigma = math.hypot(0.1, 0.5 * 2.0 * 1.5 / range_m)
    wider = math.exp(-0.5 * (0.15 / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
    assert said._density(bearing, point, 1.5)[0] == pytest.approx(wider / (range_m * 60.0))


def test_a_bearing_has_no_seam_where_angles_begin_anew() -> None:
    bearing = BearingTold(0, (1.0, 2.0), math.pi - 0.05, 0.1)
    points = np.array([[-9.0, 2.0 - 0.5], [-9.0, 2.0 + 1.5]])
    there, mirrored = told(bearing)._density(bearing, points, 0.0)
    # both are a tenth off, about
    assert there == pytest.approx(mirrored, rel=0.02)
    assert there > 0.0


def test_how_far_outside_of_edges_a_place_is() -> None:
    corners = np.array(SQUARE)
    points = np.array([[2.0, 1.0], [3.5, 1.0], [5.0, 1.0], [7.0, 6.0], [2.0, -0.5], [-1.0, 0.0]])
    assert outside(corners, points) == pytest.approx((-1.0, -0.5, 1.0, 5.0, 0.5, 1.0))
    notch = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 1.0), (0.0, 4.0)])
    assert outside(notch, np.array([[2.0, 2.0], [2.0, 0.5]])) == pytest.approx(
        (2.0 / math.sqrt(13.0), -0.5)
    )
    assert file._area_m2(notch) == pytest.approx(10.0)
    assert file._area_m2(corners[::-1]) == pytest.approx(8.0)


def test_what_the_camera_shows_is_ahead_of_it_and_in_its_image() -> None:
    half_m = 0.5 * 6.0 / CAMERA.fx * CAMERA.width
    high_m = 0.5 * 6.0 / CAMERA.fy * CAMERA.height
    points = np.array(
        [
            [5.0, 1.0, 0.0],
            [5.0, 1.0 + 0.9 * half_m, 0.0],
            [5.0, 1.0 + 1.1 * half_m, 0.0],
            [5.0 + 0.9 * high_m, 1.0, 0.0],
            [5.0 + 1.1 * high_m, 1.0, 0.0],
            [5.0 - 1.1 * high_m, 1.0, 0.0],
            [5.0, 1.0, -12.0],
            [5.0, 1.0, -6.0],
        ]
    )
    expected = [True, True, False, True, False, False, False, False]
    assert file._seen_from(DOWN, points, CAMERA).tolist() == expected


# --- which


def test_of_two_the_nearer_to_what_was_said_is_likelier_by_the_ratio_of_their_densities() -> None:
    said = told(PlaceTold(10 * S, (5.0, 1.0, -0.9), 0.5))
    one, other = seen_at((5.0, 1.2, -0.9)), seen_at((5.0, 2.0, -0.9))
    other.number = 7
    shares = said.shares([one, other], [Look(10 * S, DOWN)], CAMERA)
    ratio = math.exp(-0.5 * (0.2 / 0.5) ** 2 + 0.5 * (1.0 / 0.5) ** 2)
    assert shares.of[4] / shares.of[7] == pytest.approx(ratio)
    assert sum(shares.of.values()) + shares.elsewhere == pytest.approx(1.0)


def test_one_that_is_alone_is_the_one_but_for_those_that_are_not_shown() -> None:
    """As many are hidden where nothing is looked at as there are where something is."""
    said = told(PlaceTold(10 * S, (5.0, 1.0, -0.9), 0.5))
    one = seen_at((5.0, 1.0, -0.9))
    shares = said.shares([one], [Look(10 * S, DOWN)], CAMERA)
    range_m = 6.0 - 0.9
    per_m2 = CAMERA.fx * CAMERA.fy / (CAMERA.width * CAMERA.height * range_m**2)
    density = 1.0 / (2.0 * math.pi * 0.25)
    hidden = 0.002 * per_m2
    assert shares.elsewhere == pytest.approx(hidden / (hidden + density), rel=0.01)
    elsewhere = said.shares([one], [Look(11 * S, AWAY)], CAMERA).elsewhere
    far_m = math.hypot(300.0, range_m)
    per_m2 = CAMERA.fx * CAMERA.fy / (CAMERA.width * CAMERA.height * far_m**2)
    assert elsewhere == pytest.approx(per_m2 / (per_m2 + density), rel=0.01)


def test_the_look_that_counts_is_the_one_of_the_statement_s_instant() -> None:
    said = told(PlaceTold(10 * S, (5.0, 1.0, -0.9), 0.5))
    looks = [Look(9 * S, AWAY), Look(10 * S, DOWN), Look(12 * S, AWAY)]
    one = seen_at((5.0, 1.0, -0.9))
    assert said.shares([one], looks, CAMERA).elsewhere < 0.01


def test_without_anything_seen_or_said_nothing_is_the_one() -> None:
    one = seen_at((5.0, 1.0, -0.9))
    look = [Look(10 * S, DOWN)]
    place = PlaceTold(10 * S, (5.0, 1.0, -0.9), 0.5)
    for said, seen, looks in (
        (told(), [one], look),
        (told(place), [], look),
        (told(place), [one], []),
    ):
        shares = said.shares(seen, looks, CAMERA)
        assert shares.elsewhere == 1.0 and set(shares.of.values()) <= {0.0}


def test_several_places_err_together_and_scatter_apart() -> None:
    """The mean residual counts once with the error of one, the scatter with each of them."""
    offs = ((2, 0.1), (4, 0.5), (6, 0.3))
    said = told(*(PlaceTold(s * S, (5.0, 1.0 + off, -0.9), 0.5) for s, off in offs))
    one = seen_at((5.0, 1.0, -0.9))
    square = ((0.2) ** 2 + 0.2**2) / 0.25
    assert said._scatter(one) == (pytest.approx(square / 2.0), 2)
    mean = -0.5 * (0.3 / 0.5) ** 2 - math.log(2.0 * math.pi * 0.25)
    assert said._log_place(one) == pytest.approx(mean)
    total = said._log_density(one, said._scatter(one), 0.0)
    assert total == pytest.approx(mean - 0.5 * square)
    # of one that was seen after the first two only the last tells
    late = seen_at((5.0, 1.0, -0.9), since_s=5.0)
    assert said._scatter(late) == (0.0, 0)
    single = -0.5 * (0.3 / 0.5) ** 2 - math.log(2.0 * math.pi * 0.25)
    assert said._log_place(late) == pytest.approx(single)
    assert said._log_density(late, (0.0, 0), 0.7) == pytest.approx(single - 0.5 * 0.7 * 2.0)


def test_a_drone_that_is_off_itself_tells_by_scatter_what_moves_from_what_stands() -> None:
    """It is off by the same in each place, and by little more from one to the next."""
    said = told(motion=replace(MOTION, own_m=2.0))
    for s in range(1, 10, 2):
        said.tell(PlaceTold(s * S, (6.5 + 0.2 * s, -0.5, -0.9), 0.3))
    goes = seen_at((7.0, 1.0, -0.9), moves=(0.2, 0.0, 0.0))
    stands = replace(seen_at((6.0, 0.5, -0.9)), number=5)
    shares = said.shares([goes, stands], [Look(10 * S, DOWN)], CAMERA)
    assert shares.of[4] > 100.0 * shares.of[5] > 0.0


def test_a_drone_that_is_off_itself_looks_that_much_farther_whatever_was_said() -> None:
    off = replace(MOTION, own_m=2.0)
    place = PlaceTold(5 * S, (1.0, -2.0, -0.7), 0.4)
    assert told(place, motion=off).where(5 * S)[1] == pytest.approx(3.0 * math.hypot(0.4, 2.0))
    region = RegionTold(5 * S, SQUARE)
    said = told(region, motion=off)
    assert said.where(5 * S)[1] == pytest.approx(math.hypot(2.0, 1.0) + 3.0 * 2.0)
    points, area_m2 = spread_over(20.0)
    density = said._density(region, points, 0.0)
    assert float(density.sum()) * area_m2 == pytest.approx(1.0, abs=0.02)
    bearing = BearingTold(0, (0.0, 0.0), 0.0, 0.1)
    beside = np.array([[10.0, 2.0]])
    there = told(bearing, motion=off)._density(bearing, beside, 0.0)[0]
    assert there > 2.0 * told(bearing)._density(bearing, beside, 0.0)[0]


def test_of_one_that_was_seen_only_later_it_counts_how_far_it_can_have_come() -> None:
    said = told(PlaceTold(2 * S, (5.0, 1.0, -0.9), 0.5))
    late = seen_at((5.0, 3.0, -0.9), since_s=4.0)
    sigma = math.hypot(0.5, 0.5 * 2.0 * 2.0)
    by_hand = -0.5 * (2.0 / sigma) ** 2 - math.log(2.0 * math.pi * sigma**2)
    assert said._log_place(late) == pytest.approx(by_hand)


def test_a_velocity_that_was_said_counts_against_any_that_such_a_thing_may_have() -> None:
    place = PlaceTold(9 * S, (5.0, 1.0, -0.9), 0.5, velocity_n_mps=(0.6, 0.8))
    said = told(place)
    one = seen_at((5.0, 1.0, -0.9), moves=(0.5, 0.5, 0.0))
    sigma = math.sqrt(0.25 * 1.0 + 0.5**2 + 0.04)
    off = math.hypot(0.1, 0.3)
    by_hand = -0.5 * (off / sigma) ** 2 - math.log(2.0 * math.pi * sigma**2)
    assert said._log_velocity(one, place) == pytest.approx(by_hand + math.log(math.pi * 4.0))
    # what is said to stand is not said to move
    stands = told(PlaceTold(9 * S, (5.0, 1.0, -0.9), 0.5, velocity_n_mps=(0.0, 0.0)))
    plain = told(PlaceTold(9 * S, (5.0, 1.0, -0.9), 0.5))
    assert stands._log_place(one) == plain._log_place(one)


def test_of_what_flies_a_height_that_was_said_counts_against_any_up_to_its_ceiling() -> None:
    motion = Motion(2.0, 0.5, 60.0, -0.9, flies_to_m=7.0)
    place = PlaceTold(10 * S, (5.0, 1.0, -2.0), 0.5, height_told=True)
    one = seen_at((5.0, 1.0, -1.4))
    level = told(PlaceTold(10 * S, (5.0, 1.0, -2.0), 0.5), motion=motion)._log_place(one)
    density = math.exp(-0.5 * (0.6 / 0.5) ** 2) / (math.sqrt(2.0 * math.pi) * 0.5)
    found = told(place, motion=motion)._log_place(one)
    assert found - level == pytest.approx(math.log(density * 7.0))
    assert told(place)._log_place(one) == pytest.approx(level)  # of what does not fly it is nothing
