"""Boards as a camera sees them, with known truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.studio import Imaging, PlacedBoard, Stage, StudioSetup
from hil.studio import Studio
from path.calibration.board import Board, BoardView, print_cells
from path.camera import CameraModel
from path.geometry import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.rotation import exp

CAMERA = CameraModel(640, 480, 615.2, 615.9, 322.1, 241.3, (0.112, -0.236, 0.0006, -0.0004, 0.095))
CHARUCO = Board("charuco", 10, 7, 0.030, 0.0225)
CHESSBOARD = Board("chessboard", 9, 6, 0.030)
LEVEL = Pose(np.eye(3), np.zeros(3))
T_W_C = Pose(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.5]))


@dataclass(frozen=True, slots=True)
class Held:
    """How a board is held: distance, tilt, and which part of the image its middle may be in (share of each side)."""

    distance_m: tuple[float, float] = (0.40, 0.75)
    tilt_deg: tuple[float, float] = (0.0, 40.0)
    reach: float = 0.3


def poses(board: Board, held: Held, count: int, seed: int) -> Iterator[Pose]:
    """``T_c_o``, random."""
    rng = np.random.default_rng(seed)
    middle = 0.5 * board.square_m * np.array([board.columns, board.rows, 0.0])
    for _ in range(count):
        u, v = np.array([CAMERA.width, CAMERA.height]) * (0.5 + rng.uniform(-held.reach, held.reach, 2))
        x, y = CAMERA.ray(float(u), float(v))
        tilt, towards = math.radians(rng.uniform(*held.tilt_deg)), rng.uniform(0.0, 2.0 * math.pi)
        R = exp(np.array([math.cos(towards), math.sin(towards), 0.0]) * tilt) @ exp(
            np.array([0, 0, rng.uniform(-1, 1)])
        )
        yield Pose(R, np.array([x, y, 1.0]) * rng.uniform(*held.distance_m) - R @ middle)


def seen(board: Board, pose: Pose, sigma_px: float, rng: np.random.Generator, *, blur_px: float = 0.7) -> BoardView:
    """A view without an image: projected corners with noise, those inside the image."""
    corners = CAMERA.project(pose.apply(board.corners_o))
    inside = ((corners > 6.0) & (corners < np.array([CAMERA.width, CAMERA.height]) - 6.0)).all(axis=1)
    ids = np.flatnonzero(inside)
    noisy = corners[ids] + rng.normal(0.0, sigma_px, (len(ids), 2))
    return BoardView(ids, noisy, np.full(len(ids), sigma_px), blur_px)


def placed(board: Board, T_w_o: Pose) -> PlacedBoard:
    """The print, whose first cell is a border of one square."""
    shades, cell_m = print_cells(board)
    corner = Pose(np.eye(3), np.array([-board.square_m, -board.square_m, 0.0]))
    return PlacedBoard(T_w_o @ corner, cell_m, shades)


def photographs(
    board: Board, where: list[Pose], seed: int, imaging: Imaging | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Colour images of a board at ``T_c_o``."""
    setup = StudioSetup(CAMERA, LEVEL, LEVEL, single_marker(), imaging=imaging or Imaging())
    studio = Studio(setup, seed)
    for number, T_c_o in enumerate(where):
        stage = Stage({Role.SENDER: T_W_C}, boards=(placed(board, T_W_C @ T_c_o),))
        yield studio.shoot(stage, Role.SENDER, number).color


def grey(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY), np.uint8)
