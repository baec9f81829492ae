"""The detectors of level ``sim`` against pictures of rendered frames, and the rules by which
pictures are counted.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.geometric.noise import ObservationNoise, noise_in
from hil.world.config import SceneName
from hil.world.detector import MEASURED, PERFECT, measured_on
from hil.world.snapshot import Snapshot, TargetKind
from path.messages import Role
from tests.drivers.detectors.test_yolox import WEIGHTS, needs_weights
from tests.hil.geometric.detector_films import (
    BEGINS_S,
    FAR_OFF_PX,
    FOLLOWED,
    RATE_HZ,
    DetectorFigures,
    SeenTarget,
    Walk,
    Watcher,
    detector_of,
    edge_noise,
    measured,
)

FOUND = SeenTarget(True, edges_px=(1.0, 2.0, 3.0, 4.0), height_px=200.0)


def missed(spell: int, left: int) -> SeenTarget:
    return SeenTarget(False, 1, spell=spell, left=left)


class Blind(Watcher):
    """Misses the target from one frame of a film to another, counted from the first picture."""

    def __init__(self, first: int, last: int) -> None:
        super().__init__(detector_of("car", None), Role.SENDER, 0, "plain")
        self._first, self._last = first, last

    def sees(self, moment: Snapshot) -> SeenTarget:
        return SeenTarget(
            not self._first <= round((moment.time_s - BEGINS_S) * RATE_HZ) <= self._last
        )


def test_spells_are_counted_once_each_and_in_frames_of_the_cameras() -> None:
    figures = DetectorFigures([[FOUND, missed(2, 1), missed(2, 2)], [FOUND, missed(6, 3)]])
    assert figures.recall[0] == pytest.approx(0.4)
    assert figures.false_positives[0] == pytest.approx(0.6)
    assert figures.spells.tolist() == [4.0, 4.0, 12.0]
    assert figures.mean_spell == pytest.approx(3.0 / (1.0 / 4.0 + 1.0 / 4.0 + 1.0 / 12.0))
    assert figures.mean_left == pytest.approx(4.0)
    assert figures.edges_px.tolist() == [[1.0, 2.0, 3.0, 4.0, 200.0]] * 2


def test_walks_that_differ_make_the_interval() -> None:
    alike, unlike = [[FOUND, missed(1, 1)]] * 8, [[FOUND, FOUND], [missed(1, 1), missed(1, 1)]] * 4
    assert DetectorFigures(alike).recall == (0.5, 0.0)
    share, half = DetectorFigures(unlike).recall
    assert (share, half) == (0.5, pytest.approx(1.96 * np.sqrt(0.25 / 7.0)))


def test_a_spell_is_followed_back_and_on_as_long_as_it_lasts() -> None:
    walk = Walk("car", 0)
    assert [Blind(-3, 5).spell(walk, 0, way) for way in (-1, 1)] == [3, 5]
    assert Blind(-3, 1000).spell(walk, 0, 1) == FOLLOWED


def test_an_edge_that_is_far_off_is_no_noise() -> None:
    edges = np.tile([1.0, -1.0, 2.0, 0.0], (104, 1))
    edges[:4, 1] += 12.0
    edges[:1, 1] += 10.0
    edges[4:6, 0] -= 30.0
    noise = edge_noise(edges)
    assert noise.bias_px.tolist() == [1.0, -1.0, 2.0, 0.0]
    assert (noise.cut_rate, noise.deep_cut_rate) == (4.0 / 104.0, 1.0 / 104.0)
    assert (noise.sigma_px.max(), noise.far_rate, noise.far_px) == (0.0, 0.02, 30.0)


def test_a_scene_in_which_none_was_measured_is_as_the_plain_one() -> None:
    assert measured_on("person", "dusk") == MEASURED["person", "plain"] != PERFECT
    assert noise_in("dusk") == noise_in("plain") == ObservationNoise() != noise_in("hall")


@pytest.mark.parametrize("kind", ["car", "drone"])
def test_the_colour_detector_misses_nothing_orange_on_the_plain_scene(kind: TargetKind) -> None:
    figures = measured(kind, "plain", [4], None, pictures=20)
    assert figures.recall[0] == MEASURED[kind, "plain"].recall
    assert figures.false_positives[0] == MEASURED[kind, "plain"].false_positives


@needs_weights
@pytest.mark.parametrize("scene", ["plain", "hall"])
def test_people_are_missed_and_boxed_about_as_on_rendered_frames(scene: SceneName) -> None:
    figures = measured("person", scene, range(40, 44), WEIGHTS[0], pictures=8, follow=False)
    assert figures.recall[0] == pytest.approx(MEASURED["person", scene].recall, abs=0.15)
    noise, drawn = edge_noise(figures.edges_px[:, :4]), noise_in(scene).people
    drawn_px = (drawn.bias_left_px, drawn.bias_top_px, drawn.bias_right_px, drawn.bias_bottom_px)
    assert np.abs(noise.bias_px - drawn_px).max() < 2.0
    assert drawn.edge_sigma_px / 1.5 < noise.sigma_px.mean() < drawn.edge_sigma_px * 1.5
    beyond = drawn.cut_rate * math.erfc(FAR_OFF_PX / drawn.cut_px / math.sqrt(2.0))
    assert noise.cut_rate == pytest.approx(beyond, abs=0.12)
