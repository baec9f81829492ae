"""Place and velocity of one object, on paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.belief.motion import (
    FLYING,
    MANOEUVRE_S,
    ON_GROUND,
    Array,
    Motion,
    along_ray,
    density,
    mahalanobis2,
    renewal,
)

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


def known_well_and_badly() -> Motion:
    """A motion whose places and velocities are known together, each axis differently."""
    rng = np.random.default_rng(8)
    parts = rng.normal(0.0, 0.05, (6, 6))
    return Motion(rng.normal(0.0, 1.0, 6), parts @ parts.T, 3_000_000_000)


def test_a_prediction_carries_all_that_is_known_on_and_adds_what_an_acceleration_may_have_done() -> (
    None
):
    motion = known_well_and_badly()
    mean, P = motion.mean.copy(), motion.covariance.copy()
    t, accel = 0.7, 0.9
    F = np.eye(6)
    F[:3, 3:] = t * EYE
    density_ = accel**2 * 0.5
    Q = density_ * np.block([[t**3 / 3.0 * EYE, t**2 / 2.0 * EYE], [t**2 / 2.0 * EYE, t * EYE]])
    motion.advance(3_700_000_000, accel)
    np.testing.assert_allclose(motion.mean, F @ mean, rtol=1e-9)
    np.testing.assert_allclose(motion.covariance, F @ P @ F.T + Q, rtol=1e-9)
    assert motion.stamp_ns == 3_700_000_000


def test_what_does_not_fly_climbs_by_a_tenth_of_its_way_at_most() -> None:
    known = 1e-12 * EYE
    flying = Motion.at(np.zeros(3), known, 0.6 * FLYING, 0)
    walking = Motion.at(np.zeros(3), known, 0.6 * ON_GROUND, 0)
    flying.advance(2_000_000_000, 0.6 * FLYING)
    walking.advance(2_000_000_000, 0.6 * ON_GROUND)
    shares = np.sqrt(np.diag(walking.covariance) / np.diag(flying.covariance))
    np.testing.assert_allclose(shares, (1.0, 1.0, 0.1) * 2, rtol=1e-6)


@pytest.mark.parametrize("stamp_ns", [2_999_999_999, 3_000_000_000])
def test_nothing_is_predicted_into_the_past(stamp_ns: int) -> None:
    motion, before = known_well_and_badly(), known_well_and_badly()
    motion.advance(stamp_ns, 0.9)
    assert motion.stamp_ns == 3_000_000_000
    np.testing.assert_array_equal(motion.mean, before.mean)
    np.testing.assert_array_equal(motion.covariance, before.covariance)


def gaussian(off: Array, covariance: Array) -> float:
    d2 = float(off @ np.linalg.inv(covariance) @ off)
    return math.exp(-0.5 * d2) / math.sqrt((2.0 * math.pi) ** 3 * np.linalg.det(covariance))


@pytest.mark.parametrize("off_m", [0.01, 0.15, 0.4])
def test_a_measured_place_is_fused_as_odd_as_it_is_likely_to_be(off_m: float) -> None:
    """One box in twenty errs five times as much."""
    motion = known_well_and_badly()
    mean, P = motion.mean.copy(), motion.covariance.copy()
    noise = np.diag([0.02, 0.03, 0.04]) ** 2
    off = np.array([off_m, -0.5 * off_m, 0.3 * off_m])
    usual = 0.95 * gaussian(off, P[:3, :3] + noise)
    odd = 0.05 * gaussian(off, P[:3, :3] + 25.0 * noise)
    share = odd / (usual + odd)
    assumed = noise / (1.0 - share + share / 25.0)
    gain = P[:, :3] @ np.linalg.inv(P[:3, :3] + assumed)
    motion.update(mean[:3] + off, noise)
    np.testing.assert_allclose(motion.mean, mean + gain @ off, rtol=1e-7)
    np.testing.assert_allclose(motion.covariance, P - gain @ P[:3, :], rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(motion.covariance, motion.covariance.T)


def test_a_place_that_is_beyond_all_likelihood_is_an_odd_one() -> None:
    motion = Motion.at(np.zeros(3), 0.02**2 * EYE, 0.6, 0)
    motion.update(np.array([1000.0, 0.0, 0.0]), 0.02**2 * EYE)
    assert motion.place_m[0] == pytest.approx(1000.0 / 26.0)


def test_an_object_may_be_as_fast_at_first_as_it_gets_within_a_second() -> None:
    motion = Motion.at(np.array([1.0, 2.0, 3.0]), np.diag([0.1, 0.2, 0.3]), 0.6, 7)
    np.testing.assert_array_equal(motion.mean, (1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(np.diag(motion.covariance), (0.1, 0.2, 0.3, 0.36, 0.36, 0.36))
    np.testing.assert_array_equal(motion.place_covariance_m2, np.diag([0.1, 0.2, 0.3]))
    assert motion.stamp_ns == 7


def test_densities_are_those_of_a_normal_distribution_and_of_one_with_tails() -> None:
    off = np.array([0.1, -0.2, 0.3])
    parts = np.random.default_rng(3).normal(0.0, 0.5, (2, 3, 3))
    known, noise = parts @ parts.transpose(0, 2, 1)
    d2, determinant = mahalanobis2(off, known, noise)
    assert d2 == pytest.approx(off @ np.linalg.inv(known + noise) @ off)
    assert determinant == pytest.approx(np.linalg.det(known + noise))
    expected = 0.95 * gaussian(off, known + noise) + 0.05 * gaussian(off, known + 25.0 * noise)
    assert density(off, known, noise) == pytest.approx(expected)


def test_a_ray_of_any_length_widens_what_is_the_same_in_every_direction() -> None:
    ray = np.array([0.3, -0.5, 1.0])
    expected = 0.2 * np.eye(3) + 0.7 * np.outer(ray, ray)
    np.testing.assert_allclose(along_ray(ray, 0.2, 0.7), expected)


def test_a_direction_of_no_length_is_none_and_the_length_of_others_is_nothing() -> None:
    parts = np.random.default_rng(4).normal(0.0, 0.5, (2, 3, 3))
    known, noise = parts @ parts.transpose(0, 2, 1)
    assert renewal(known, noise, np.zeros(3)) == 0.0
    along = np.array([1.0, -2.0, 0.5])
    gain = known @ np.linalg.inv(known + noise)
    expected = along @ gain @ along / (along @ along)
    assert renewal(known, noise, along) == pytest.approx(expected)
    assert renewal(known, noise, 0.1 * along) == pytest.approx(expected)
