"""The board that a command names, and its print."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import cv2
import numpy as np

from drivers.interfaces import PartError
from missions.ground.options.calibrate import BoardOptions, CalibrateBoardOptions
from missions.ground.run_folder import REMEDY, check_file
from path.arrays import Image
from path.calibration.board import Board, print_cells

INCH_M = 0.0254


def board_of(options: BoardOptions) -> Board:
    """Raise PartError naming the option that cannot be right."""
    match = re.fullmatch(r"(\d+)x(\d+)", options.squares)
    if match is None:
        raise PartError(
            f"--squares {options.squares!r} is no COLUMNSxROWS", "write for example --squares 10x7"
        )
    try:
        return Board(
            options.board,
            int(match[1]),
            int(match[2]),
            options.square_m,
            options.marker_m,
            options.dictionary,
            options.legacy,
        )
    except ValueError as error:
        raise PartError(
            f"the board: {error}", "see `path-handoff calibrate camera --help`"
        ) from error


def otherwise(board: Board) -> Board:
    """Return the board that one not found as named often is.

    Of the other ChArUco pattern, or counted by its inner corners.
    """
    if board.pattern == "charuco":
        return replace(board, legacy=not board.legacy)
    return replace(board, columns=board.columns + 1, rows=board.rows + 1)


def claim_same(file: Path, picture: Image) -> None:
    """Refuse to write a picture over a file that shows anything else. Raises PartError."""
    there = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) if file.exists() else picture
    if there is None or not np.array_equal(there, picture):
        raise PartError(f"{file} is there, and is another picture: it is not written over", REMEDY)


def draw_print(options: CalibrateBoardOptions, out: TextIO) -> int:
    """``path-handoff calibrate board``."""
    board = board_of(options)
    try:
        shades, cell_m = print_cells(board)
    except ValueError as error:
        raise PartError(
            f"the board: {error}", "make the marker three quarters of the square"
        ) from error
    dots = round(cell_m / INCH_M * options.dpi)
    if not 1 <= dots * max(shades.shape) <= 40_000:
        raise PartError(
            f"--dpi {options.dpi}: a cell would be {dots} dots", "300 to 1200 dpi suit a printer"
        )
    picture = np.kron(shades, np.ones((dots, dots), np.uint8))
    check_file(options.out)
    if not cv2.haveImageWriter(str(options.out)):
        raise PartError(
            f"{options.out}: a picture of this kind is not written", "name a .png file with --out"
        )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    claim_same(options.out, picture)
    if not cv2.imwrite(str(options.out), picture):
        raise PartError(
            f"cannot write {options.out}", "name a .png file in a folder that can be written"
        )
    printed_m = dots * INCH_M / options.dpi
    scale = printed_m / cell_m
    out.write(
        f"{options.out}: {board.text}, {picture.shape[1]} x {picture.shape[0]} dots at {options.dpi} dpi "
        f"({1000 * printed_m * shades.shape[1]:.1f} x {1000 * printed_m * shades.shape[0]:.1f} mm)\n"
        f"squares come out as {1000 * board.square_m * scale:.3f} mm. Print at 100 %, glue it to something flat, "
        "measure it, and tell the commands what you measured.\n"
    )
    return 0
