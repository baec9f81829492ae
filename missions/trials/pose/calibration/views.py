"""Boards before a camera, with known truth: how they are held, and what a renderer makes of
them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from flight.harness.renderer import (
    FrameRenderer,
    Imaging,
    PlacedBoard,
    RenderedInstant,
    RendererSetup,
)
from path.arrays import Image
from path.calibration.board import Board, print_cells
from path.camera.model import CameraModel
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.values import frozen

MOST_ROLL_RAD = 1.0
HERE = Pose(np.eye(3), np.zeros(3))
T_W_C = Pose(
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.5])
)
"""The camera, 1.5 m high, level."""


@frozen
class Held:
    """The pose of a board: distance, tilt, and how far from the image's middle its own may be
    (share of each side).
    """

    distance_m: tuple[float, float] = (0.40, 0.75)
    tilt_deg: tuple[float, float] = (0.0, 40.0)
    reach: float = 0.3


def board_poses(
    camera: CameraModel,
    board: Board,
    held: Held,
    count: int,
    seed: int,
) -> Iterator[Pose]:
    """``T_c_o``, random."""
    rng = np.random.default_rng(seed)
    middle = 0.5 * board.square_m * np.array([board.columns, board.rows, 0.0])
    for _ in range(count):
        u, v = np.array([camera.width, camera.height]) * (
            0.5 + rng.uniform(-held.reach, held.reach, 2)
        )
        x, y = camera.ray(float(u), float(v))
        tilt = math.radians(rng.uniform(*held.tilt_deg))
        towards = rng.uniform(0.0, 2.0 * math.pi)
        tilted = exp(np.array([math.cos(towards), math.sin(towards), 0.0]) * tilt)
        R = tilted @ exp(np.array([0.0, 0.0, rng.uniform(-MOST_ROLL_RAD, MOST_ROLL_RAD)]))
        yield Pose(R, np.array([x, y, 1.0]) * rng.uniform(*held.distance_m) - R @ middle)


def placed(board: Board, T_w_o: Pose) -> PlacedBoard:
    """The print, which begins with a border of one square."""
    shades, cell_m = print_cells(board)
    corner = Pose(np.eye(3), np.array([-board.square_m, -board.square_m, 0.0]))
    return PlacedBoard(T_w_o @ corner, cell_m, shades)


def photographs(
    renderer: type[FrameRenderer],
    camera: CameraModel,
    board: Board,
    where: Sequence[Pose],
    seed: int,
    imaging: Imaging | None = None,
) -> Iterator[Image]:
    """Colour images of a board at ``T_c_o``."""
    setup = RendererSetup(camera, HERE, HERE, single_marker(), imaging=imaging or Imaging())
    made = renderer(setup, seed)
    for number, T_c_o in enumerate(where):
        stage = RenderedInstant({Role.SENDER: T_W_C}, boards=(placed(board, T_W_C @ T_c_o),))
        yield made.shoot(stage, Role.SENDER, number).color


def grey(color: Image) -> Image:
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY), np.uint8)
