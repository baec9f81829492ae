"""The noise of level ``sim`` against that of the whole perception on rendered frames of the same
scenes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from hil.geometric.noise import EXACT, ObservationNoise
from tests.hil.geometric.noise_measurement import (
    Residuals,
    collect,
    geometric,
    measure_noise,
    rendered,
    scenes,
)

SCENES = 90


@dataclass(frozen=True)
class NoiseFigures:
    """The figures of a perception."""

    edge_bias_px: np.ndarray
    edge_spread_px: float
    edge_p99_px: float
    center_spread_px: float
    car_rate: float
    score: float
    corner_px: float
    corner_p95_px: float
    claimed: float
    marker_rate: float
    depth: float
    depth_p99: float
    claimed_depth: float


def spread(values: np.ndarray) -> np.ndarray:
    low, high = np.percentile(values, [16.0, 84.0], axis=0)
    return 0.5 * (high - low)


def figures(residuals: Residuals) -> NoiseFigures:
    edges = np.array(residuals.edges_px)
    centers = 0.5 * (edges[:, :2] + edges[:, 2:])
    scaled = np.sqrt(np.mean(np.array(residuals.corners_px) ** 2, axis=1)) * np.array(
        residuals.corner_sides_px
    )
    depths = np.array(residuals.depths)
    return NoiseFigures(
        edge_bias_px=np.median(edges, axis=0),
        edge_spread_px=float(spread(edges).mean()),
        edge_p99_px=float(np.percentile(np.abs(edges), 99.0)),
        center_spread_px=float(spread(centers).mean()),
        car_rate=len(edges) / residuals.cars,
        score=float(np.median(residuals.scores)),
        corner_px=float(np.median(scaled)),
        corner_p95_px=float(np.percentile(scaled, 95.0)),
        claimed=float(
            np.median(np.array(residuals.claimed_px) * np.array(residuals.corner_sides_px))
        ),
        marker_rate=float(np.mean(residuals.found)),
        depth=float(spread(depths)),
        depth_p99=float(np.percentile(np.abs(depths), 99.0)),
        claimed_depth=float(np.median(residuals.claimed_depths)),
    )


@cache
def of_rendered() -> Residuals:
    return collect(rendered(5), scenes(21, SCENES))


@cache
def of_sim() -> Residuals:
    return collect(geometric(5), scenes(21, SCENES))


def alike(sim: float, real: float, factor: float) -> bool:
    return real / factor <= sim <= real * factor


def test_boxes_are_as_noisy_as_the_detector_s() -> None:
    sim, real = figures(of_sim()), figures(of_rendered())
    assert np.abs(sim.edge_bias_px - real.edge_bias_px).max() < 0.15
    assert alike(sim.edge_spread_px, real.edge_spread_px, 1.35)
    assert alike(sim.center_spread_px, real.center_spread_px, 1.35)
    assert alike(sim.edge_p99_px, real.edge_p99_px, 3.0)
    assert abs(sim.car_rate - real.car_rate) < 0.02
    assert sim.score == pytest.approx(real.score, abs=0.03)


def test_boxes_of_what_flies_are_as_noisy_as_the_detector_s() -> None:
    sim, real = (
        collect(perceive, scenes(22, 45, "drone")) for perceive in (geometric(5), rendered(5))
    )
    edges, seen = (np.array(residuals.edges_px) for residuals in (sim, real))
    assert np.abs(np.median(edges, axis=0) - np.median(seen, axis=0)).max() < 1.0
    assert alike(float(spread(edges).mean()), float(spread(seen).mean()), 1.5)
    assert abs(len(edges) / sim.cars - len(seen) / real.cars) < 0.03
    assert np.median(sim.scores) == pytest.approx(np.median(real.scores), abs=0.03)


def test_corners_are_as_noisy_as_the_marker_finder_s() -> None:
    sim, real = figures(of_sim()), figures(of_rendered())
    assert alike(sim.corner_px, real.corner_px, 1.5)
    assert alike(sim.corner_p95_px, real.corner_p95_px, 2.0)
    assert alike(sim.claimed, real.claimed, 1.5)


def test_markers_are_found_as_often() -> None:
    sim, real = figures(of_sim()), figures(of_rendered())
    assert abs(sim.marker_rate - real.marker_rate) < 0.06
    assert real.marker_rate < 1.0  # there is something to be alike in


def test_depth_is_as_noisy_as_the_registered_depth() -> None:
    sim, real = figures(of_sim()), figures(of_rendered())
    assert of_sim().no_depth == of_rendered().no_depth == 0
    assert alike(sim.depth, real.depth, 1.35)
    assert alike(sim.depth_p99, real.depth_p99, 2.0)
    assert alike(sim.claimed_depth, real.claimed_depth, 1.1)


def test_what_is_measured_on_sim_is_what_sim_was_given() -> None:
    given = ObservationNoise()
    given = replace(
        given,
        targets=given.targets._replace(
            edge_sigma_px=0.6, bias_top_px=1.0, outlier_rate=0.0, score=0.7, miss_rate=0.2
        ),
        marker=given.marker._replace(
            half_side_px=11.0, side_slope_per_px=1.0, corner_sigma_px2=1.0, coarse_rate=0.0
        ),
        depth_common_sigma_at_1m_m=0.004,
    )
    measured = measure_noise(collect(geometric(2, given), scenes(4, 500)))
    assert measured.targets.edge_sigma_px == pytest.approx(0.6, rel=0.1)
    assert measured.targets.bias_top_px == pytest.approx(1.0, abs=0.1)
    assert measured.targets.miss_rate == pytest.approx(0.2, abs=0.04)
    assert measured.targets.score == pytest.approx(0.7, abs=0.02)
    assert measured.marker.half_side_px == pytest.approx(11.0, abs=0.8)
    assert measured.marker.side_slope_per_px == pytest.approx(1.0, rel=0.4)
    assert measured.marker.corner_sigma_px2 == pytest.approx(1.0, rel=0.2)
    assert measured.marker.claimed_factor == pytest.approx(given.marker.claimed_factor, rel=0.2)
    assert measured.depth_common_sigma_at_1m_m == pytest.approx(0.004, rel=0.15)


def test_exact_is_exact() -> None:
    residuals = collect(geometric(1, EXACT), scenes(3, 30))
    assert np.abs(residuals.edges_px).max() < 1e-9
    assert np.abs(residuals.corners_px).max() < 1e-9
    assert np.abs(residuals.depths).max() < 1e-12
    assert all(residuals.found)
