"""A photograph of a board in the trial of the corners: its file, its measure, and its place in the result."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from missions.trials.board.file import read_board
from missions.trials.board.measure import measure
from missions.trials.board.pictures import draw_board
from missions.trials.board.trial import BOARD_TITLES, BoardPhotograph, OnBoard, board_table, look_at
from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from tests.path.marker.scene import Optics, render

CAMERA = CameraModel(640, 480, 628.0, 628.0, 324.0, 240.0, (0.09, -0.2, 0.007, 0.003, 0.0))
ROWS, COLUMNS, PITCH_M, SIDE_M = 3, 4, 0.05, 0.041
TEXT = """
image = "board.png"
dictionary = "{dictionary}"
rows = 3
columns = 4
pitch_m = 0.05
side_m = 0.04
{more}
[camera]
fx = 628.0
fy = 628.0
cx = 324.0
cy = 240.0
distortion = [0.09, -0.2, 0.007, 0.003, 0.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    places = [(k % COLUMNS - 1.5, 1.0 - k // COLUMNS) for k in range(ROWS * COLUMNS)]
    markers = tuple(
        Marker(5 + k, SIDE_M, 0.0, Pose(np.eye(3), np.array([x * PITCH_M, y * PITCH_M, 0.0])))
        for k, (x, y) in enumerate(places)
    )
    layout = MarkerLayout(markers, "DICT_6X6_50")
    T_c_v = Pose(rotation.exp(np.array([math.pi - 0.3, 0.1, 0.2])), np.array([0.0, 0.0, 0.45]))
    rng = np.random.default_rng(1)
    paper = np.full((480, 640), 200.0)
    cv2.imwrite(
        str(folder / "board.png"), render(CAMERA, T_c_v, layout, rng, Optics(noise=3.0, shade=0.0, samples=6), paper)
    )
    (folder / "board.toml").write_text(TEXT.format(dictionary="DICT_6X6_50", more="first_id = 5"))
    storage = cv2.FileStorage(str(folder / "dictionary.yml"), cv2.FILE_STORAGE_WRITE)
    cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_50).writeDictionary(storage)
    storage.release()
    return folder


@pytest.fixture(scope="module")
def board(folder: Path) -> BoardPhotograph:
    return read_board(folder / "board.toml")


@pytest.fixture(scope="module")
def scores(board: BoardPhotograph) -> dict[str, OnBoard]:
    return look_at(board, 0)


def test_every_method_is_measured_and_the_photometric_one_is_best(scores: dict[str, OnBoard]) -> None:
    assert set(scores) == set(BOARD_TITLES)
    own = scores["photometric"]
    assert len(own.ids) == ROWS * COLUMNS
    assert own.robust_px < 0.03
    assert own.interval_px[0] <= own.robust_px <= own.interval_px[1]
    assert own.left.side_m == pytest.approx(SIDE_M, abs=2e-5)
    assert all(other.rms_px > 1.4 * own.rms_px for name, other in scores.items() if name != "photometric")


def test_the_stated_sigma_is_held_against_what_is_left(scores: dict[str, OnBoard]) -> None:
    own = scores["photometric"].summary()
    assert 0.1 < own["calibration"] < 2.0
    assert own["calibration_interval"][0] < own["calibration"] < own["calibration_interval"][1]
    assert 0.3 * own["rms_px"] < own["stated_px"] < 3.0 * own["rms_px"]
    assert "calibration" not in scores["subpix"].summary()


def test_table_and_picture(board: BoardPhotograph, scores: dict[str, OnBoard], tmp_path: Path) -> None:
    table = board_table(board, scores)
    assert [row[0] for row in table.rows] == list(BOARD_TITLES.values())
    assert all(len(row) == len(table.columns) for row in table.rows)
    draw_board(board, scores, tmp_path / "board.png")
    assert (tmp_path / "board.png").read_bytes()[:4] == b"\x89PNG"


def test_the_measure_takes_away_view_side_and_what_is_smooth_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    centres = np.array([[x, y] for y in range(6) for x in range(6)]) * 0.05
    corners = centres[:, None] + 0.0407 * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    world = np.concatenate([corners.reshape(-1, 2) - 0.125, np.full((144, 1), 0.0)], axis=1)
    T = Pose(rotation.exp(np.array([0.3, -0.2, 0.1])), np.array([0.0, 0.0, 0.6]))
    true_px = CAMERA.project(T.apply(world))
    x, y = world[:, 0] / 0.125, world[:, 1] / 0.125
    smooth = np.stack([0.8 * x**2 - 0.5 * x * y**3, 0.6 * y**4 + 0.2 * x], axis=1)
    exact = measure((true_px + smooth).reshape(-1, 4, 2), centres, 0.04, CAMERA)
    assert np.abs(exact.errors_px).max() < 0.02
    assert exact.side_m == pytest.approx(0.0407, abs=1e-4)
    noisy = measure((true_px + rng.normal(0.0, 0.1, true_px.shape)).reshape(-1, 4, 2), centres, 0.04, CAMERA)
    assert np.sqrt(np.mean(noisy.errors_px**2)) == pytest.approx(0.1 * math.sqrt(1.0 - 31.0 / 288.0), rel=0.1)


def test_a_dictionary_may_be_a_file(folder: Path, board: BoardPhotograph) -> None:
    (folder / "own.toml").write_text(TEXT.format(dictionary="dictionary.yml", more="first_id = 5"))
    again = read_board(folder / "own.toml")
    assert all(np.array_equal(again.patterns[i], pattern) for i, pattern in board.patterns.items())


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("rows = 3", "rows = 3\nrow = 3", "unknown key 'row'"),
        ("pitch_m = 0.05", "", "missing key 'pitch_m'"),
        ("pitch_m = 0.05", "pitch_m = 0.03", "leave no space"),
        ("rows = 3", "rows = 'three'", "rows"),
        ("rows = 3", "rows = 300", "first_id"),
        ("board.png", "other.png", "image"),
        ("DICT_6X6_50", "DICT_6X6", "dictionary"),
        ("fx = 628.0", "fx = -1.0", "camera"),
        ("[camera]", "[camera", "board"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(folder: Path, old: str, new: str, named: str) -> None:
    wrong = folder / "wrong_board.toml"
    wrong.write_text(TEXT.format(dictionary="DICT_6X6_50", more="first_id = 5").replace(old, new))
    with pytest.raises(PartError) as refused:
        read_board(wrong)
    assert "wrong_board.toml" in str(refused.value) and named in str(refused.value)
    assert "docs/evaluation.md" in refused.value.remedy


def test_a_missing_file_is_named(folder: Path) -> None:
    with pytest.raises(PartError, match=r"nowhere\.toml"):
        read_board(folder / "nowhere.toml")
