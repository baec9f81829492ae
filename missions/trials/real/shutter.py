"""A set without the motion while its images' rows were read, as the whole board tells it.

A board that moves is sheared by it: a shift in proportion to the row, two numbers in each view.
These and a pose are all that a homography has, so what else shears a view is taken out as well: it
is the most that knowing the motion could do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missions.trials.pose.corners.methods import FoundMarker
from missions.trials.real.board import BoardSeen, Photograph, SetSeen, robust_solution, see_board
from missions.trials.real.corners import Corners
from missions.trials.real.errors import MethodPoses, measure_set
from missions.trials.real.set import RealSet
from missions.trials.shared.statistics import rms
from path.arrays import Array
from path.geometry import rotation
from path.values import frozen

STEP = 1e-6  # of numerical derivatives, metres and radians
POSE_NUMBERS = 6


@frozen
class RowMotion:
    """The motion while rows are read, over all views of a set.

    Attributes:
        motion_px: while a whole image is read, rms over views and axes.
        pose_px, rows_px: what a pose leaves of the board's corners, and a pose with that motion:
            rms per axis, for the unknowns.
    """

    motion_px: float
    pose_px: float
    rows_px: float


def held_still(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses,
) -> tuple[SetSeen, MethodPoses, RowMotion]:
    """The set with all corners where they would be had every row been read at once."""
    fits = [
        _sheared(board, shot) for board, shot in zip(seen.boards, seen.photographs, strict=True)
    ]
    found: list[Corners] = [{} for _ in fits]
    for marker in measured.seen:
        moved = _still(marker.found.corners_px, seen, fits[marker.view][0])
        found[marker.view][marker.marker_id] = FoundMarker(
            moved,
            marker.found.covariance_px2,
            marker.found.wrong,
        )
    shots = tuple(
        replace(shot, corners_px=_still(shot.corners_px, seen, shear))
        for shot, (shear, _, _) in zip(seen.photographs, fits, strict=True)
    )
    boards = tuple(see_board(seen.camera, shot, own.file.bend_order) for shot in shots)
    still = replace(seen, photographs=shots, boards=boards)
    shears = np.stack([shear for shear, _, _ in fits])
    motion = RowMotion(
        rms(shears * seen.camera.height),
        _rms([pose for _, pose, _ in fits]),
        _rms([rows for _, _, rows in fits]),
    )
    return still, measure_set(own, still, found), motion


def _sheared(board: BoardSeen, shot: Photograph) -> tuple[Array, float, float]:
    """The shift (2,) by row, px / px, and the squares of what a pose leaves without it and with
    it.
    """
    camera = board.camera
    points = shot.points_o
    here = camera.project(board.T_c_o.apply(points))
    columns = [(camera.project(rotation.stepped(board.T_c_o, step).apply(points)) - here).ravel() / STEP
               for step in STEP * np.eye(POSE_NUMBERS)]  # fmt: skip
    row = here[:, 1] - camera.cy
    none = np.zeros(len(here))
    shifts = [np.column_stack(pair).ravel() for pair in ((row, none), (none, row))]
    errors = (shot.corners_px - here).ravel()
    designs = [np.column_stack(some) for some in (columns, columns + shifts)]
    solutions = [robust_solution(design, errors) for design in designs]
    pose, rows = (
        float(np.sum((errors - design @ solution) ** 2)) / max(len(errors) - design.shape[1], 1)
        for design, solution in zip(designs, solutions, strict=True)
    )
    return solutions[1][POSE_NUMBERS:], pose, rows


def _still(
    corners_px: Array,
    seen: SetSeen,
    shear: Array,
) -> Array:
    return corners_px - (corners_px[:, 1:] - seen.camera.cy) * shear


def _rms(squares: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(squares)))
