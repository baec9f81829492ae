"""People walk: feet that stand stay where they are, limbs hang together, nothing leaves the boxes
of the geometry.
"""

from __future__ import annotations

import numpy as np
import pytest

from hil.render.bodies.kinds import BOXES, WALKING_MPS, model_of_thing
from hil.render.bodies.people import person
from hil.render.bodies.walking import (
    ARM,
    SHIN,
    SHOE,
    SIGNS,
    THIGH,
    boxes_of_a_walker,
    walker,
    walking,
)
from hil.world.gait import STANCE, step_m, strides_of
from hil.world.snapshot import ObjectTruth
from tests.hil.render.test_scene import Array, vertices

SPEEDS = (0.1, WALKING_MPS, 0.7, 1.4, 3.0)


def shoe(variant: int, strides: float, speed_mps: float, side: int) -> Array:
    limbs = walker(variant).limbs == SHOE + side
    return vertices(walking(variant, strides, speed_mps)).reshape(4, -1, 3)[:, limbs].reshape(-1, 3)


def test_one_who_stands_has_the_feet_side_by_side_and_the_arms_down() -> None:
    model, limbs = walking(2, 0.37, 0.0), walker(2).limbs
    points = vertices(model).reshape(4, -1, 3)
    for pair in (THIGH, SHIN, SHOE, ARM):
        left, right = (points[:, limbs == pair + side] for side in range(2))
        assert left[..., 0].mean() == pytest.approx(right[..., 0].mean(), abs=1e-6)
    assert np.ptp(points[..., 2]) == pytest.approx(np.ptp(vertices(person(2))[:, 2]), abs=0.01)


@pytest.mark.parametrize("speed_mps", SPEEDS)
def test_a_foot_on_the_ground_stays_where_it_is_while_the_body_passes(speed_mps: float) -> None:
    way = np.linspace(0.0, 0.99 * STANCE * 2.0 * step_m(speed_mps), 12)
    places = [shoe(1, strides_of(w, speed_mps), speed_mps, 0)[:, 0].mean() + w for w in way]
    assert np.ptp(places) < 1e-9


@pytest.mark.parametrize("speed_mps", SPEEDS)
def test_no_foot_is_in_the_ground_and_one_is_always_on_it(speed_mps: float) -> None:
    for strides in np.linspace(0.0, 1.0, 41):
        low = [float(shoe(3, strides, speed_mps, side)[:, 2].min()) for side in range(2)]
        assert 0.0 < min(low) < 0.005
        assert max(low) < 0.15


def test_arms_swing_against_the_legs() -> None:
    points, limbs = vertices(walking(0, 0.0, 1.3)).reshape(4, -1, 3), walker(0).limbs
    ahead = {limb: points[:, limbs == limb, 0].mean() for limb in range(1, 9)}
    assert ahead[SHOE] > 0.3 > -0.2 > ahead[SHOE + 1]
    assert ahead[ARM] < -0.08 < 0.08 < ahead[ARM + 1]


@pytest.mark.parametrize("speed_mps", SPEEDS)
def test_shins_hang_on_thighs(speed_mps: float) -> None:
    for strides in np.linspace(0.0, 1.0, 17):
        points, limbs = vertices(walking(4, strides, speed_mps)).reshape(4, -1, 3), walker(4).limbs
        for side in range(2):
            # the last face of each is its cap at the knee
            thigh, shin = (
                points[:, np.flatnonzero(limbs == limb + side)[-1]].mean(axis=0)
                for limb in (THIGH, SHIN)
            )
            assert np.linalg.norm(thigh - shin) < 0.005


def test_the_boxes_of_the_geometry_hold_all_of_a_walk() -> None:
    ends = np.array(
        [np.add(c, np.multiply(half, s)) for c, s, _ in BOXES["person"] for half in (-0.5, 0.5)]
    )
    low, high = ends.min(axis=0), ends.max(axis=0)
    widest = np.zeros(3)
    for strides in np.linspace(0.0, 1.0, 33):
        for variant in range(8):
            build = walker(variant).build
            points = vertices(walking(variant, strides, WALKING_MPS)) / build
            assert np.all(points >= low - 0.02)
            assert np.all(points <= high + 0.02)
            widest = np.maximum(widest, np.ptp(points, axis=0))
    assert widest == pytest.approx(high - low, rel=0.1)  # and hardly more


@pytest.mark.parametrize("speed_mps", SPEEDS)
def test_the_boxes_of_one_moment_are_around_the_drawn_limbs(speed_mps: float) -> None:
    for strides in np.linspace(0.0, 1.0, 9):
        rows = boxes_of_a_walker(strides, speed_mps)
        corners = [row[:3] + (row[3:6] * SIGNS) @ row[6:].reshape(3, 3).T for row in rows]
        whole = np.concatenate(corners)
        points = vertices(walking(5, strides, speed_mps)) / walker(5).build
        # a tall person's step is no longer
        assert np.abs(whole.min(axis=0) - points.min(axis=0)).max() < 0.03
        assert np.abs(whole.max(axis=0) - points.max(axis=0)).max() < 0.03
        assert len(rows) == len(BOXES["person"])


def test_the_same_moment_is_the_same_posture_and_nobody_walks_in_step() -> None:
    # of one variant
    one, other = (ObjectTruth(number, (0.0, 0.0, 0.0), 0.0, 0.3, strides=4.2) for number in (1, 9))
    assert np.array_equal(
        model_of_thing("person", one).corners, model_of_thing("person", one).corners
    )
    assert (
        np.abs(
            model_of_thing("person", one).corners - model_of_thing("person", other).corners
        ).max()
        > 0.05
    )
