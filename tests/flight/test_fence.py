"""The space in which drones may be: a circle, a ceiling, and the walls of a site."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as some

from drivers.rig.obstacle import Obstacle
from flight.fence import Fence
from flight.guidance import add, norm, scale

HALL = Fence(25.0, 3.0, ((-2.0, -2.0), (-2.0, 2.0), (2.0, 2.0), (2.0, -2.0)), body_m=0.3)
# an L: the corner that points inward is at the origin
ANGLE = Fence(
    50.0,
    6.0,
    ((-4.0, -4.0), (4.0, -4.0), (4.0, 0.0), (0.0, 0.0), (0.0, 4.0), (-4.0, 4.0)),
    body_m=0.3,
)
WALL = Obstacle((4.0, 0.0), (0.2, 6.0), 3.0)
POST = Obstacle((0.0, 3.0), (1.0, 1.0), 2.5, round=True)
CROWN = Obstacle((0.0, 3.0), (3.0, 3.0), 6.0, 4.5, round=True)
YARD = Fence(25.0, 8.0, body_m=0.8, obstacles=(WALL, POST, CROWN))
PLACES = some.tuples(some.floats(-6.0, 6.0), some.floats(-6.0, 6.0))


def test_without_edges_it_is_the_circle_and_its_ceiling() -> None:
    fence = Fence(10.0, 5.0)
    assert fence.holds((6.0, 8.0, -5.0))
    assert not fence.holds((6.1, 8.0, -1.0))
    assert not fence.holds((0.0, 0.0, -5.1))
    assert not fence.holds((math.nan, 0.0, 0.0))
    assert fence.stoppable((9.0, 9.0, 0.0), (9.9, 0.0, 0.0), 1.0, 1.0) == (9.0, 9.0, 0.0)


def test_a_place_behind_a_wall_is_outside_and_room_is_the_way_to_the_nearest_edge() -> None:
    assert HALL.holds((1.9, 0.0, -1.0))
    assert not HALL.holds((2.1, 0.0, -1.0))
    assert HALL.room_m(1.5, 0.0) == pytest.approx(0.5)
    assert HALL.room_m(2.5, 0.0) == pytest.approx(-0.5)
    assert ANGLE.room_m(1.0, 1.0) == pytest.approx(-1.0)
    assert ANGLE.room_m(-1.0, -1.0) == pytest.approx(math.sqrt(2.0))


@pytest.mark.parametrize("fence", [HALL, ANGLE])
@given(place=PLACES)
def test_the_nearest_place_has_room_for_a_body(fence: Fence, place: tuple[float, float]) -> None:
    north, east, _ = fence.nearest((*place, -1.0))
    assert fence.room_m(north, east) >= fence.body_m - 1e-6


@given(place=some.tuples(some.floats(-1.7, 1.7), some.floats(-1.7, 1.7)))
def test_a_place_with_room_stays_as_it_is(place: tuple[float, float]) -> None:
    assert HALL.nearest((*place, -1.0)) == (*place, -1.0)


@pytest.mark.parametrize("fence", [HALL, ANGLE])
@given(
    place=some.tuples(some.floats(-1.5, -0.5), some.floats(-1.5, -0.5)),
    direction=some.floats(0.0, 6.28),
    speed=some.floats(0.1, 3.0),
)
def test_a_drone_that_answers_late_stops_before_the_wall(
    fence: Fence, place: tuple[float, float], direction: float, speed: float
) -> None:
    """A drone follows its setpoint with a lag of a second; its setpoint changes as fast as it
    may.
    """
    north, east = place
    velocity = [0.0, 0.0]
    setpoint = (0.0, 0.0, 0.0)
    wanted = speed * math.cos(direction), speed * math.sin(direction), 0.0
    accel_mps2, response_s, step_s = 0.8, 1.0, 0.05
    for _ in range(300):
        change = [wanted[k] - setpoint[k] for k in (0, 1)]
        share = min(1.0, accel_mps2 * step_s / max(math.hypot(*change), 1e-9))
        slewed = setpoint[0] + share * change[0], setpoint[1] + share * change[1], 0.0
        setpoint = fence.stoppable(slewed, (north, east, -1.0), 0.5 * accel_mps2, response_s)
        for k in (0, 1):
            velocity[k] += (setpoint[k] - velocity[k]) * step_s / response_s
        north += velocity[0] * step_s
        east += velocity[1] * step_s
        assert fence.room_m(north, east) > 0.0


def test_a_ceiling_is_a_wall_like_any_other() -> None:
    """Of a site that has edges; a fence's own height is no body."""
    assert HALL.nearest((0.0, 0.0, -5.0)) == (0.0, 0.0, pytest.approx(-2.7))
    assert HALL.nearest((0.0, 0.0, -5.0), 0.5) == (0.0, 0.0, pytest.approx(-2.2))
    assert Fence(25.0, 3.0, body_m=0.3).nearest((0.0, 0.0, -5.0)) == (0.0, 0.0, -3.0)
    down = -1.0
    climb_mps = 0.0
    setpoint_mps = 0.0
    for _ in range(300):
        slewed_mps = min(1.5, setpoint_mps + 0.8 * 0.05)
        setpoint = HALL.stoppable((0.0, 0.0, -slewed_mps), (0.0, 0.0, down), 0.4, 1.0)
        setpoint_mps = -setpoint[2]
        climb_mps += (setpoint_mps - climb_mps) * 0.05
        down -= climb_mps * 0.05
    assert 2.5 < -down < 3.0
    # over it already: down is the only way
    assert HALL.stoppable((0.0, 0.0, -1.0), (0.0, 0.0, -3.5), 0.4, 1.0) == (0.0, 0.0, 0.0)
    assert HALL.stoppable((0.0, 0.0, 1.0), (0.0, 0.0, -3.5), 0.4, 1.0) == (0.0, 0.0, 1.0)


