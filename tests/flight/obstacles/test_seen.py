"""What a drone's own depth camera sees standing about."""

from __future__ import annotations

import numpy as np
import pytest

from flight.obstacles.seen import SeenObstacles
from path.arrays import Array

CELL_M = 0.25


def looked_at(north_m: float, east_m: float, height_m: float) -> Array:
    """Return points of a look at flat ground on which one thing stands."""
    rng = np.random.default_rng(3)
    ground = np.column_stack((rng.uniform(0.0, 8.0, (400, 2)), np.zeros(400)))
    on_it = np.hypot(ground[:, 0] - north_m, ground[:, 1] - east_m) < 0.3
    ground[on_it, 2] = -height_m
    return ground


def stands(seen: SeenObstacles, north_m: float, east_m: float) -> bool:
    found = seen.obstacles((0.0, 0.0))
    return any(each.distance_m((north_m, east_m, -2.0)) < 0.5 * CELL_M for each in found)


def test_what_is_seen_twice_above_the_ground_stands_in_the_way_up_to_any_height() -> None:
    seen = SeenObstacles(CELL_M, 0.4)
    seen.note(looked_at(4.0, 3.0, 1.2)[::2])
    seen.note(looked_at(4.0, 3.0, 1.2))
    assert stands(seen, 4.0, 3.0)
    assert not stands(seen, 2.0, 3.0)
    assert all(each.top_m > 100.0 for each in seen.obstacles((0.0, 0.0)))


@pytest.mark.parametrize(
    ("height_m", "others"), [(0.16, ()), (1.2, ((4.0, 3.0, 0.6),))], ids=["low", "it moves"]
)
def test_what_is_low_or_known_to_move_is_none(
    height_m: float, others: tuple[tuple[float, float, float], ...]
) -> None:
    seen = SeenObstacles(CELL_M, 0.4)
    for _ in range(4):
        seen.note(looked_at(4.0, 3.0, height_m), others)
    assert seen.obstacles((0.0, 0.0)) == ()


def test_ground_that_is_seen_where_something_stood_frees_its_cell() -> None:
    seen = SeenObstacles(CELL_M, 0.4)
    for _ in range(3):
        seen.note(looked_at(4.0, 3.0, 1.2))
    for _ in range(12):
        seen.note(looked_at(20.0, 20.0, 1.2))
    assert not stands(seen, 4.0, 3.0)


def test_a_cell_that_is_come_to_from_elsewhere_is_begun_anew() -> None:
    seen = SeenObstacles(CELL_M, 0.4)
    for _ in range(3):
        seen.note(looked_at(4.0, 3.0, 1.2))
    away = np.array([96 * CELL_M, 0.0, 0.0])
    seen.note(looked_at(20.0, 20.0, 1.2) + away)
    assert not stands(seen, 4.0, 3.0)
    assert not stands(seen, 4.0 + 96 * CELL_M, 3.0)


def test_cells_are_told_as_few_boxes() -> None:
    seen = SeenObstacles(CELL_M, 0.4)
    ground = np.column_stack((np.random.default_rng(1).uniform(0.0, 3.0, (300, 2)), np.zeros(300)))
    wall = np.array([(2.0 + 0.1 * k, 3.3, -1.0) for k in range(30)])
    for _ in range(3):
        seen.note(np.concatenate((ground, wall)))
    (box,) = seen.obstacles((0.0, 0.0))
    assert box.size_m == (3.0, CELL_M)
