"""The filter between marker measurements: what it learns, what it refuses, and whether its sigma holds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from path.messages import Vec3
from path.relative import RelativeFilter

FRAME_NS = 20_000_000
SECOND_NS = 1_000_000_000
NOISE_M = 0.006
SPREAD: Vec3 = (NOISE_M**2, NOISE_M**2, NOISE_M**2)


def test_a_steady_error_of_the_reported_velocity_is_learnt():
    rng = np.random.default_rng(0)
    filtered = RelativeFilter()
    true_mps, reported_mps = np.array([0.3, -0.2, 0.1]), (0.42, -0.1, 0.02)
    filtered.set_velocity(reported_mps)
    position = np.array([1.0, 0.5, -0.6])
    for k in range(150):
        x, y, z = (position + true_mps * k * 0.02 + rng.normal(0.0, NOISE_M, 3)).tolist()
        assert filtered.update(k * FRAME_NS, (x, y, z), SPREAD)
    ahead = filtered.predict(149 * FRAME_NS + SECOND_NS)
    assert ahead is not None
    error_m = np.linalg.norm(np.array(ahead.marker_n_m) - (position + true_mps * (149 * 0.02 + 1.0)))
    assert error_m < 0.06  # the report alone is 0.17 m off after a second
    assert ahead.velocity_n_mps == pytest.approx(true_mps, abs=0.05)


@pytest.mark.parametrize("coast_s", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("reported", [True, False])
def test_sigma_holds_before_and_after_a_coast(reported: bool, coast_s: float):
    rng = np.random.default_rng(1)
    surprises = list[float]()
    for _ in range(150):
        filtered = RelativeFilter()
        error = rng.normal(0.0, 0.12 if reported else 0.7, 3)
        walk = 0.1 if reported else 1.0
        position = rng.normal(0.0, 1.0, 3)
        if reported:
            filtered.set_velocity((0.2, 0.0, -0.1))
        for k in range(40):
            if k > 0:
                position, error = moved(position, error, walk, reported, rng)
            x, y, z = (position + rng.normal(0.0, NOISE_M, 3)).tolist()
            filtered.update(k * FRAME_NS, (x, y, z), SPREAD)
        frames = round(coast_s / 0.02)
        for _ in range(frames):
            position, error = moved(position, error, walk, reported, rng)
        ahead = filtered.predict(39 * FRAME_NS + frames * FRAME_NS)
        assert ahead is not None
        surprises.append(float(np.sum((np.array(ahead.marker_n_m) - position) ** 2)) / (3.0 * ahead.sigma_m**2))
    assert 0.75 < np.mean(surprises) < 1.3


def moved(
    position: np.ndarray, error: np.ndarray, walk: float, reported: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    after = error + rng.normal(0.0, walk * math.sqrt(0.02), 3)
    velocity = 0.5 * (error + after) + (np.array([0.2, 0.0, -0.1]) if reported else 0.0)
    return position + velocity * 0.02, after


def test_an_outlier_is_refused_and_a_new_place_is_believed_in_the_end():
    filtered = RelativeFilter()
    for k in range(20):
        assert filtered.update(k * FRAME_NS, (1.0, 0.0, 0.0), SPREAD)
    here = filtered.predict(19 * FRAME_NS)
    assert not filtered.update(20 * FRAME_NS, (1.5, 0.0, 0.0), SPREAD)
    assert filtered.predict(19 * FRAME_NS) == here
    took = [filtered.update(k * FRAME_NS, (1.5, 0.0, 0.0), SPREAD) for k in range(21, 35)]
    assert took.index(True) == 8 and all(took[8:])
    there = filtered.predict(34 * FRAME_NS)
    assert there is not None and there.marker_n_m[0] == pytest.approx(1.5, abs=0.01)


def test_a_coast_grows_less_sure_and_ends():
    filtered = RelativeFilter(coast_s=1.0)
    assert filtered.predict(0) is None
    assert math.isinf(filtered.unseen_s(0))
    filtered.set_velocity((0.5, 0.0, 0.0))
    filtered.update(0, (1.0, 2.0, 3.0), SPREAD)
    states = [filtered.predict(k * 100_000_000) for k in range(11)]
    sigmas = [state.sigma_m for state in states if state is not None]
    assert len(sigmas) == 11 and sigmas == sorted(sigmas) and sigmas[-1] > 0.1
    last = states[-1]
    assert last is not None and last.marker_n_m == pytest.approx((1.5, 2.0, 3.0))
    assert filtered.predict(SECOND_NS + 1) is None
    assert filtered.unseen_s(SECOND_NS // 2) == 0.5
    assert filtered.update(3 * SECOND_NS, (9.0, 9.0, 9.0), SPREAD)  # after that, any place will do


def test_an_old_or_repeated_measurement_changes_nothing():
    filtered = RelativeFilter()
    filtered.update(FRAME_NS, (1.0, 0.0, 0.0), SPREAD)
    before = filtered.predict(FRAME_NS)
    assert not filtered.update(FRAME_NS, (1.001, 0.0, 0.0), SPREAD)
    assert not filtered.update(0, (1.001, 0.0, 0.0), SPREAD)
    assert filtered.predict(FRAME_NS) == before


def test_the_first_report_of_a_velocity_does_not_make_it_jump():
    filtered = RelativeFilter()
    for k in range(60):
        filtered.update(k * FRAME_NS, (0.4 * k * 0.02, 0.0, 0.0), SPREAD)
    before = filtered.predict(59 * FRAME_NS)
    filtered.set_velocity((0.35, 0.0, 0.0))
    after = filtered.predict(59 * FRAME_NS)
    assert before is not None and after is not None
    assert before.velocity_n_mps[0] == pytest.approx(0.4, abs=0.05)
    assert after.velocity_n_mps == pytest.approx(before.velocity_n_mps)
