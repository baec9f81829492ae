"""Corners of boards on rendered images with known truth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from flight.harness.renderer import IDEAL, REALISTIC, Imaging
from hil.camera.pictures import CameraRenderer
from missions.trials.pose.calibration.views import board_poses
from missions.trials.pose.calibration.views import photographs as shoot
from path.calibration.board import Board, find_board, other_size, print_cells
from path.camera.model import CameraModel
from tests.path.calibration.rendered import (
    CAMERA,
    CHARUCO,
    CHESSBOARD,
    Held,
    grey,
    photographs,
    poses,
)

MOTION = replace(IDEAL, motion_px=(4.0, 2.0))


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=lambda b: b.pattern)
@pytest.mark.parametrize(
    ("imaging", "worst_px", "blur_px"),
    [(IDEAL, 0.012, 0.65), (REALISTIC, 0.04, 0.65), (MOTION, 0.015, 1.4)],
)
def test_corners_are_where_they_are(
    board: Board, imaging: Imaging, worst_px: float, blur_px: float
) -> None:
    """Also through sharpening, gamma and JPEG, and along a motion: the corner of a chessboard is
    symmetric.
    """
    where = list(poses(board, Held(reach=0.15), 2, 5))
    errors: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
    stated: list[float] = []
    for T_c_o, color in zip(where, photographs(board, where, 2, imaging), strict=True):
        view = find_board(grey(color), board)
        assert view is not None
        true = CAMERA.project(T_c_o.apply(board.corners_o))
        ids = view.ids
        if board.pattern == "chessboard":  # it may be found turned by half a turn
            forward, backward = (
                float(np.abs(view.corners_px - true[i]).max()) for i in (ids, ids[::-1])
            )
            ids = ids if forward < backward else ids[::-1]
        errors.append(view.corners_px - true[ids])
        stated.append(float((view.sigma_px**2).mean()))
        assert view.blur_px == pytest.approx(blur_px, rel=0.25)
    error = np.concatenate(errors)
    assert len(error) > 0.8 * 2 * len(board.corners_o)
    assert np.sqrt((error**2).mean()) < worst_px
    # OpenCV's own corners are off by 0.004 px here
    assert np.abs(error.mean(axis=0)).max() < 0.2 * worst_px
    assert 0.5 < np.mean(stated) / (error**2).mean() < 25.0  # never too sure


def test_of_a_charuco_board_a_part_is_enough_and_nothing_is_nothing() -> None:
    T_c_o = next(poses(CHARUCO, Held((0.3, 0.3), (10.0, 10.0), 0.0), 1, 0))
    color = next(photographs(CHARUCO, [T_c_o], 0))
    whole, half = (
        find_board(grey(color), CHARUCO),
        find_board(np.ascontiguousarray(grey(color)[:, :300]), CHARUCO),
    )
    assert whole is not None
    assert half is not None
    assert 10 < len(half.ids) < len(whole.ids)
    assert find_board(np.full((480, 640), 128, np.uint8), CHARUCO) is None
    assert find_board(np.full((48, 64), 128, np.uint8), CHESSBOARD) is None


def test_another_chessboard_is_told_by_its_size() -> None:
    T_c_o = next(poses(CHESSBOARD, Held((0.6, 0.6), (10.0, 10.0), 0.0), 1, 0))
    image = grey(next(photographs(CHESSBOARD, [T_c_o], 0)))
    size = other_size(image)
    assert size is not None
    assert np.abs(np.sort(size) - [6, 9]).max() <= 1
    assert other_size(np.full((48, 64), 128, np.uint8)) is None


def test_a_single_row_of_corners_is_no_chessboard(monkeypatch: pytest.MonkeyPatch) -> None:
    """As OpenCV found one at the edge of a view of another board."""
    row = np.linspace((10.0, 20.0), (50.0, 20.0), 5, dtype=np.float32).reshape(-1, 1, 2)

    def found(*_: object) -> tuple[bool, NDArray[np.float32], NDArray[np.uint8]]:
        return True, row, np.zeros((1, 5), np.uint8)

    monkeypatch.setattr(cv2, "findChessboardCornersSBWithMeta", found)
    assert other_size(np.full((48, 64), 128, np.uint8)) is None


@pytest.mark.parametrize(("height", "number"), [(720, 5), (540, 0)])
def test_corners_of_the_outermost_squares_are_not_counted(height: int, number: int) -> None:
    """OpenCV takes the outer corners of a dark row for another row of inner ones: of 9x7 squares it
    makes 9x8 here.
    """
    camera = CameraModel(960, height, 922.5, 922.5, 480.0, height / 2, CAMERA.distortion)
    board = Board("chessboard", 9, 7, 0.030)
    where = list(board_poses(camera, board, Held(reach=0.2), 6, 3))[number]
    image = grey(next(shoot(CameraRenderer, camera, board, [where], 1, REALISTIC)))
    size = other_size(image)
    assert size is not None
    assert sorted(size) == [7, 9]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"columns": 2}, "fewer than"),
        ({"square_m": -1.0}, "square_m"),
        ({"marker_m": 0.1}, "marker_m"),
        ({"dictionary": "DICT_9X9"}, "dictionary"),
        ({"columns": 30}, "too few markers"),
    ],
)
def test_a_board_that_cannot_be_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(CHARUCO, **change)  # type: ignore[arg-type]


def test_a_print_has_whole_cells_and_a_border() -> None:
    shades, cell_m = print_cells(CHARUCO)
    assert cell_m == pytest.approx(0.030 / 8)
    assert shades.shape == (9 * 8, 12 * 8)
    assert (shades[:8] == 255).all()
    assert shades[8, 8] == 0
    with pytest.raises(ValueError, match="no common cell"):
        print_cells(replace(CHARUCO, marker_m=0.02217))
