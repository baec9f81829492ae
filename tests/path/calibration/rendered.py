"""Boards as a camera sees them, with known truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from flight.harness.renderer import Imaging
from hil.camera.pictures import CameraRenderer
from missions.trials.pose.calibration import views as calibration_views
from missions.trials.pose.calibration.views import HERE as LEVEL
from missions.trials.pose.calibration.views import Held, grey, placed
from path.calibration.board import Board, BoardView
from path.camera.model import CameraModel
from path.geometry.transforms import Pose

__all__ = [
    "CAMERA",
    "CHARUCO",
    "CHESSBOARD",
    "LEVEL",
    "Held",
    "grey",
    "photographs",
    "placed",
    "poses",
    "seen",
]

CAMERA = CameraModel(640, 480, 615.2, 615.9, 322.1, 241.3, (0.112, -0.236, 0.0006, -0.0004, 0.095))
CHARUCO = Board("charuco", 10, 7, 0.030, 0.0225)
CHESSBOARD = Board("chessboard", 9, 6, 0.030)


def poses(board: Board, held: Held, count: int, seed: int) -> Iterator[Pose]:
    """``T_c_o``, random."""
    return calibration_views.board_poses(CAMERA, board, held, count, seed)


def photographs(
    board: Board, where: Sequence[Pose], seed: int, imaging: Imaging | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Colour images of a board at ``T_c_o``."""
    return calibration_views.photographs(CameraRenderer, CAMERA, board, where, seed, imaging)


def seen(
    board: Board, pose: Pose, sigma_px: float, rng: np.random.Generator, *, blur_px: float = 0.7
) -> BoardView:
    """A view without an image: projected corners with noise, those inside the image."""
    corners = CAMERA.project(pose.apply(board.corners_o))
    inside = ((corners > 6.0) & (corners < np.array([CAMERA.width, CAMERA.height]) - 6.0)).all(
        axis=1
    )
    ids = np.flatnonzero(inside)
    noisy = corners[ids] + rng.normal(0.0, sigma_px, (len(ids), 2))
    return BoardView(ids, noisy, np.full(len(ids), sigma_px), blur_px)
