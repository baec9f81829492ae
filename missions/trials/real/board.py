"""The true places of a board's corners in a photograph: its pose, and what lens and paper do beyond
it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from drivers.interfaces import PartError
from missions.field.calibrate.camera import solve_as_told
from missions.trials.real.corners import by_photometry, starts
from missions.trials.real.set import REMEDY, RealSet
from path.arrays import Array, Image
from path.calibration.board import find_board
from path.calibration.intrinsics import NotSolvable, matrices_of, pose_of_points
from path.calibration.thinned import seen_evenly
from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Matrix, Pose
from path.values import frozen

STEP_M = 1e-4  # of numerical derivatives on the board
# of a side, in a marker's own frame
MARKER_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
PASSES = 10
OUTLIER_PX = 0.3  # residuals beyond it count less and less in what all views have in common


@frozen(eq=False)
class Photograph:
    """One view: the board's reference corners found in it, (n, 3) metres and (n, 2) px."""

    name: str
    grey: Image
    points_o: Array
    corners_px: Array


@frozen(eq=False)
class BoardSeen:
    """A board's place in one photograph.

    Attributes:
        T_c_o: of the plane that fits best. ``bend``: (k, 2) px, coefficients of the polynomials of
            ``order`` in the board's coordinates about ``middle`` over ``reach`` by which the
            corners leave it.
        left_px: what neither explains of the reference corners, rms per axis. ``spread``: (k, k)
            px², the covariance of the coefficients of either axis that follows from it: how well
            the board's place is known.
    """

    camera: CameraModel
    T_c_o: Pose
    bend: Array
    order: int
    middle: Array
    reach: float
    left_px: float
    spread: Array

    def pixels(self, points_o: Array) -> Array:
        """Return the pixels of points (n, 3) of the board, (n, 2)."""
        smooth = _powers((points_o[:, :2] - self.middle) / self.reach, self.order) @ self.bend
        return self.camera.project(self.T_c_o.apply(points_o)) + smooth

    def doubt_px2(self, points_o: Array) -> Array:
        """The covariance (2 n, 2 n) of the pixels of points (n, 3), x and y by turns: of the truth
        itself.
        """
        smooth = _powers((points_o[:, :2] - self.middle) / self.reach, self.order)
        return np.asarray(np.kron(smooth @ self.spread @ smooth.T, np.eye(2)), np.float64)

    def pose_at(self, T_o_m: Pose) -> Pose:
        """``T_c_m`` on a flat board, when its rows were read: turned about the camera to where its
        middle is seen.

        A shutter that reads rows one after another sees parts of a board that moves at different
        times.
        """
        middle = T_o_m.t[None]
        places = np.concatenate(
            [self.camera.project(self.T_c_o.apply(middle)), self.pixels(middle)]
        )
        flat, there = (
            np.append(ray, 1.0) / math.hypot(*ray, 1.0) for ray in self.camera.rays(places)
        )
        turn = rotation.exp(np.cross(flat, there))
        T_c_m = self.T_c_o @ T_o_m
        return Pose(turn @ T_c_m.R, turn @ T_c_m.t)

    def pose_under(self, T_o_m: Pose, side_m: float) -> Pose:
        """``T_c_m`` of the surface under a marker of this side, where the board is not flat."""
        square = np.column_stack([side_m * MARKER_CORNERS, np.zeros(4)])
        start = self.T_c_o @ T_o_m
        pixels = self.pixels(T_o_m.apply(square))
        matrix, lens = matrices_of(self.camera)
        turn, _ = cv2.Rodrigues(start.R)
        turn, shift = cv2.solvePnPRefineLM(
            square,
            pixels,
            matrix,
            lens,
            turn,
            start.t.reshape(3, 1).copy(),
        )
        return Pose(
            rotation.exp(np.asarray(turn, np.float64).ravel()),
            np.asarray(shift, np.float64).ravel(),
        )

    def slopes(self, points_o: Array) -> Array:
        """Derivatives (n, 2, 2) of these pixels by x and y on the board, px / m."""
        here = self.pixels(points_o)
        along = [
            (self.pixels(points_o + STEP_M * np.eye(3)[axis]) - here) / STEP_M for axis in (0, 1)
        ]
        return np.stack(along, axis=-1)

    def rises(self, points_o: Array) -> Array:
        """Derivatives (n, 2) of these pixels by a height above the board, px / m."""
        above = points_o - STEP_M * np.eye(3)[2]
        here = self.camera.project(self.T_c_o.apply(points_o))
        return (self.camera.project(self.T_c_o.apply(above)) - here) / STEP_M


