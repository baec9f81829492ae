"""The target's place by both drones' views: what two lines of sight and their ranges make of each
other.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from path.target.both_views import BothViews, Sighted, triangulate, with_range

SCALES = (0.2, 1.0, 5.0, 20.0)
TARGET = np.array([0.3, 0.2, 3.4])
MARKER = np.array([0.1, -0.2, 1.3])
TURN_RAD, PLACE_M, RAY_RAD = 0.004, 0.003, 0.003


def sighted(parallax_deg: float, k: float, along_m: float, across_m: float) -> Sighted:
    """D1 two metres from the target, so many degrees off D2's line of sight."""
    angle = math.radians(parallax_deg)
    back = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    pose = np.diag([(PLACE_M * k) ** 2] * 3 + [TURN_RAD**2] * 3)
    return Sighted(
        k * TARGET, -2.0 * k * back, k * (TARGET - MARKER), along_m * k, across_m * k, pose
    )


def ray_to(point: NDArray[np.float64], off_rad: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x / z + float(off_rad[0]), y / z + float(off_rad[1]), 1.0


def drawn(said: Sighted, rng: np.random.Generator) -> Sighted:
    """The same with errors as they are stated."""
    noise = np.linalg.cholesky(said.covariance) @ rng.standard_normal(3)
    return replace(said, point_c=said.point_c + noise)


def errors(
    parallax_deg: float, k: float, along_m: float, *, own_sigma_m: float = math.inf
) -> tuple[float, ...]:
    """Root mean squares over drawn errors: D1's alone, both views', and both views' in stated
    deviations per axis.
    """
    rng, truth = np.random.default_rng(11), sighted(parallax_deg, k, along_m, 0.015)
    alone: list[float] = []
    together: list[float] = []
    share: list[float] = []
    for _ in range(400):
        said = drawn(truth, rng)
        ray = ray_to(truth.point_c, RAY_RAD * rng.standard_normal(2))
        found = triangulate(said, ray, RAY_RAD)
        if math.isfinite(own_sigma_m):
            distance_m = (
                float(np.linalg.norm(truth.point_c)) + own_sigma_m * k * rng.standard_normal()
            )
            found = with_range(found, ray, distance_m, own_sigma_m * k)
        off = found.point_c - truth.point_c
        alone.append(float(np.sum((said.point_c - truth.point_c) ** 2)))
        together.append(float(np.sum(off**2)))
        share.append(float(off @ np.linalg.solve(found.covariance, off)) / 3.0)
    a, b, c = (math.sqrt(float(np.mean(each))) for each in (alone, together, share))
    return a, b, c


@pytest.mark.parametrize("k", SCALES)
@pytest.mark.parametrize("parallax_deg", [5.0, 10.0, 40.0, 90.0])
def test_both_views_are_never_worse_than_one_and_off_by_as_much_as_they_state(
    parallax_deg: float, k: float
) -> None:
    alone, together, share = errors(parallax_deg, k, 0.025)
    assert together < alone
    assert 0.9 < share < 1.1


def test_two_bearings_that_cross_know_the_range_that_neither_has() -> None:
    """A tenth of the range at 2 m: a Tello's. Nearly parallel they leave it, and say so."""
    alone, crossing, _ = errors(60.0, 1.0, 0.2)
    assert crossing < 0.15 * alone
    said = sighted(60.0, 1.0, 0.2, 0.015)
    ray = ray_to(said.point_c, np.zeros(2))
    assert triangulate(said, ray, RAY_RAD).sigma_m < 0.03
    parallel = sighted(3.0, 1.0, 0.2, 0.015)
    assert triangulate(parallel, ray, RAY_RAD).sigma_m > 0.1


def test_an_own_range_adds_to_what_parallel_lines_of_sight_do_not_have() -> None:
    without = errors(10.0, 1.0, 0.025)[1]
    found = errors(10.0, 1.0, 0.025, own_sigma_m=0.015)
    assert found[1] < 0.8 * without
    assert 0.9 < found[2] < 1.1


@pytest.mark.parametrize("k", SCALES)
def test_a_line_of_sight_to_another_object_is_not_believed(k: float) -> None:
    said = sighted(30.0, k, 0.025, 0.015)
    beside = said.point_c + k * np.array([0.3, 0.0, 0.0])
    found = triangulate(said, ray_to(beside, np.zeros(2)), RAY_RAD)
    assert not found.agree
    assert found.chi2 > 14.0
    assert np.array_equal(found.point_c, said.point_c)


def test_an_own_range_that_contradicts_is_left_out() -> None:
    said = sighted(30.0, 1.0, 0.025, 0.015)
    ray = ray_to(said.point_c, np.zeros(2))
    both = triangulate(said, ray, RAY_RAD)
    assert with_range(both, ray, 6.0, 0.02) is both


def test_its_depth_on_a_ray_is_of_the_point_that_the_ray_passes() -> None:
    both = BothViews(TARGET, 1e-4 * np.eye(3), 0.0, agree=True)
    z_m, sigma_m = both.along(ray_to(TARGET, np.zeros(2)))
    assert z_m == pytest.approx(3.4)
    assert sigma_m == pytest.approx(0.01 * 3.4 / float(np.linalg.norm(TARGET)))
