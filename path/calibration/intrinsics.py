"""Intrinsics of a camera from views of a board: solved by OpenCV, held against views that were left
out.

Errors are of corners in the image, rms over corners of their distance in px (both axes together),
as OpenCV counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from path.arrays import Array, Flags, Whole
from path.calibration.board import Board, BoardView
from path.calibration.bundle import CURL, Bundle, BundleView, curled, solve_bundle
from path.camera.model import CameraModel, Coefficients, Nine
from path.camera.thinning import Thinning
from path.geometry.transforms import Pose
from path.values import frozen

FOLDS = 8
RADIAL = 3  # radial terms of the distortion
PRECISE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
OUTLIER = 6.0  # times the robust spread of all corners: such a corner is left out
MOST_OUTLIERS = 0.2  # of the corners of a view
MAD_TO_SIGMA = 1.4826
# parameters by which doubts are scaled: focal lengths and centre, which no others make up for
SCALED = 4
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


class NotSolvable(Exception):
    """The views do not determine a camera."""


@frozen(eq=False)
class SolvedView:
    """One view as the solution sees it.

    Attributes:
        T_c_o: board to camera.
        errors_px: (n, 2), image minus model. ``ids``: of its corners, outliers left out;
            ``outliers``: how many.
        held_out_px: rms when the camera was solved without this view and only its pose was fitted.
        distance_m: of the middle of what is seen of the board, along the optical axis.
    """

    T_c_o: Pose
    ids: Whole
    corners_px: Array
    errors_px: Array
    outliers: int
    held_out_px: float
    distance_m: float

    @property
    def rms_px(self) -> float:
        return rms(self.errors_px)


@frozen(eq=False)
class Intrinsics:
    """A solved camera.

    Attributes:
        values: of ``PARAMETERS``. ``camera``: the same as a model; None when they are none that can
            be inverted.
        sigmas: standard errors of ``PARAMETERS``, the larger of OpenCV's own and of a jackknife
            over groups of views.
        doubts: the same with what errs together, as ``CameraModel.doubts``: of views as were left
            out by turns, scaled to ``sigmas`` of focal lengths and centre where these are larger.
        rms_px, held_out_px: over all corners; held out: as ``SolvedView.held_out_px``.
        curl_m: of the board, as ``path.calibration.bundle``: by how much the ends of its x axis,
            its corners, and the ends of its y axis leave the plane, over half lengths of its longer
            side.
    """

    size: tuple[int, int]
    values: tuple[float, ...]
    camera: CameraModel | None
    camera_problem: str
    sigmas: tuple[float, ...]
    doubts: tuple[Nine, ...]
    views: tuple[SolvedView, ...]
    rms_px: float
    held_out_px: float
    curl_m: tuple[float, ...] = (0.0, 0.0, 0.0)


def rms(errors_px: Array) -> float:
    """Root of the mean squared distance of errors (n, 2)."""
    return math.sqrt(float((errors_px**2).sum(axis=1).mean())) if len(errors_px) else math.nan


def solve_intrinsics(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    radial: int = RADIAL,
    thinning: Thinning | None = None,
) -> Intrinsics:
    """Solve for the camera; corners that are far off are left out once, and the rest solved again.

    Args:
        views: at least three.
        size: width and height of the images.
        radial: how many radial terms the distortion has; the others are 0.
        thinning: with which the views were made, for the camera's model.

    Raises:
        NotSolvable: OpenCV finds no camera.
    """
    ids = [view.ids for view in views]
    corners = [view.corners_px for view in views]
    fixed = _fixed(radial)
    matrix, lens = _solve(ids, corners, board, size, fixed)
    errors = [
        _refit(matrix, lens, board.corners_o[i], c)[1] for i, c in zip(ids, corners, strict=True)
    ]
    lengths = np.linalg.norm(np.concatenate(errors), axis=1)
    limit = OUTLIER * MAD_TO_SIGMA * float(np.median(lengths))
    kept = [
        _near(matrix, lens, board.corners_o[i], c, limit) for i, c in zip(ids, corners, strict=True)
    ]
    ids = [i[k] for i, k in zip(ids, kept, strict=True)]
    corners = [c[k] for c, k in zip(corners, kept, strict=True)]
    matrix, lens = _solve(ids, corners, board, size, fixed, (matrix, lens))
    bundle = _bundle(ids, corners, board, radial, _values(matrix, lens), np.zeros(CURL))
    matrix, lens = _matrices(bundle.camera)
    held_out, turns = _folds(ids, corners, board, radial, bundle)
    solved: list[SolvedView] = []
    for i, c, k, out in zip(ids, corners, kept, held_out, strict=True):
        pose, left = _refit(matrix, lens, board.corners_o[i], c, _surface(board, i, bundle.curl))
        distance_m = float(pose.apply(board.corners_o[i]).mean(axis=0)[2])
        solved.append(SolvedView(pose, i, c, left, int((~k).sum()), rms(out), distance_m))
    jackknife = np.sqrt((turns**2).sum(axis=0)) if len(turns) else np.full(len(PARAMETERS), np.nan)
    sigmas = np.fmax(bundle.sigmas, jackknife)
    values = bundle.camera
    camera, problem = _model(values, size, thinning)
    return Intrinsics(
        size,
        tuple(float(v) for v in values),
        camera,
        problem,
        tuple(float(s) for s in sigmas),
        _doubts(turns, sigmas),
        tuple(solved),
        rms(np.concatenate([view.errors_px for view in solved])),
        rms(np.concatenate(held_out)),
        tuple(float(c) * 0.5 * max(_size_m(board)) for c in bundle.curl),
    )


def doubting(solution: Intrinsics) -> Intrinsics:
    """The solution of a weak set with wider errors: pixels are square, so what fx and fy differ by
    is error of both.

    The views of such a set can agree on a wrong camera, and then neither their residuals nor a
    jackknife shows it.
    """
    fx, fy = solution.values[:2]
    apart = math.sqrt(0.5) * abs(fx - fy)
    sigmas = (max(solution.sigmas[0], apart), max(solution.sigmas[1], apart), *solution.sigmas[2:])
    more = [math.sqrt(max(apart**2 - solution.sigmas[k] ** 2, 0.0)) for k in (0, 1)]
    none = 7 * (0.0,)
    doubts = (
        (*solution.doubts, (more[0], 0.0, *none), (0.0, more[1], *none))
        if any(more)
        else solution.doubts
    )
    return replace(solution, sigmas=sigmas, doubts=doubts)


def _doubts(turns: Array, sigmas: Array) -> tuple[Nine, ...]:
    """Common errors: deviations (k, 9) whose squares add up to the jackknife's, scaled to the
    standard errors.
    """
    rows = np.diag(np.where(np.arange(len(sigmas)) < SCALED, sigmas, 0.0))[:SCALED]
    if len(turns):
        own = np.sqrt((turns[:, :SCALED] ** 2).sum(axis=0))
        rows = turns * float(np.max(sigmas[:SCALED] / np.maximum(own, 1e-12)))
    return tuple(_nine(row) for row in rows)


def _nine(row: Array) -> Nine:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(v) for v in row)
    return fx, fy, cx, cy, k1, k2, p1, p2, k3


def left_by(camera: CameraModel, views: Sequence[BoardView], board: Board) -> float:
    """Return the residual of a given camera when only the views' poses are fitted, rms in px.

    With the true one: the noise.
    """
    matrix, lens = matrices_of(camera)
    return rms(
        np.concatenate(
            [_refit(matrix, lens, board.corners_o[v.ids], v.corners_px)[1] for v in views]
        )
    )


def board_pose(camera: CameraModel, board: Board, view: BoardView) -> tuple[Pose, Array]:
    """``T_c_o`` of one view, and its residuals, (n, 2) px. Raises NotSolvable."""
    return pose_of_points(camera, board.corners_o[view.ids], view.corners_px)


def pose_of_points(camera: CameraModel, points_o: Array, corners_px: Array) -> tuple[Pose, Array]:
    """``T_c_o`` of points in a plane, (n, 3) seen at (n, 2), and its residuals, (n, 2) px. Raises
    NotSolvable.
    """
    return _refit(*matrices_of(camera), points_o, corners_px)


def matrices_of(camera: CameraModel) -> tuple[Array, Array]:
    """Camera matrix (3, 3) and distortion (5,), as OpenCV takes them."""
    return _matrices(np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]))


def _matrices(values: Array) -> tuple[Array, Array]:
    """The same of the values of ``PARAMETERS``."""
    fx, fy, cx, cy = values[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), values[4:]


def _size_m(board: Board) -> tuple[float, float]:
    return board.columns * board.square_m, board.rows * board.square_m


def _surface(board: Board, ids: Whole, curl: Array) -> Array:
    return curled(board.corners_o[ids], _size_m(board), curl)


def _bundle(
    ids: Sequence[Whole],
    corners: Sequence[Array],
    board: Board,
    radial: int,
    values: Array,
    curl: Array,
) -> Bundle:
    """Camera and curl together, from a camera that is near."""
    matrix, lens = _matrices(values)
    poses: list[tuple[Array, Array]] = []
    for i, c in zip(ids, corners, strict=True):
        pose, _ = _refit(matrix, lens, board.corners_o[i], c, _surface(board, i, curl))
        turn, _ = cv2.Rodrigues(pose.R)
        poses.append((np.asarray(turn, np.float64).ravel(), pose.t))
    views = [BundleView(board.corners_o[i], c) for i, c in zip(ids, corners, strict=True)]
    free = np.array([True] * 4 + [True, radial > 1, True, True, radial > 2])
    return solve_bundle(views, _size_m(board), values, poses, free, curl)


def _solve(
    ids: Sequence[Whole],
    corners: Sequence[Array],
    board: Board,
    size: tuple[int, int],
    fixed: int,
    guess: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """Camera matrix and distortion (5,) of a flat board."""
    points = [board.corners_o[i].astype(np.float32) for i in ids]
    images = [c.astype(np.float32) for c in corners]
    flags = fixed if guess is None else fixed | cv2.CALIB_USE_INTRINSIC_GUESS
    matrix, lens = (np.eye(3), np.zeros(5)) if guess is None else (guess[0].copy(), guess[1].copy())
    try:
        _, matrix, lens, _, _ = cv2.calibrateCamera(
            points, images, size, matrix, lens, flags=flags, criteria=PRECISE
        )
    except cv2.error as error:
        raise NotSolvable(str(error).strip()) from error
    matrix = np.asarray(matrix, np.float64)
    lens = np.asarray(lens, np.float64).ravel()[:5]
    if not (
        np.isfinite(matrix).all()
        and np.isfinite(lens).all()
        and min(matrix[0, 0], matrix[1, 1]) > 0.0
    ):
        raise NotSolvable("the solution is not finite")
    return matrix, lens


def _folds(
    ids: Sequence[Whole],
    corners: Sequence[Array],
    board: Board,
    radial: int,
    whole: Bundle,
) -> tuple[list[Array], Array]:
    """Errors of each view under a camera solved without it; deviations of ``PARAMETERS`` by each
    fold, (k, 9).

    The squares of the deviations add up to the jackknife's variances; there are none of fewer than
    two folds.
    """
    count = len(ids)
    folds = min(FOLDS, count)
    held_out: list[Array] = [np.empty((0, 2))] * count
    found: list[Array] = []
    for fold in range(folds):
        rest = [k for k in range(count) if k % folds != fold]
        if len(rest) < 3:
            continue
        own = _bundle(
            [ids[k] for k in rest],
            [corners[k] for k in rest],
            board,
            radial,
            whole.camera,
            whole.curl,
        )
        found.append(own.camera)
        for k in range(fold, count, folds):
            surface = _surface(board, ids[k], own.curl)
            held_out[k] = _refit(
                *_matrices(own.camera), board.corners_o[ids[k]], corners[k], surface
            )[1]
    if len(found) < 2:
        return held_out, np.empty((0, len(PARAMETERS)))
    spread = np.stack(found) - np.mean(found, axis=0)
    return held_out, math.sqrt((len(found) - 1) / len(found)) * spread


def _fixed(radial: int) -> int:
    """OpenCV's flags that leave out the radial terms beyond the first ``radial``."""
    return (cv2.CALIB_FIX_K3 if radial < RADIAL else 0) | (
        cv2.CALIB_FIX_K2 if radial < RADIAL - 1 else 0
    )


