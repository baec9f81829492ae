"""Boxes from what a network of the YOLOX family says about its grid cells (Ge et al. 2021,
arXiv:2107.08430).

Box coordinates here are of edges in the network's input: a pixel with index i covers i to i + 1.
"""

from __future__ import annotations

import numpy as np

from path.arrays import Flags, Singles, Whole

STRIDES = (8, 16, 32)
MOST_KEPT = 300  # boxes that suppression looks at, the best
SAME_SHARE = 0.6  # of the smaller of two boxes, from which on they are of one object


def grid(
    height: int,
    width: int,
    strides: tuple[int, ...] = STRIDES,
) -> tuple[Singles, Singles]:
    """Cells of all levels in the order of the output: their indices (n, 2), column first, and their
    strides (n, 1).
    """
    cells: list[Singles] = []
    steps: list[Singles] = []
    for stride in strides:
        columns, rows = np.meshgrid(np.arange(width // stride), np.arange(height // stride))
        cells.append(np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float32))
        steps.append(np.full((columns.size, 1), stride, np.float32))
    return np.concatenate(cells), np.concatenate(steps)


def decode(
    raw: Singles,
    cells: Singles,
    steps: Singles,
    scored: Flags,
    least: float,
) -> tuple[Singles, ...]:
    """Boxes that score at least ``least``, of an output in cells.

    Args:
        raw: (n, 5 + classes): offset of the centre in cells, logarithm of the size in cells,
            objectness, classes.
        cells, steps: as ``grid`` gives them.
        scored, least: as of ``best_boxes``, whose results these are.
    """
    keep, scores, best = _best(raw, scored, least)
    part = raw[keep]
    with np.errstate(over="ignore"):
        boxes = np.concatenate(
            ((part[:, :2] + cells[keep]) * steps[keep], np.exp(part[:, 2:4]) * steps[keep]), axis=1
        )
    return _finite(boxes, scores, best)


def best_boxes(
    raw: Singles,
    scored: Flags,
    least: float,
    objectness: bool = True,
) -> tuple[Singles, ...]:
    """Boxes that score at least ``least``, of an output in pixels.

    Args:
        raw: (n, 5 + classes): centre and size in px of the input, objectness, classes; without an
            objectness (n, 4 + classes).
        scored: (classes,), which of them are looked for.

    Returns:
        Centre and size (m, 4) as x, y, w, h in px of the input; scores (m,): objectness times the
        best class that is looked for; and that class (m,). What is not finite is left out.
    """
    keep, scores, best = _best(raw, scored, least, objectness)
    return _finite(raw[keep, :4], scores, best)


def listed_boxes(
    raw: Singles,
    scored: Flags,
    least: float,
) -> tuple[Singles, ...]:
    """Likewise of an output that is suppressed already: (n, 6), two corners in px, score, class."""
    classes = np.clip(raw[:, 5].astype(np.int64), 0, len(scored) - 1)
    part = raw[(raw[:, 4] >= least) & scored[classes]]
    part = part[np.argsort(-part[:, 4], kind="stable")][:MOST_KEPT]
    size = part[:, 2:4] - part[:, :2]
    boxes = np.concatenate((part[:, :2] + 0.5 * size, size), axis=1)
    return _finite(boxes, part[:, 4], part[:, 5])


def _best(
    raw: Singles,
    scored: Flags,
    least: float,
    objectness: bool = True,
) -> tuple[Whole, Singles, Singles]:
    """Return the rows that score enough, best first, their scores and their classes."""
    classes = np.flatnonzero(scored)
    first = 5 if objectness else 4
    best = classes[np.argmax(raw[:, first:][:, classes], axis=1)]
    scores = raw[np.arange(len(raw)), first + best]
    if objectness:
        scores = raw[:, 4] * scores
    keep = np.flatnonzero(scores >= least)
    keep = keep[np.argsort(-scores[keep], kind="stable")][:MOST_KEPT]
    return keep, scores[keep], best[keep].astype(np.float32)


def _finite(
    boxes: Singles,
    scores: Singles,
    classes: Singles,
) -> tuple[Singles, ...]:
    finite = np.isfinite(boxes).all(axis=1)
    return boxes[finite], scores[finite], classes[finite]


def suppress(
    boxes: Singles,
    scores: Singles,
    classes: Singles,
    most_iou: float,
) -> Whole:
    """Indices of boxes (m, 4) kept, best first: none overlaps a better one of its class by more
    than ``most_iou``.
    """
    low = boxes[:, :2] - 0.5 * boxes[:, 2:]
    high = boxes[:, :2] + 0.5 * boxes[:, 2:]
    areas = boxes[:, 2] * boxes[:, 3]
    left = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while len(left):
        first = int(left[0])
        rest = left[1:]
        kept.append(first)
        shared = np.minimum(high[first], high[rest]) - np.maximum(low[first], low[rest])
        both = np.prod(np.maximum(shared, 0.0), axis=1)
        overlap = both / np.maximum(areas[first] + areas[rest] - both, 1e-9)
        left = rest[(overlap <= most_iou) | (classes[rest] != classes[first])]
    return np.array(kept, np.int64)


def merge(
    boxes: Singles,
    scores: Singles,
    classes: Singles,
    looks: Whole,
) -> Whole:
    """Indices of boxes (m, 4) kept, best first, of several looks at one image, each suppressed by
    itself: none shares most of the smaller one's area with a better one of its class of another
    look, as two boxes of one object do of which one leaves out a part.
    """
    low = boxes[:, :2] - 0.5 * boxes[:, 2:]
    high = boxes[:, :2] + 0.5 * boxes[:, 2:]
    areas = boxes[:, 2] * boxes[:, 3]
    kept: list[int] = []
    for each in np.argsort(-scores, kind="stable").tolist():
        shared = np.minimum(high[each], high[kept]) - np.maximum(low[each], low[kept])
        both = np.prod(np.maximum(shared, 0.0), axis=1)
        again = both > SAME_SHARE * np.minimum(areas[each], areas[kept])
        again &= (classes[kept] == classes[each]) & (looks[kept] != looks[each])
        if not again.any():
            kept.append(each)
    return np.array(kept, np.int64)
