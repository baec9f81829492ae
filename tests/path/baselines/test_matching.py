"""Matches are mutual, clear and alike; what they agree on is one motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from path.baselines.features import Distance, Keypoints
from path.baselines.matching import MatchConfig, Model, Pairs, accepted, hamming, nearest, verify

RNG = np.random.default_rng(5)


def bits(count: int, seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (count, 32), np.uint8)


def keypoints(descriptors: NDArray[Any], points: NDArray[Any] | None = None) -> Keypoints:
    count = len(descriptors)
    where = np.random.default_rng(3).uniform(0, 200, (count, 2)) if points is None else points
    return Keypoints(where.astype(np.float32), descriptors, np.ones(count, np.float32))


def unit(rows: NDArray[Any]) -> NDArray[np.float32]:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def match(a: Keypoints, b: Keypoints, distance: Distance, config: MatchConfig) -> Pairs:
    return accepted(nearest(a, b, distance), distance, config)


def test_hamming_counts_bits() -> None:
    a, b = bits(5, 1), bits(7, 2)
    slow = [[int(np.unpackbits(x ^ y).sum()) for y in b] for x in a]
    assert hamming(a, b).tolist() == slow


def test_the_same_descriptors_match_in_any_order() -> None:
    a = bits(40, 1)
    order = RNG.permutation(40)
    pairs = match(keypoints(a), keypoints(a[order]), "hamming", MatchConfig())
    assert len(pairs) == 40
    assert np.array_equal(order[pairs[:, 1]], pairs[:, 0])


def test_one_that_another_fits_better_is_no_match() -> None:
    a = unit(np.array([[1.0, 0.0, 0.0], [0.9, 0.3, 0.0]]))
    b = unit(np.array([[1.0, 0.02, 0.0]]))
    pairs = match(keypoints(a), keypoints(b), "cosine", MatchConfig(ratio=1.0))
    assert pairs.tolist() == [[0, 0]]


def test_the_ratio_refuses_what_looks_the_same_twice() -> None:
    a = unit(np.array([[1.0, 0.0, 0.0]]))
    twins = unit(np.array([[1.0, 0.10, 0.0], [1.0, 0.0, 0.11]]))
    strict, free = MatchConfig(ratio=0.8), MatchConfig(ratio=1.0)
    assert len(match(keypoints(a), keypoints(twins), "cosine", strict)) == 0
    assert match(keypoints(a), keypoints(twins), "cosine", free).tolist() == [[0, 0]]
    other = unit(np.array([[1.0, 0.10, 0.0], [1.0, 0.0, 0.5]]))
    assert match(keypoints(a), keypoints(other), "cosine", strict).tolist() == [[0, 0]]


def test_unlike_descriptors_do_not_match() -> None:
    a, b = unit(np.array([[1.0, 0.0]])), unit(np.array([[0.6, 0.8]]))
    assert len(match(keypoints(a), keypoints(b), "cosine", MatchConfig(min_cosine=0.7))) == 0
    assert len(match(keypoints(a), keypoints(b), "cosine", MatchConfig(min_cosine=0.5))) == 1
    far = np.zeros((1, 32), np.uint8), np.full((1, 32), 255, np.uint8)
    assert len(match(keypoints(far[0]), keypoints(far[1]), "hamming", MatchConfig())) == 0


@pytest.mark.parametrize("distance", ["hamming", "cosine"])
def test_nothing_matches_nothing(distance: Any) -> None:
    nothing, some = keypoints(bits(0, 1)), keypoints(bits(3, 1))
    assert match(nothing, some, distance, MatchConfig()).shape == (0, 2)
    assert match(some, nothing, distance, MatchConfig()).shape == (0, 2)


@pytest.mark.parametrize("model", ["similarity", "affine", "homography", "epipolar"])
def test_pairs_that_move_together_are_told_from_those_that_do_not(model: Model) -> None:
    config = replace(MatchConfig(), model=model, reach_px=2.0)
    a = RNG.uniform(0, 200, (40, 2))
    b = 1.1 * a @ np.array([[0.98, 0.2], [-0.2, 0.98]]) + [30.0, -12.0]
    b[30:] = RNG.uniform(0, 200, (10, 2)) + 400.0
    pairs = np.column_stack((np.arange(40), np.arange(40)))
    ok = verify(keypoints(bits(40, 1), a), keypoints(bits(40, 1), b), pairs, config)
    assert ok[:30].all()
    if model != "epipolar":  # along an epipolar line anything goes
        assert not ok[30:].any()
    again = verify(keypoints(bits(40, 1), a), keypoints(bits(40, 1), b), pairs, config)
    assert np.array_equal(ok, again)


@pytest.mark.parametrize("model", ["similarity", "affine", "homography", "epipolar"])
def test_too_few_pairs_verify_nothing(model: Model) -> None:
    one = np.array([[0, 0]])
    point = keypoints(bits(1, 1))
    assert not verify(point, point, one, replace(MatchConfig(), model=model)).any()
    assert verify(
        point, point, np.zeros((0, 2), np.int64), replace(MatchConfig(), model=model)
    ).shape == (0,)
