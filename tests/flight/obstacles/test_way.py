"""Ways around what stands there."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from drivers.rig.obstacle import Obstacle
from flight.obstacles.shapes import (
    between,
    crossed,
    hidden,
    level_m,
    pushed_off,
    rows_of,
    to_nearest,
    walls_of,
)
from flight.obstacles.way import first_leg
from path.arrays import Array

CLEAR_M = 1.0
WALL = Obstacle((5.0, 0.0), (0.2, 6.0), 3.0)
POST = Obstacle((5.0, 0.0), (1.0, 1.0), 3.0, round=True)


def whole_way(rows: Array, here: tuple[float, float], there: tuple[float, float]) -> list[Array]:
    """Fly leg after leg."""
    places = [np.array(here)]
    for _ in range(20):
        turn, _ = first_leg(rows, (places[-1][0], places[-1][1]), there, CLEAR_M)
        places.append(np.array(turn))
        if turn == there:
            return places
    raise AssertionError("it does not come there")


def nearest_m(rows: Array, places: list[Array]) -> float:
    """Return how near a way comes to anything."""
    shares = np.linspace(0.0, 1.0, 200)[:, None]
    legs = [a + shares * (b - a) for a, b in itertools.pairwise(places)]
    return min(
        float(np.hypot(*to_nearest(rows, (float(n), float(e), -1.0)).T[:2]).min())
        for leg in legs
        for n, e in leg
    )


def test_a_free_way_is_straight() -> None:
    assert first_leg(rows_of((POST,)), (0.0, 3.0), (10.0, 3.0), CLEAR_M) == ((10.0, 3.0), 10.0)


@pytest.mark.parametrize("obstacle", [WALL, POST], ids=["wall", "post"])
@pytest.mark.parametrize("east", [-0.4, 0.0, 0.4])
def test_a_way_leads_round_what_is_between_and_stays_clear_of_it(
    obstacle: Obstacle, east: float
) -> None:
    rows = rows_of((obstacle,))
    places = whole_way(rows, (0.0, east), (10.0, east))
    assert nearest_m(rows, places) >= CLEAR_M - 1e-6
    _, way_m = first_leg(rows, (0.0, east), (10.0, east), CLEAR_M)
    flown_m = sum(math.dist(a, b) for a, b in itertools.pairwise(places))
    assert way_m == pytest.approx(flown_m)
    assert way_m < (13.5 if obstacle is WALL else 10.8)


def test_random_worlds_are_crossed_clear_of_everything() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        obstacles = tuple(
            Obstacle((float(n), float(e)), (1.0, 1.0), 3.0, round=True)
            if k % 2
            else Obstacle((float(n), float(e)), (3.0, 0.4), 3.0, heading_deg=40.0 * k)
            for k, (n, e) in enumerate(rng.uniform((3.0, -8.0), (17.0, 8.0), (7, 2)))
        )
        rows = rows_of(obstacles)
        ends = (0.0, 0.0), (20.0, 0.0)
        clear_m = np.minimum(level_m(rows, np.array(ends)).min(axis=0), CLEAR_M).min()
        places = whole_way(rows, *ends)
        assert nearest_m(rows, places) >= min(clear_m, CLEAR_M) - 1e-5


def test_one_that_is_too_near_already_leaves_without_coming_nearer() -> None:
    rows = rows_of((WALL,))
    places = whole_way(rows, (4.5, 0.0), (10.0, 0.0))
    assert nearest_m(rows, places) >= 0.4 - 1e-5


def test_where_there_is_no_way_it_leads_to_the_nearest_place_there_is() -> None:
    ring = tuple(
        Obstacle((10.0 + 3.0 * math.cos(a), 3.0 * math.sin(a)), (2.0, 2.0), 3.0, round=True)
        for a in np.linspace(0.0, math.tau, 12, endpoint=False).tolist()
    )
    turn, way_m = first_leg(rows_of(ring), (0.0, 0.0), (10.0, 0.0), CLEAR_M)
    assert turn != (10.0, 0.0)
    assert way_m < 10.0


def test_the_walls_of_a_site_are_not_crossed() -> None:
    """An L: from one leg to the other round its inner corner."""
    corners = (0.0, 0.0), (12.0, 0.0), (12.0, 4.0), (4.0, 4.0), (4.0, 12.0), (0.0, 12.0)
    post = Obstacle((2.0, 2.0), (0.4, 0.4), 3.0, round=True)
    walls = walls_of(corners)
    assert len(walls) == 6
    assert crossed(walls, np.full(6, 0.1), np.array([[11.0, 3.0]]), np.array([[3.0, 11.0]]))[0]
    assert not crossed(walls, np.full(6, 0.1), np.array([[11.0, 2.0]]), np.array([[2.0, 2.0]]))[0]
    turn, _ = first_leg(rows_of((post,)), (11.0, 2.0), (2.0, 11.0), CLEAR_M, walls)
    assert turn[0] < 4.0
    assert turn[1] < 4.0


def test_only_what_reaches_the_heights_that_are_flown_is_in_the_way() -> None:
    crown = Obstacle((0.0, 0.0), (2.0, 2.0), 6.0, 4.0, round=True)
    rows = rows_of((WALL, crown))
    assert len(between(rows, 1.0, 2.0, CLEAR_M)) == 1
    assert len(between(rows, 2.0, 3.5, CLEAR_M)) == 2
    assert len(between(rows, 4.5, 5.0, CLEAR_M)) == 1
    assert len(between(rows, 8.0, 9.0, CLEAR_M)) == 0


def test_a_place_is_pushed_off_each_shape_square_to_its_nearest_side() -> None:
    rows = rows_of((WALL, POST))
    off = pushed_off(rows, np.array([[4.95, 0.5]]), CLEAR_M)
    assert off[0].tolist() == pytest.approx([3.9, 0.5])
    assert math.hypot(off[1][0] - 5.0, off[1][1]) == pytest.approx(1.5)


def test_what_is_behind_a_shape_is_hidden_and_what_is_above_it_is_not() -> None:
    rows = rows_of((WALL,))
    things = np.array([[10.0, 0.0, -0.1], [10.0, 8.0, -0.1], [10.0, 0.0, -9.0]])
    assert hidden(rows, (0.0, 0.0, -1.5), things).tolist() == [True, False, False]