@frozen(eq=False)
class SetSeen:
    """All photographs of a set that show its board.

    Attributes:
        sigmas: relative standard errors of fx and fy and those of cx and cy in px, None when the
            camera was given.
        starts: of each view, corners good to a pixel, by id.
    """

    camera: CameraModel
    sigmas: tuple[float, float, float, float] | None
    photographs: tuple[Photograph, ...]
    boards: tuple[BoardSeen, ...]
    starts: tuple[dict[int, Matrix], ...]


def look_at_set(own: RealSet, images: Sequence[Path]) -> SetSeen:
    """Find the board in photographs, and its camera when the file names none. Raises PartError."""
    greys = [(file.name, read_grey(file)) for file in images]
    if own.board is None:
        return _look_at_grid(own, greys)
    found = [(name, grey, find_board(grey, own.board)) for name, grey in greys]
    seen = [(name, grey, view) for name, grey, view in found if view is not None]
    camera = _given(own, greys[0][1])
    if not seen or (len(seen) < 3 and camera is None):
        raise PartError(f"{own.name}: the board is found in {len(seen)} photographs", REMEDY)
    views = [view for _, _, view in seen]
    sigmas = None
    even = seen_evenly([grey for _, grey, _ in seen], views, own.board)
    views, thinning = (views, None) if even is None else even
    if camera is not None:
        camera = replace(camera, thinning=thinning)
        corners = [(view.ids, view.corners_px) for view in views]
    else:
        size = greys[0][1].shape[1], greys[0][1].shape[0]
        try:
            solution, _ = solve_as_told(views, own.board, size, thinning)
        except NotSolvable as error:
            raise PartError(f"{own.name}: {error}", REMEDY) from error
        if solution.camera is None:
            raise PartError(f"{own.name}: {solution.camera_problem}", "name a [camera]")
        camera = solution.camera
        s = solution.sigmas
        sigmas = (s[0] / camera.fx, s[1] / camera.fy, s[2], s[3])
        corners = [(view.ids, view.corners_px) for view in solution.views]
    shots = [
        Photograph(name, grey, own.board.corners_o[ids], corners_px)
        for (name, grey, _), (ids, corners_px) in zip(seen, corners, strict=True)
    ]
    boards = tuple(see_board(camera, shot, own.file.bend_order) for shot in shots)
    begun = tuple(starts(own, shot.grey) for shot in shots)
    return SetSeen(camera, sigmas, tuple(shots), boards, begun)


def read_grey(file: Path) -> Image:
    grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise PartError(f"{file}: no image that can be read", REMEDY)
    return np.asarray(grey, np.uint8)