def test_what_leads_away_from_a_wall_or_along_it_is_not_slowed() -> None:
    at_wall = (1.68, 0.0, -1.0)
    assert HALL.stoppable((-1.0, 0.0, 0.2), at_wall, 0.4, 1.0) == (-1.0, 0.0, 0.2)
    assert HALL.stoppable((0.0, 0.5, 0.1), at_wall, 0.4, 1.0) == (0.0, 0.5, 0.1)


def test_a_drone_at_a_wall_is_not_led_nearer() -> None:
    north, east, _ = HALL.stoppable((0.5, 0.3, 0.0), (1.7, 0.0, -1.0), 0.4, 1.0)
    assert north == pytest.approx(0.0, abs=1e-9)
    assert east == pytest.approx(0.3)


# --- obstacles


@given(place=some.tuples(PLACES, some.floats(0.5, 4.0)))
def test_the_nearest_place_is_clear_of_obstacles(
    place: tuple[tuple[float, float], float],
) -> None:
    (north, east), height = place
    found = YARD.nearest((north, east, -height))
    assert min(each.distance_m(found) for each in YARD.obstacles) >= YARD.body_m - 1e-6
    assert found[2] == -height


def test_a_place_to_land_at_is_not_above_or_below_an_obstacle() -> None:
    above = (0.0, 3.2, -3.6)
    assert YARD.nearest(above) == above
    north, east, _ = YARD.nearest(above, lowest_m=0.0)
    assert math.dist((north, east), POST.place_m) >= 0.5 + YARD.body_m - 1e-6


@given(
    place=PLACES,
    direction=some.floats(0.0, 6.28),
    sinks=some.floats(-1.0, 1.0),
    height=some.floats(1.0, 4.0),
)
def test_a_drone_that_answers_late_stops_before_an_obstacle(
    place: tuple[float, float], direction: float, sinks: float, height: float
) -> None:
    position = YARD.nearest((*place, -height))
    velocity = setpoint = (0.0, 0.0, 0.0)
    wanted = 2.0 * math.cos(direction), 2.0 * math.sin(direction), sinks
    for _ in range(200):
        change = add(wanted, scale(setpoint, -1.0))
        change = scale(change, min(1.0, 0.8 * 0.05 / max(norm(change), 1e-9)))
        setpoint = YARD.stoppable(add(setpoint, change), position, 0.4, 1.0)
        velocity = add(velocity, scale(add(setpoint, scale(velocity, -1.0)), 0.05))
        position = add(position, scale(velocity, 0.05))
        assert min(each.distance_m(position) for each in YARD.obstacles) >= 0.5 * YARD.body_m


def test_a_way_leads_round_an_obstacle_and_is_as_long_as_that_takes() -> None:
    left = YARD.towards((8.0, 0.0, -2.0), (0.0, 0.0, -1.0))
    assert norm(left) > 10.0
    assert abs(left[1]) > 0.5 * left[0]
    assert left[2] == -1.0
    over = YARD.towards((8.0, 0.0, -5.0), (0.0, 0.0, -5.0))
    assert over == (8.0, 0.0, 0.0)
    assert Fence(25.0, 8.0, body_m=0.8).towards((8.0, 0.1, -2.0), (0.3, 0.2, 0.1)) == (
        8.0 - 0.3,
        0.1 - 0.2,
        -2.0 - 0.1,
    )


def test_obstacles_are_where_a_drone_whose_position_is_off_takes_them_to_be() -> None:
    moved = YARD.shifted(0.5, -1.0)
    assert moved.obstacles[0].place_m == (4.5, -1.0)
    assert moved.corners_m == YARD.corners_m
