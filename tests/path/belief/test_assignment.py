"""Joint association, held against every event written out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from path.belief.assignment import Array, associate


def by_hand(weights: Array) -> tuple[list[int | None], Array]:
    """Every joint event one after the other."""
    rows, columns = weights.shape
    total, best, found = 0.0, 0.0, list[int | None]()
    marginals = np.zeros(weights.shape)
    for event in itertools.product([None, *range(columns)], repeat=rows):
        taken = [column for column in event if column is not None]
        if len(set(taken)) < len(taken):
            continue
        weight = 1.0
        for row, column in enumerate(event):
            if column is not None:
                weight *= float(weights[row, column])
        total += weight
        for row, column in enumerate(event):
            if column is not None:
                marginals[row, column] += weight
        if weight > best:
            best, found = weight, list(event)
    return found, marginals / total


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (2, 2), (3, 2), (2, 4), (3, 4)])
def test_marginals_and_assignment_are_those_of_every_event_written_out(
    shape: tuple[int, int],
) -> None:
    weights = np.random.default_rng(shape[0] * 10 + shape[1]).lognormal(0.0, 2.0, shape)
    assigned, marginals = associate(weights)
    expected, sums = by_hand(weights)
    assert assigned == expected
    np.testing.assert_allclose(marginals, sums, rtol=1e-9)


def test_objects_far_from_one_another_are_worked_out_by_themselves() -> None:
    weights = np.diag([50.0] * 12)
    weights[0, 1] = weights[1, 0] = 1e-12
    assigned, marginals = associate(weights)
    assert assigned == list(range(12))
    np.testing.assert_allclose(np.diag(marginals), 50.0 / 51.0)


def test_a_crowd_of_which_everybody_could_be_anybody_is_no_endless_sum() -> None:
    weights = np.random.default_rng(1).lognormal(0.0, 1.0, (12, 12)) + np.diag([1e6] * 12)
    assigned, marginals = associate(weights)
    assert assigned == list(range(12))
    assert np.all(marginals.sum(axis=1) <= 1.0 + 1e-9)


def test_one_of_a_crowd_whose_place_is_hardly_known_is_found_beside_those_who_are_known_well() -> (
    None
):
    """It might be any of them, as far as it alone is asked: those links go, and not its own."""
    weights = np.diag([500.0] + [1e6] * 9)
    weights[0, 1:] = 3.0
    assigned, marginals = associate(weights)
    assert assigned == list(range(10))
    assert marginals[0, 0] == pytest.approx(500.0 / 501.0, rel=1e-3)


def test_one_that_two_could_be_is_of_the_likelier_and_the_other_is_not_shown() -> None:
    assigned, marginals = associate(np.array([[6.0], [2.0]]))
    assert assigned == [0, None]
    np.testing.assert_allclose(marginals[:, 0], [6.0 / 9.0, 2.0 / 9.0])


def test_nothing_seen_and_nobody_known_are_no_trouble() -> None:
    assert associate(np.zeros((2, 0)))[0] == [None, None]
    assert associate(np.zeros((0, 3)))[0] == []
