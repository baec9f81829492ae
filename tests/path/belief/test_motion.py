"""Place and velocity of one object, on paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.belief.motion import MANOEUVRE_S, Motion, density, renewal

EYE = np.eye(3)


def test_what_nobody_saw_for_a_while_may_have_sped_up_all_the_time() -> None:
    motion = Motion.at(np.zeros(3), 0.01**2 * EYE, 0.6, 0)
    motion.covariance[3:, 3:] = 0.0
    motion.advance(2_000_000_000, 0.6)
    expected = 0.01**2 + 0.6**2 * MANOEUVRE_S * 2.0**3 / 3.0
    assert motion.place_covariance_m2[0, 0] == pytest.approx(expected)


def test_a_steady_object_is_known_better_than_one_box_of_it() -> None:
    motion = Motion.at(np.zeros(3), 0.02**2 * EYE, 0.6, 0)
    rng = np.random.default_rng(4)
    for k in range(1, 101):
        motion.advance(k * 20_000_000, 0.6)
        motion.update(
            np.array([0.3 * k * 0.02, 0.0, 0.0]) + 0.02 * rng.standard_normal(3), 0.02**2 * EYE
        )
    assert math.sqrt(motion.place_covariance_m2[0, 0]) < 0.012
    assert np.linalg.norm(motion.place_m - (0.6, 0.0, 0.0)) < 0.04
    assert np.linalg.norm(motion.mean[3:] - (0.3, 0.0, 0.0)) < 0.3


def test_a_box_that_is_far_off_moves_a_track_less_than_its_distance_asks() -> None:
    near = Motion.at(np.zeros(3), 0.02**2 * EYE, 0.6, 0)
    far = Motion.at(np.zeros(3), 0.02**2 * EYE, 0.6, 0)
    near.update(np.array([0.02, 0.0, 0.0]), 0.02**2 * EYE)
    far.update(np.array([0.4, 0.0, 0.0]), 0.02**2 * EYE)
    assert far.place_m[0] / 0.4 < 0.2 * near.place_m[0] / 0.02


def test_densities_add_up_to_one() -> None:
    step = 0.02
    axis = np.arange(-2.0, 2.0, step)
    total = 0.0
    for x in axis[::4]:
        for y in axis[::4]:
            for z in axis[::4]:
                total += (
                    density(np.array([x, y, z]), 0.1**2 * EYE, 0.05**2 * EYE) * (4.0 * step) ** 3
                )
    assert total == pytest.approx(1.0, abs=0.01)


def test_a_box_makes_new_what_was_not_known_and_nothing_else() -> None:
    noise, along = 0.02**2 * EYE, np.array([1.0, 0.0, 0.0])
    assert renewal(1e-8 * EYE, noise, along) < 1e-3
    assert renewal(EYE, noise, along) > 0.999
    assert renewal(0.02**2 * EYE, noise, along) == pytest.approx(0.5)
    # what is known across, and not along, is new along alone
    lengthways = np.diag([1.0, 1e-8, 1e-8])
    assert renewal(lengthways, noise, along) > 0.999
    assert renewal(lengthways, noise, np.array([0.0, 1.0, 0.0])) < 1e-3
