"""The marker's pose in every frame of a film: what is written, and what is said where there is
none.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.calibration_file import CameraCalibration, CameraTable, Quality, write_calibration
from flight.command_end import CommandEnd
from missions.field.pose import run
from missions.ground.options.field import PoseOptions
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from tests.path.marker.scene import VGA, Optics, background, render

SIDE_M = 0.08
FRAMES = 4
FACING = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def course(number: int) -> Pose:
    """A marker that is turned well away from the line of sight, and goes to the right."""
    tilt = rotation.exp(np.array([0.0, 0.6, 0.0]))
    return Pose(tilt @ FACING, np.array([0.03 * number, 0.02, 0.8]))


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> PoseOptions:
    """A film of a marker with one frame without, and the calibration of its camera."""
    folder = tmp_path_factory.mktemp("film")
    rng = np.random.default_rng(3)
    ground = background(VGA, rng)
    layout = single_marker(SIDE_M, marker_id=7)
    for number in range(FRAMES):
        drawn = render(VGA, course(number), layout, rng, Optics(), ground)
        cv2.imwrite(str(folder / f"{number}.png"), drawn)
    empty = np.clip(ground, 0.0, 255.0).astype(np.uint8)
    cv2.imwrite(str(folder / f"{FRAMES}.png"), empty)
    table = CameraTable.of(VGA)
    quality = Quality(0.1, 0.1, 20, 400, 0.9)
    calibration = folder.parent / f"{folder.name}.toml"
    written = CameraCalibration("camera", 1, "2026-01-01", "", "", "", table, {}, quality)
    write_calibration(calibration, written)
    return PoseOptions(folder, calibration, side_mm=1000.0 * SIDE_M, marker=7)


def said(options: PoseOptions, code: int = 0) -> str:
    out = io.StringIO()
    assert run(options, out) == code
    return out.getvalue()


def test_every_frame_has_its_row_and_the_marker_is_where_it_is(
    shot: PoseOptions, tmp_path: Path
) -> None:
    text = said(replace(shot, out=tmp_path / "out"))
    assert f"5 frames, {FRAMES} with the marker" in text
    assert "1 no_marker" in text
    with (tmp_path / "out" / "pose.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == [f"{number}.png" for number in range(FRAMES + 1)]
    for number, row in enumerate(rows[:FRAMES]):
        found = [float(row[name]) for name in ("x_m", "y_m", "z_m")]
        sigma = [float(row[name]) for name in ("x_sigma_mm", "y_sigma_mm", "z_sigma_mm")]
        assert found == pytest.approx(course(number).t.tolist(), abs=0.004)
        assert all(0.0 < each < 10.0 for each in sigma)
        assert row["why"] == ""
    assert rows[-1]["why"] == "no_marker"
    assert rows[-1]["x_m"] == ""


def test_the_trajectory_is_the_cameras_seen_from_the_marker(
    shot: PoseOptions, tmp_path: Path
) -> None:
    said(replace(shot, out=tmp_path / "out"))
    rows = np.loadtxt(tmp_path / "out" / "camera.tum")
    assert rows.shape == (FRAMES, 8)
    assert np.diff(rows[:, 0]) == pytest.approx(1.0 / 30.0)
    for number, row in enumerate(rows):
        assert row[1:4] == pytest.approx(course(number).inverse().t, abs=0.004)


def test_the_axes_are_drawn_at_the_marker(shot: PoseOptions, tmp_path: Path) -> None:
    said(replace(shot, out=tmp_path / "out"))
    drawn = cv2.imread(str(tmp_path / "out" / "000000.jpg"))
    shot_as_it_was = cv2.imread(str(shot.frames / "0.png"))
    assert drawn is not None and shot_as_it_was is not None
    changed = np.abs(drawn.astype(int) - shot_as_it_was).max(axis=2) > 60
    middle = VGA.project(course(0).t[None])[0]
    rows, columns = np.nonzero(changed)
    assert math.hypot(columns.mean() - middle[0], rows.mean() - middle[1]) < 40.0


def test_where_another_marker_is_there_it_is_said(shot: PoseOptions) -> None:
    text = said(replace(shot, marker=3), CommandEnd.FAILED.exit_code)
    assert "5 frames, 0 with the marker" in text
    assert "marker 7 of DICT_4X4_50 is there" in text


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"dictionary": "DICT_9X9_50"}, "DICT_9X9_50"),
        ({"marker": 50}, "no marker 50"),
        ({"frames": Path("gone.mp4")}, "there is no such file or folder"),
        ({"camera": Path("gone.toml")}, "gone.toml"),
    ],
)
def test_what_is_asked_wrongly_is_said(
    shot: PoseOptions, wrong: dict[str, object], told: str
) -> None:
    with pytest.raises(PartError, match=told):
        run(replace(shot, **wrong), io.StringIO())  # pyright: ignore[reportArgumentType]


def test_a_calibration_of_another_size_is_refused(shot: PoseOptions, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((90, 120, 3), np.uint8))
    with pytest.raises(PartError, match="120x90"):
        run(replace(shot, frames=tmp_path), io.StringIO())
