"""Trying a detector on a recording: the boxes, the line of timings, and what is refused."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from missions.field.detect import Timing, run
from missions.ground.options.field import DetectOptions
from tests.drivers.detectors.onnx_graphs import bright_cells_network

ORANGE = (24, 118, 245)


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """An orange block on textured ground that moves by 4 px a frame; the last frame is empty."""
    folder = tmp_path / "film"
    folder.mkdir()
    ground = np.random.default_rng(0).integers(70, 130, (120, 160, 1), np.uint8).repeat(3, axis=2)
    for number in range(8):
        image = ground.copy()
        if number < 7:
            cv2.rectangle(image, (30 + 4 * number, 40), (59 + 4 * number, 59), ORANGE, -1)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


def said(options: DetectOptions) -> str:
    out = io.StringIO()
    assert run(options, out) == 0
    return out.getvalue()


def test_the_rigs_detector_finds_what_there_is_and_says_how_long_it_took(
    film: Path, tmp_path: Path
) -> None:
    text = said(DetectOptions(film, out=tmp_path / "out"))
    assert "8 frames, 7 with something, 7 boxes" in text
    assert "ColorDetector: " in text
    assert "ms of one core; 7 frames" in text
    with (tmp_path / "out" / "boxes.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == [f"{number}.png" for number in range(7)]
    assert float(rows[3]["x"]) == pytest.approx(41.5, abs=1.0)
    assert float(rows[3]["w"]) == pytest.approx(30.0, abs=1.5)
    assert float(rows[3]["stamp_s"]) == pytest.approx(0.1, abs=1e-6)
    assert len(list((tmp_path / "out").glob("*.jpg"))) == 8


def test_a_model_is_tried_without_a_rig_of_its_own(film: Path, tmp_path: Path) -> None:
    model = bright_cells_network(tmp_path / "bright.onnx", 160, 3)
    assert "YoloxDetector: " in said(DetectOptions(film, model=model, min_score=0.6))
    with pytest.raises(PartError, match="expected 3 names of classes"):
        run(DetectOptions(film, model=model, classes=("car",)), io.StringIO())


def test_what_is_asked_wrongly_is_said(film: Path, tmp_path: Path) -> None:
    with pytest.raises(PartError, match="there is no such file or folder"):
        run(DetectOptions(tmp_path / "gone.mp4"), io.StringIO())
    with pytest.raises(PartError, match="it has no detector"):
        run(DetectOptions(film, rig="sim"), io.StringIO())


def test_the_first_frame_does_not_count_in_the_timings() -> None:
    line = Timing((900.0, 10.0, 20.0, 30.0), (800.0, 8.0, 9.0, 10.0)).line("it")
    assert line.startswith("it: 20.0 ms median, 29.0 p95")
    assert line.endswith("(50 Hz); 9.0 ms of one core; 3 frames")