def _near(matrix: Array, lens: Array, points_o: Array, corners_px: Array, limit_px: float) -> Flags:
    """Return which corners of a view fit it. The worst is left out, one at a time, as it pulls the
    others off.
    """
    kept = np.ones(len(corners_px), np.bool_)
    for _ in range(int(MOST_OUTLIERS * len(corners_px))):
        lengths = np.linalg.norm(_refit(matrix, lens, points_o[kept], corners_px[kept])[1], axis=1)
        worst = int(np.argmax(lengths))
        if lengths[worst] <= limit_px:
            break
        kept[np.flatnonzero(kept)[worst]] = False
    return kept


def _refit(
    matrix: Array, lens: Array, points_o: Array, corners_px: Array, surface_o: Array | None = None
) -> tuple[Pose, Array]:
    """Pose of a view under a given camera, and its residuals. Raises NotSolvable.

    Args:
        points_o: as printed, in a plane. ``surface_o``: where they are, when the board is curled.
    """
    at = points_o if surface_o is None else surface_o
    try:
        done, rotation, translation = cv2.solvePnP(
            points_o, corners_px, matrix, lens, flags=cv2.SOLVEPNP_IPPE
        )
        if done:
            rotation, translation = cv2.solvePnPRefineLM(
                at, corners_px, matrix, lens, rotation, translation, PRECISE
            )
    except cv2.error as error:
        raise NotSolvable(str(error).strip()) from error
    if not done:
        raise NotSolvable("a view has no pose")
    seen, _ = cv2.projectPoints(at, rotation, translation, matrix, lens)
    R, _ = cv2.Rodrigues(rotation)
    pose = Pose(np.asarray(R, np.float64), np.asarray(translation, np.float64).ravel())
    return pose, corners_px - np.asarray(seen, np.float64).reshape(-1, 2)


def _values(matrix: Array, lens: Array) -> Array:
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens])


def _model(
    values: Array, size: tuple[int, int], thinning: Thinning | None
) -> tuple[CameraModel | None, str]:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(v) for v in values)
    lens: Coefficients = (k1, k2, p1, p2, k3)
    try:
        return CameraModel(*size, fx, fy, cx, cy, lens, thinning=thinning), ""
    except ValueError as error:
        return None, str(error)