def _look_at_grid(own: RealSet, greys: Sequence[tuple[str, Image]]) -> SetSeen:
    """A grid's own markers are its reference; their side is what fits best."""
    camera = _given(own, greys[0][1])
    assert camera is not None  # the file says so
    shots: list[Photograph] = []
    begun: list[dict[int, Matrix]] = []
    for name, grey in greys:
        start = starts(own, grey)
        found = by_photometry(own, grey, start, camera)
        if len(found) >= 2:
            points = np.concatenate([own.markers[i].corners_o for i in found])
            shots.append(
                Photograph(
                    name,
                    grey,
                    points,
                    np.concatenate([f.corners_px for f in found.values()]),
                )
            )
            begun.append(start)
    if not shots:
        raise PartError(f"{own.name}: no photograph shows the grid", REMEDY)
    side_m = own.file.side_m
    for _ in range(3):
        boards = tuple(see_board(camera, shot, own.file.bend_order) for shot in shots)
        side_m *= 1.0 + growth(
            [(s.corners_px, b, s.points_o) for s, b in zip(shots, boards, strict=True)]
        )
        shots = [
            Photograph(s.name, s.grey, _grown(s.points_o, side_m), s.corners_px) for s in shots
        ]
    boards = tuple(see_board(camera, shot, own.file.bend_order) for shot in shots)
    return SetSeen(camera, None, tuple(shots), boards, tuple(begun))


def _grown(corners_o: Array, side_m: float) -> Array:
    """Markers (4 n, 3) about their centres, with another side."""
    quads = corners_o.reshape(-1, 4, 3)
    middles = quads.mean(axis=1, keepdims=True)
    old = np.linalg.norm(quads[:, 1] - quads[:, 0], axis=1)[:, None, None]
    return (middles + (quads - middles) * side_m / old).reshape(-1, 3)


def growth(seen: Sequence[tuple[Array, BoardSeen, Array]]) -> float:
    """Return how much larger markers are than their corners (4 n, 3) say, relative; seen at (4 n,
    2) px.
    """
    errors = []
    pulls = []
    for corners_px, board, points_o in seen:
        quads = points_o.reshape(-1, 4, 3)
        out = (quads - quads.mean(axis=1, keepdims=True)).reshape(-1, 3)[:, :2]
        errors.append(corners_px - board.pixels(points_o))
        pulls.append(np.einsum("kij,kj->ki", board.slopes(points_o), out))
    return float(
        robust_solution(np.concatenate(pulls).reshape(-1, 1), np.concatenate(errors).ravel())[0]
    )


def robust_solution(design: Array, wanted: Array) -> Array:
    """Least squares in which what is far beyond ``OUTLIER_PX`` counts little."""
    weights = np.ones(len(wanted))
    solution = np.zeros(design.shape[1])
    for _ in range(PASSES):
        root = np.sqrt(weights)
        solution = np.asarray(
            np.linalg.lstsq(design * root[:, None], wanted * root, rcond=None)[0], np.float64
        )
        weights = 1.0 / (1.0 + ((wanted - design @ solution) / OUTLIER_PX) ** 2)
    return solution


def _given(own: RealSet, grey: Image) -> CameraModel | None:
    named = own.file.camera
    if named is None:
        return None
    height, width = grey.shape
    try:
        return CameraModel(width, height, named.fx, named.fy, named.cx, named.cy, named.distortion)
    except ValueError as error:
        raise PartError(f"{own.name}: camera: {error}", REMEDY) from error


def see_board(
    camera: CameraModel,
    shot: Photograph,
    order: int,
) -> BoardSeen:
    """The board's pose in one photograph, and its bend. Raises PartError."""
    try:
        pose, errors = pose_of_points(camera, shot.points_o, shot.corners_px)
    except NotSolvable as error:
        raise PartError(f"{shot.name}: {error}", REMEDY) from error
    flat = shot.points_o[:, :2]
    middle = flat.mean(axis=0)
    reach = float(np.ptp(flat, axis=0).max()) / 2.0
    smooth = _powers((flat - middle) / reach, order)
    bend = np.column_stack([robust_solution(smooth, errors[:, axis]) for axis in (0, 1)])
    left = errors - smooth @ bend
    free = max(left.size - 2 * smooth.shape[1], 1)
    variance = float((left**2).sum() / free)
    spread = np.asarray(variance * np.linalg.pinv(smooth.T @ smooth), np.float64)
    return BoardSeen(camera, pose, bend, order, middle, reach, math.sqrt(variance), spread)


def _powers(xy: Array, order: int) -> Array:
    x, y = xy.T
    return np.column_stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])
