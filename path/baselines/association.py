"""One cycle of a baseline: D1's target is the box of D2 that shares the most verified features with
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Literal

import numpy as np

from path.baselines.features import Distance, Features, FeatureSearch, Image, Keypoints, look
from path.baselines.matching import MatchConfig, Nearest, Pairs, accepted, nearest, verify
from path.observations import Box
from path.values import frozen

Scope = Literal["each", "all"]


@frozen
class BaselineConfig:
    """Configuration of a baseline.

    Attributes:
        scope: match D1's features against "each" of D2's boxes by itself, or against the features
            of "all" together: then the ratio test asks that no other person looks the same there.
        min_inliers: verified matches a box needs.
        min_lead: how many more than any other box.
    """

    look: FeatureSearch = field(default_factory=FeatureSearch)
    match: MatchConfig = field(default_factory=MatchConfig)
    scope: Scope = "each"
    min_inliers: int = 6
    min_lead: int = 1


@frozen(eq=False)
class Votes:
    """The evidence for each of D2's boxes.

    Attributes:
        inliers: verified matches, one number a box.
        lines: for each box the matched points, (n, 4): u, v in D1's image, u, v in D2's.
    """

    inliers: tuple[int, ...]
    lines: tuple[np.ndarray[tuple[int, int], np.dtype[np.float32]], ...]


def choose(
    inliers: Sequence[int],
    min_inliers: int,
    min_lead: int,
) -> int | None:
    """Index of the box with the most verified matches; None when they are too few, or nearly as
    many elsewhere.
    """
    if not inliers:
        return None
    order = sorted(range(len(inliers)), key=lambda i: -inliers[i])
    best = inliers[order[0]]
    second = inliers[order[1]] if len(order) > 1 else 0
    return order[0] if best >= max(min_inliers, 1) and best - second >= min_lead else None


def vote(
    features: Features,
    own: Keypoints,
    theirs: Sequence[Keypoints],
    config: BaselineConfig,
    seed: int = 0,
) -> Votes:
    """Verified matches of D1's target with each of D2's boxes.

    Args:
        own: features of D1's target.
        theirs: features of each of D2's boxes; both as ``path.baselines.features.look`` finds them.
    """
    return vote_each(features, own, theirs, [config], seed)[0]


def vote_each(
    features: Features,
    own: Keypoints,
    theirs: Sequence[Keypoints],
    configs: Sequence[BaselineConfig],
    seed: int = 0,
) -> list[Votes]:
    """The votes under several configurations of the same ``look``; what they share is worked out
    once.
    """
    distance = features.distance
    apart = (
        [nearest(own, each, distance) for each in theirs]
        if any(c.scope == "each" for c in configs)
        else []
    )
    together = _joined(theirs) if any(c.scope == "all" for c in configs) else None
    whole = None if together is None else nearest(own, together[0], distance)
    cast: list[Votes] = []
    for config in configs:
        if config.scope == "each":
            sets = zip(apart, theirs, strict=True)
            lines = tuple(
                _lines(own, each, _verified(own, each, found, distance, config, seed))
                for found, each in sets
            )
        elif together is None or whole is None:
            lines = (np.zeros((0, 4), np.float32),) * len(theirs)
        else:
            everything, owner = together
            pairs = _verified(own, everything, whole, distance, config, seed)
            whose = owner[pairs[:, 1]]
            lines = tuple(_lines(own, everything, pairs[whose == i]) for i in range(len(theirs)))
        cast.append(Votes(tuple(len(line) for line in lines), lines))
    return cast


def associate(
    features: Features,
    image1: Image,
    box1: Box,
    image2: Image,
    boxes2: Sequence[Box],
    config: BaselineConfig,
    seed: int = 0,
) -> tuple[int | None, Votes]:
    """One whole cycle: features around D1's target and around D2's boxes, matched, verified,
    associated.

    Returns:
        The index of D2's box that is taken for the target, None when there is none, and what spoke
        for each box.
    """
    (own,) = look(features, image1, [box1], config.look)
    votes = vote(features, own, look(features, image2, boxes2, config.look), config, seed)
    return choose(votes.inliers, config.min_inliers, config.min_lead), votes


def _verified(
    own: Keypoints,
    other: Keypoints,
    found: Nearest,
    distance: Distance,
    config: BaselineConfig,
    seed: int,
) -> Pairs:
    pairs = accepted(found, distance, config.match)
    return pairs[verify(own, other, pairs, config.match, seed)]


def _joined(
    theirs: Sequence[Keypoints],
) -> tuple[Keypoints, np.ndarray[tuple[int], np.dtype[np.int64]]] | None:
    """All boxes' features in one, each place once, and whose they are."""
    if not any(len(each) for each in theirs):
        return None
    points = np.concatenate([each.points_px for each in theirs])
    owner = np.repeat(np.arange(len(theirs)), [len(each) for each in theirs])
    everything = Keypoints(
        points,
        np.concatenate([each.descriptors for each in theirs]),
        np.concatenate([each.scores for each in theirs]),
    )
    _, first = np.unique(np.round(points, 2), axis=0, return_index=True)
    first.sort()
    return everything.pick(first), owner[first]


def _lines(
    own: Keypoints,
    other: Keypoints,
    pairs: Pairs,
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    return np.hstack((own.points_px[pairs[:, 0]], other.points_px[pairs[:, 1]]))
