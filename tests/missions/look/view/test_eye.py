"""The eye of the scene is where both drones are seen, however large the fence."""

from __future__ import annotations

import math

import numpy as np
import pytest

from missions.look.view.eye import eye_of
from path.messages import Vec3


def test_without_a_drone_there_is_no_eye() -> None:
    assert eye_of([]) is None
    assert eye_of([[], []]) is None


@pytest.mark.parametrize("east_m", [0.0, 500.0])
def test_drones_and_what_is_beside_them_fill_the_view(east_m: float) -> None:
    """Rerun's eye opens 55 degrees up and down and more to the sides, over less than ten metres
    here; from above.
    """
    first: list[Vec3] = [(east_m + 0.1 * k, 0.0, 1.5) for k in range(20)]
    second: list[Vec3] = [(east_m + 0.1 * k - 1.0, 0.6, 2.3) for k in range(20)]
    eye = eye_of([first, second])
    assert eye is not None
    ahead = np.subtract(eye.target, eye.position)
    away_m = float(np.linalg.norm(ahead))
    assert eye.position[2] > max(place[2] for place in second)
    for place in (*first, *second):
        to = np.subtract(place, eye.position)
        off_rad = math.acos(float(to @ ahead) / away_m / float(np.linalg.norm(to)))
        assert off_rad < math.radians(40.0)
    assert 2.0 * math.tan(math.radians(27.5)) * away_m < 10.0


def test_the_way_home_does_not_move_it_far() -> None:
    near: list[Vec3] = [(0.0, 0.0, 1.5)] * 90
    home: list[Vec3] = [(-30.0, 5.0, 0.0)] * 10
    eye, without = eye_of([near, home]), eye_of([near])
    assert eye is not None and without is not None
    assert math.dist(eye.position, without.position) < 1.0
