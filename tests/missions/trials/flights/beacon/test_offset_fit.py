"""The offset between two clocks where errors go together: found better than by a free wander, as
sure as it says.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from missions.trials.flights.beacon.offset_fit import OffsetFit, fit_offset
from missions.trials.flights.dynamic.flight import steadied
from missions.trials.shared.trajectory import Alignment, MotionPair, Trajectory, align
from path.geometry.rotation import exp

Array = NDArray[np.float64]
R, OFFSET_S, STEADY_S, SESSIONS = exp(np.array([0.0, 0.0, 2.1])), 12.345, 1.0, 16
NOISE_M, WALK_M, WARP_M = 0.02, 0.01, 0.012


def way(t: Array, first: float) -> Array:
    """Up, to and fro at up to 0.6 m/s, down: (n, 3) at instants (n,)."""
    up = 1.5 / (1.0 + np.exp(-1.5 * (t - 6.0))) - 1.5 / (1.0 + np.exp(-1.5 * (t - 56.0)))
    moving = 1.0 / (1.0 + np.exp(-2.0 * (t - 10.0)))
    return np.column_stack(
        [
            first + 1.3 * moving * np.sin(0.45 * t),
            moving * (0.4 * np.cos(0.45 * t) + 0.1 * np.sin(0.9 * t + first)),
            up,
        ]
    )


def session(seed: int, moves: bool = True) -> list[MotionPair]:
    """Two vehicles whose own positions jitter and walk away, and beacons with noise in a frame that
    is warped.
    """
    rng = np.random.default_rng([seed, 42])
    waves, phases = rng.standard_normal((6, 3)), rng.uniform(0.0, 2.0 * math.pi, (6, 3))
    waves *= (math.pi / 3.0) / np.linalg.norm(waves, axis=1, keepdims=True)
    pairs = list[MotionPair]()
    for first in (0.0, 2.0):
        t = np.arange(0.0, 62.0, 0.1)
        true = way(t if moves else np.zeros_like(t), first)
        own = true + rng.normal(0.0, 0.03, true.shape)
        own += np.cumsum(rng.normal(0.0, WALK_M * math.sqrt(0.1), true.shape), axis=0)
        velocity = np.gradient(true, t, axis=0)
        instants = np.arange(1.0, 61.0, 0.125)
        places = way(instants if moves else np.zeros_like(instants), first)
        warp = WARP_M / math.sqrt(3.0) * np.sin((places @ waves.T)[:, :, None] + phases).sum(axis=1)
        seen = (places + warp + rng.normal(0.0, NOISE_M, places.shape)) @ R.T + np.array(
            [4.0, -7.0, 0.3]
        )
        pairs.append(
            MotionPair(
                Trajectory(t, steadied(t, own, velocity)),
                Trajectory(instants - OFFSET_S, seen),
                4.0,
            )
        )
    return pairs


@cache
def fitted(seed: int) -> tuple[OffsetFit, Alignment]:
    pairs = session(seed)
    robust = align(pairs, OFFSET_S, np.random.default_rng(0))
    return fit_offset(pairs, robust, STEADY_S), robust


def test_the_offset_is_found_to_10_ms_where_a_free_wander_does_not() -> None:
    found = (
        np.array([[fit.offset_s, robust.offset_s] for fit, robust in map(fitted, range(SESSIONS))])
        - OFFSET_S
    )
    errors_s = np.sqrt(np.mean(found**2, axis=0))
    assert 1.96 * errors_s[0] < 0.010 < 1.96 * errors_s[1], errors_s


def test_it_is_as_sure_as_it_may_be() -> None:
    fits = [fit for fit, _ in map(fitted, range(SESSIONS))]
    ratio = np.array([(fit.offset_s - OFFSET_S) / fit.offset_sigma_s for fit in fits])
    assert 0.6 < math.sqrt(float(np.mean(ratio**2))) < 1.5


def test_the_records_say_how_large_each_error_is() -> None:
    """The median over sessions: one says little of a warp."""
    spreads = [fit.spreads for fit, _ in map(fitted, range(SESSIONS))]
    assert np.median([own.noise_m for own in spreads]) == pytest.approx(NOISE_M, rel=0.1)
    assert np.median([own.walk_m_per_sqrt_s for own in spreads]) == pytest.approx(WALK_M, rel=0.25)
    assert np.median([own.warp_m for own in spreads]) == pytest.approx(WARP_M, rel=0.4)


@pytest.mark.parametrize("wrong_s", [0.3, -0.3])
def test_a_start_that_is_wrong_by_0_3_s_changes_nothing(wrong_s: float) -> None:
    pairs = session(1)
    late = fit_offset(pairs, align(pairs, OFFSET_S + wrong_s, np.random.default_rng(0)), STEADY_S)
    assert late.offset_s == pytest.approx(fitted(1)[0].offset_s, abs=1e-4)
    assert late.offset_s == pytest.approx(OFFSET_S, abs=0.01)


def test_outliers_do_no_harm() -> None:
    pairs, rng = session(2), np.random.default_rng(3)
    struck = [
        replace(
            pair,
            samples=replace(
                pair.samples, p=pair.samples.p + 0.5 * rng.standard_normal((480, 3)) * hit
            ),
        )
        for pair, hit in ((pair, rng.random((480, 1)) < 0.03) for pair in pairs)
    ]
    fit = fit_offset(struck, align(struck, OFFSET_S, np.random.default_rng(0)), STEADY_S)
    assert fit.offset_s == pytest.approx(fitted(2)[0].offset_s, abs=0.003)
    assert fit.spreads.noise_m == pytest.approx(NOISE_M, rel=0.15)


def test_what_never_moved_has_no_offset() -> None:
    pairs = session(4, moves=False)
    robust = align(pairs, OFFSET_S, np.random.default_rng(0), fit_offset=False)
    still = [
        replace(pair, curve=Trajectory(pair.curve.t, np.zeros_like(pair.curve.p))) for pair in pairs
    ]
    with pytest.raises(ValueError, match="nothing moved"):
        fit_offset(still, robust, STEADY_S)
    refused = replace(robust, used=(robust.used[0], np.zeros_like(robust.used[1])))
    with pytest.raises(ValueError, match="no sample"):
        fit_offset(pairs, refused, STEADY_S)
