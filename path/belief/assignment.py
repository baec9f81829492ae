"""Which measurement is of which object: all joint events of one frame, and what each pair has of
their probability.

An event gives each object one measurement or none, and no measurement to two objects. Its weight is
the product of

    w_ij = r_i p_i L_ij / ((1 - r_i p_i) lambda_j)

over its pairs, where r_i is the probability that the object exists, p_i that the detector shows it,
L_ij the density of the measurement if it is of the object, and lambda_j that of one which is of
nothing known. The marginal

    beta_ij = sum of the weights of the events with the pair (i, j) / sum of the weights of all
    events

is what joint probabilistic data association (Fortmann, Bar-Shalom, Scheffe 1983) weighs
measurements with; the event of the largest weight is the assignment. Both are sums over subsets of
the measurements, object after object. Objects and measurements that no weight connects are apart
from one another: each group is worked out by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NEGLIGIBLE = 1e-9
_MOST = 8  # measurements of one group: 256 subsets


def associate(weights: Array) -> tuple[list[int | None], Array]:
    """Return the likeliest assignment, a measurement or None for each object, and the marginals.

    Args:
        weights: w_ij, shape (objects, measurements), not negative.

    Returns:
        the assignment, and beta, shape (objects, measurements): what is left of a row to 1 is for
        "not shown".
    """
    assigned: list[int | None] = [None] * weights.shape[0]
    marginals = np.zeros(weights.shape)
    for rows, columns in _groups(weights):
        if len(rows) == len(columns) == 1:
            weight = float(weights[rows[0], columns[0]])
            marginals[rows[0], columns[0]] = weight / (1.0 + weight)
            assigned[rows[0]] = columns[0] if weight > 1.0 else None
            continue
        best, own = _within(weights[np.ix_(rows, columns)])
        marginals[np.ix_(rows, columns)] = own
        for row, column in zip(rows, best, strict=True):
            assigned[row] = None if column is None else columns[column]
    return assigned, marginals


def _groups(weights: Array) -> list[tuple[list[int], list[int]]]:
    """Return rows and columns that weights connect; of a group that is too large the weakest
    connections are cut: those that are least against what either has beside them.
    """
    if not weights.size:
        return []
    most = np.maximum(weights.max(axis=0), weights.max(axis=1)[:, None])
    against: list[list[float]] = (weights / np.maximum(most, 1.0)).tolist()
    left = [(list(range(weights.shape[0])), _NEGLIGIBLE)]
    found = list[tuple[list[int], list[int]]]()
    while left:
        rows, floor = left.pop()
        for group, columns in _connected(against, rows, floor):
            if len(columns) <= _MOST or len(group) == 1:
                found.append((group, columns))
            else:
                left.append((group, floor * 1e3))
    return found


def _connected(
    weights: Sequence[Sequence[float]],
    rows: Sequence[int],
    floor: float,
) -> list[tuple[list[int], list[int]]]:
    open_rows = set(rows)
    groups = list[tuple[list[int], list[int]]]()
    while open_rows:
        group = set[int]()
        columns = set[int]()
        edge = {min(open_rows)}
        while edge:
            group |= edge
            columns |= {c for row in edge for c, each in enumerate(weights[row]) if each > floor}
            edge = {
                row for row in open_rows - group if any(weights[row][c] > floor for c in columns)
            }
        open_rows -= group
        if columns:
            groups.append((sorted(group), sorted(columns)))
    return groups


def _within(weights: Array) -> tuple[list[int | None], Array]:
    """The same of one group, over all subsets of its measurements."""
    rows = weights.tolist()
    many = weights.shape[1]
    subsets = 1 << weights.shape[1]
    totals = [[1.0] + [0.0] * (subsets - 1)]
    bests = [[1.0] + [0.0] * (subsets - 1)]
    choices: list[list[int | None]] = []
    for row in rows:
        total = totals[-1].copy()
        best = bests[-1].copy()
        choice: list[int | None] = [None] * subsets
        for used in range(subsets):
            for column in range(many):
                if used >> column & 1:
                    before = used ^ (1 << column)
                    total[used] += totals[-1][before] * row[column]
                    by_it = bests[-1][before] * row[column]
                    if by_it > best[used]:
                        best[used], choice[used] = by_it, column
        totals.append(total)
        bests.append(best)
        choices.append(choice)
    marginals = _marginals(rows, totals, many)
    used = max(range(subsets), key=lambda each: bests[-1][each])
    assigned: list[int | None] = [None] * len(rows)
    for k in reversed(range(len(rows))):
        column = assigned[k] = choices[k][used]
        used = used if column is None else used ^ (1 << column)
    return assigned, marginals


def _marginals(
    rows: Sequence[Sequence[float]],
    totals: Sequence[Sequence[float]],
    many: int,
) -> Array:
    subsets = 1 << many
    everything = sum(totals[-1])
    marginals = np.zeros((len(rows), many))
    after = [1.0] * subsets  # weight of what the later objects may take when these are used already
    for k in reversed(range(len(rows))):
        row = rows[k]
        earlier = after.copy()
        for used in range(subsets):
            for column in range(many):
                if not used >> column & 1:
                    by_it = row[column] * after[used | 1 << column]
                    marginals[k, column] += totals[k][used] * by_it / everything
                    earlier[used] += by_it
        after = earlier
    return marginals
