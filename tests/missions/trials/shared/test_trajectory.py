"""Clock and frame between two records of one motion: found, with deviations that hold, and errors
as defined.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from missions.trials.shared.trajectory import (
    Alignment,
    MotionPair,
    Trajectory,
    align,
    ape,
    coarse_offset,
    rotation_between,
    rpe_after,
    rpe_along,
)
from path.geometry.rotation import R_from_rpy, exp

Array = NDArray[np.float64]
R, SHIFT, OFFSET_S, NOISE_M = (
    exp(np.array([0.0, 0.0, 2.1])),
    np.array([4.0, -7.0, 0.3]),
    -3541.237,
    0.02,
)


def way(t: Array) -> Array:
    """Up, there and back, with stops: (n, 3) at instants (n,)."""
    up = 1.5 / (1.0 + np.exp(-1.5 * (t - 8.0)))
    there = 2.0 / (1.0 + np.exp(-1.2 * (t - 20.0)))
    return np.column_stack([there + 0.5 * np.sin(0.5 * t), 0.8 * np.sin(0.31 * t), up])


def records(
    seed: int, noise_m: float = NOISE_M, seconds: float = 60.0, R: Array = R
) -> tuple[Trajectory, Trajectory]:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.1)
    curve = Trajectory(t, way(t) + rng.normal(0.0, 0.002, (len(t), 3)))
    instants = np.arange(1.0, seconds - 1.0, 0.125) + rng.normal(
        0.0, 0.005, len(np.arange(1.0, seconds - 1.0, 0.125))
    )
    samples = way(instants) @ R.T + SHIFT + rng.normal(0.0, noise_m, (len(instants), 3))
    return curve, Trajectory(instants - OFFSET_S, samples)


def found(curve: Trajectory, samples: Trajectory, seed: int = 0) -> Alignment:
    return align(
        [MotionPair(curve, samples)], coarse_offset(curve, samples), np.random.default_rng(seed)
    )


def test_clock_and_frame_are_found() -> None:
    curve, samples = records(1)
    assert coarse_offset(curve, samples) == pytest.approx(OFFSET_S, abs=0.15)
    alignment = found(curve, samples)
    assert alignment.offset_s == pytest.approx(OFFSET_S, abs=0.01)
    assert alignment.yaw_rad == pytest.approx(2.1, abs=0.005)
    assert alignment.shifts[0] == pytest.approx(SHIFT, abs=0.01)
    assert alignment.scales_m[0] == pytest.approx(NOISE_M, rel=0.1)
    assert np.all(alignment.used[0])


@pytest.mark.parametrize("wrong_s", [0.3, -0.3])
def test_a_clock_that_is_wrong_by_0_3_s_is_found_out(wrong_s: float) -> None:
    """To 10 ms."""
    curve, samples = records(2)
    right, wrong = found(curve, samples), found(curve, replace(samples, t=samples.t + wrong_s))
    assert right.offset_s - wrong.offset_s == pytest.approx(wrong_s, abs=0.001)
    assert wrong.offset_s + wrong_s == pytest.approx(OFFSET_S, abs=0.01)
    started_wrong = align(
        [MotionPair(curve, samples)], OFFSET_S + wrong_s, np.random.default_rng(0)
    )
    assert started_wrong.offset_s == pytest.approx(OFFSET_S, abs=0.01)


def test_the_deviations_hold() -> None:
    """Errors over what is claimed, over many records: about 1."""
    errors = list[tuple[float, float]]()
    for seed in range(16):
        alignment = found(*records(100 + seed), seed)
        errors.append(
            (
                (alignment.offset_s - OFFSET_S) / alignment.offset_sigma_s,
                (alignment.yaw_rad - 2.1) / alignment.yaw_sigma_rad,
            )
        )
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((spread > 0.5) & (spread < 1.7)), spread


def test_outliers_do_no_harm_and_are_told() -> None:
    curve, samples = records(3)
    wrong = samples.p.copy()
    picks = np.random.default_rng(0).choice(len(wrong), len(wrong) // 20, replace=False)
    wrong[picks] += np.random.default_rng(1).normal(0.0, 0.6, (len(picks), 3))
    alignment = found(curve, replace(samples, p=wrong))
    assert alignment.offset_s == pytest.approx(OFFSET_S, abs=0.01)
    assert alignment.yaw_rad == pytest.approx(2.1, abs=0.006)
    assert np.count_nonzero(~alignment.used[0][picks]) > 0.85 * len(picks)
    assert np.mean(alignment.used[0]) > 0.93


def test_a_curve_that_drifts_may_wander() -> None:
    """A position estimate walks away; a shift that may change takes that up, a constant one
    mistakes it for time.
    """
    curve, samples = records(4)
    walk = np.cumsum(
        np.random.default_rng(5).normal(0.0, 0.02 * math.sqrt(0.1), (len(curve.t), 3)), axis=0
    )
    drifting = Trajectory(curve.t, curve.p + walk)
    wandering = align([MotionPair(drifting, samples, 8.0)], OFFSET_S, np.random.default_rng(0))
    fixed = align([MotionPair(drifting, samples)], OFFSET_S, np.random.default_rng(0))
    assert abs(wandering.offset_s - OFFSET_S) < 0.02
    assert wandering.scales_m[0] < fixed.scales_m[0]


def test_two_motions_share_clock_and_frame() -> None:
    first, second = records(6), records(7)
    alignment = align(
        [MotionPair(*first), MotionPair(*second)], OFFSET_S + 0.1, np.random.default_rng(0)
    )
    single = found(*first)
    assert alignment.offset_sigma_s < single.offset_sigma_s
    assert len(alignment.shifts) == len(alignment.residuals) == 2


def test_no_pair_is_lost_because_the_frames_are_turned() -> None:
    """Medians by axis of a motion that rests at a few places differ by the frame that they are
    taken in.
    """
    t = np.arange(0.0, 60.0, 0.1, dtype=np.float64)
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.2, 0.0], [0.2, 2.0, 0.0]])
    rests = np.array(
        [np.interp(t, [0, 16, 20, 38, 42, 60], corners[[0, 0, 1, 1, 2, 2], k]) for k in range(3)]
    ).T
    for turn in np.linspace(0.0, 2.0 * math.pi, 9):
        turned = exp(np.array([0.0, 0.0, turn]))
        rng = np.random.default_rng(1)
        pairs = [
            MotionPair(
                Trajectory(t, places),
                Trajectory(
                    t[5:-5] + 0.03,
                    (places @ turned.T + rng.normal(0.0, NOISE_M, places.shape))[5:-5],
                ),
            )
            for places in (rests, rests[:, [0, 2, 1]])
        ]
        used = align(pairs, 0.0, np.random.default_rng(0)).used
        assert all(np.mean(own) > 0.95 for own in used), turn


def test_a_free_rotation_is_found_too() -> None:
    turned = R_from_rpy(0.3, -0.2, 1.0)
    curve, samples = records(8, R=turned)
    alignment = align([MotionPair(curve, samples)], OFFSET_S, np.random.default_rng(0), turn="any")
    assert pytest.approx(turned, abs=0.01) == alignment.R


def test_rotations_are_proper() -> None:
    a = np.random.default_rng(0).normal(0.0, 1.0, (40, 3))
    a[:, 2] *= 1e-9  # flat
    for turn in ("vertical", "any"):
        found_R = rotation_between(a, a @ R.T, turn)
        assert found_R == pytest.approx(R, abs=1e-6)
        assert np.linalg.det(found_R) == pytest.approx(1.0)


def test_records_that_do_not_meet_are_refused() -> None:
    curve, samples = records(9)
    with pytest.raises(ValueError, match="too few"):
        align([MotionPair(curve, samples)], OFFSET_S + 500.0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="too short"):
        coarse_offset(curve, Trajectory(samples.t[:10], samples.p[:10]))


def test_nothing_is_interpolated_across_gaps() -> None:
    path = Trajectory(np.array([0.0, 0.1, 1.0, 1.1]), np.zeros((4, 3)))
    known = np.isfinite(path.at(np.array([-0.1, 0.05, 0.5, 1.05, 1.2]))[:, 0])
    assert known.tolist() == [False, True, False, True, False]


def test_errors_are_as_defined() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    drift = np.column_stack([0.01 * t, np.zeros_like(t), np.zeros_like(t)])
    assert ape(drift) == pytest.approx(0.01 * t)
    # the nearest there is within a fifth
    assert rpe_after(t, drift, 1.0) == pytest.approx(0.01, abs=0.0021)
    # the last ones have no partner
    assert len(rpe_after(t, drift, 1.0)) == pytest.approx(90, abs=2)
    places = np.column_stack([0.5 * t, np.zeros_like(t), np.zeros_like(t)])  # 1 m in 2 s
    assert rpe_along(places, drift, 1.0) == pytest.approx(0.02, abs=0.0011)
    assert len(rpe_along(places, drift, 100.0)) == 0
