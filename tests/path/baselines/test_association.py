"""One cycle of a baseline on drawn images: the same pattern is found again, and a box without it is
not taken.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from path.baselines.association import BaselineConfig, Scope, associate, choose
from path.baselines.features import FeatureSearch, Image
from path.baselines.matching import MatchConfig
from path.baselines.orb import Orb
from path.observations import Box

BOXES = [Box(40, 60, 90, 120), Box(200, 70, 90, 120), Box(360, 50, 90, 120)]


def pattern(seed: int) -> Image:
    coarse = np.random.default_rng(seed).integers(0, 256, (15, 11, 3), np.uint8)
    return np.asarray(cv2.resize(coarse, (90, 120), interpolation=cv2.INTER_NEAREST), np.uint8)


def scene(*seeds: int) -> Image:
    image = np.full((240, 500, 3), 120, np.uint8)
    for seed, box in zip(seeds, BOXES, strict=False):
        image[int(box.y) : int(box.y + box.h), int(box.x) : int(box.x + box.w)] = pattern(seed)
    return image


def config(scope: Scope) -> BaselineConfig:
    return BaselineConfig(FeatureSearch(2.0, 0.0), MatchConfig(), scope, 12, 4)


@pytest.mark.parametrize("scope", ["each", "all"])
@pytest.mark.parametrize("where", [0, 1, 2])
def test_the_box_with_the_same_pattern_is_found(scope: Scope, where: int) -> None:
    seeds = [11, 12, 13]
    seeds[where] = 1
    found, votes = associate(Orb(), scene(1), BOXES[0], scene(*seeds), BOXES, config(scope))
    assert found == where
    assert votes.inliers[where] > 20
    line = votes.lines[where]
    assert line.shape == (votes.inliers[where], 4)
    shift = BOXES[where].x - BOXES[0].x, BOXES[where].y - BOXES[0].y
    assert np.median(line[:, 2:] - line[:, :2], axis=0) == pytest.approx(shift, abs=1.0)


@pytest.mark.parametrize("scope", ["each", "all"])
def test_no_box_with_that_pattern_is_no_target(scope: Scope) -> None:
    found, votes = associate(Orb(), scene(1), BOXES[0], scene(11, 12, 13), BOXES, config(scope))
    assert found is None
    assert len(votes.inliers) == 3


def test_twins_are_not_guessed_between_when_a_lead_is_asked_for() -> None:
    found, votes = associate(Orb(), scene(1), BOXES[0], scene(1, 1, 12), BOXES, config("each"))
    assert found is None
    assert min(votes.inliers[:2]) > 20
    alike, votes = associate(Orb(), scene(1), BOXES[0], scene(1, 1, 12), BOXES, config("all"))
    assert alike is None
    assert sum(votes.inliers) < 12  # the ratio test finds everything twice


@pytest.mark.parametrize("scope", ["each", "all"])
def test_no_boxes_give_no_target(scope: Scope) -> None:
    assert associate(Orb(), scene(1), BOXES[0], scene(1), [], config(scope))[0] is None


@pytest.mark.parametrize(
    ("inliers", "needed", "lead", "chosen"),
    [
        ((), 1, 0, None),
        ((5, 9, 3), 6, 4, 1),
        ((5, 9, 3), 6, 5, None),
        ((5, 9, 3), 10, 1, None),
        ((0, 0), 0, 0, None),
    ],
)
def test_a_box_needs_enough_votes_and_a_lead(
    inliers: tuple[int, ...], needed: int, lead: int, chosen: int | None
) -> None:
    assert choose(inliers, needed, lead) == chosen
