"""The detectors of level ``sim`` against films of rendered frames, and the rules by which films are counted."""

from __future__ import annotations

import pytest

from hil.world.detector import MEASURED, PERFECT, measured_on
from hil.world.snapshot import TargetKind
from tests.drivers.detectors.test_yolox import WEIGHTS, needs_weights
from tests.hil.geometric.detector_films import FilmFrame, figures_of, measured

FOUND, MISSED = FilmFrame(True, (1.0, 2.0, 3.0, 4.0), 0), FilmFrame(False, None, 1)


def test_spells_are_counted_in_frames_of_the_cameras() -> None:
    figures = figures_of([[MISSED, MISSED, FOUND, FOUND, MISSED, FOUND], [FOUND, MISSED, MISSED, MISSED]])
    assert figures.recall == pytest.approx(0.4)
    assert figures.miss_frames == pytest.approx(2.0 * (2 + 1 + 3) / 3)
    assert figures.false_positives == pytest.approx(0.6)
    assert figures.bias_px.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_scene_in_which_none_was_measured_is_as_the_plain_one() -> None:
    assert measured_on("person", "dusk") == MEASURED["person", "plain"] != PERFECT


@pytest.mark.parametrize("kind", ["car", "drone"])
def test_the_colour_detector_misses_nothing_orange_on_the_plain_scene(kind: TargetKind) -> None:
    figures = measured(kind, "plain", [4], None, seconds=0.8)
    assert figures.recall == MEASURED[kind, "plain"].recall
    assert figures.false_positives == MEASURED[kind, "plain"].false_positives


@needs_weights
def test_people_are_missed_about_as_often_as_on_rendered_frames() -> None:
    figures = measured("person", "plain", range(40, 46), WEIGHTS[0], seconds=0.4)
    assert figures.recall == pytest.approx(MEASURED["person", "plain"].recall, abs=0.2)
