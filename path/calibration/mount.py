"""The pose of D1's camera in the marker's frame: ``T_v_c1`` from pairs of images of one board.

D1's camera sees the board; at the same time another camera sees the board and the marker. Board,
drone and the other camera may move from pair to pair, not within one. Everything is fitted at once:
``T_v_c1``, the size of the print, and in every pair where the board is for both cameras; so many
weak views of a small marker become one good one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from path.arrays import Array
from path.calibration.board import Board, BoardView
from path.calibration.intrinsics import NotSolvable, board_pose
from path.camera.model import CameraModel
from path.geometry.rotation import stepped
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.observations import MarkerDetection
from path.values import frozen

# T_v_c1 and the scale of the print; two poses of the board
GLOBAL = 7
OWN = 12
ITERATIONS = 12
STEP = 1e-6
CONVERGED = 1e-9
FARTHEST_STEP = 1.0  # m or rad: from there on there is no way back
LEAST_SIGMA_PX = 0.01


@frozen(eq=False)
class MountPair:
    """Two images of one moment: the board in D1's camera, the board and markers in the other
    one.
    """

    name: str
    board_1: BoardView
    board_3: BoardView
    markers_3: tuple[MarkerDetection, ...]


@frozen(eq=False)
class PairFit:
    """The residuals of one pair in the solution: rms of the marker's corners in px, and their
    chi-square per number.
    """

    name: str
    rms_px: float
    misfit: float


@frozen(eq=False)
class MountSolution:
    """
    Attributes:
        covariance: (6, 6) of (dt, dw) with ``t + dt``, ``exp(dw) R``: of ``T_v_c1``, metres and
            radians. The larger of what the corners' noise gives and of a jackknife over the pairs,
            by a common factor.
        misfit: chi-square of the marker's corners per degree of freedom; 1 when their covariance is
            right.
        side_scale, side_scale_sigma: size of the print over the stated one, from the images alone.
    """

    T_v_c1: Pose
    covariance: Array
    misfit: float
    side_scale: float
    side_scale_sigma: float
    pairs: tuple[PairFit, ...]


@dataclass(slots=True)
class _MountState:
    T_v_c1: Pose
    scale: float
    boards: list[tuple[Pose, Pose]]  # T_c1_o, T_c3_o


def solve_mount(
    pairs: Sequence[MountPair],
    camera_1: CameraModel,
    camera_3: CameraModel,
    board: Board,
    layout: MarkerLayout,
) -> MountSolution:
    """Fit everything to the corners of all pairs, at least two.

    Raises:
        NotSolvable: a board has no pose, or the pairs contradict each other too much.
    """
    poses_1 = [board_pose(camera_1, board, pair.board_1) for pair in pairs]
    poses_3 = [board_pose(camera_3, board, pair.board_3) for pair in pairs]
    sigma_1, sigma_3 = (
        max(
            LEAST_SIGMA_PX,
            math.sqrt(float((np.concatenate([left for _, left in poses]) ** 2).mean())),
        )
        for poses in (poses_1, poses_3)
    )
    state = _MountState(
        Pose(np.eye(3), np.zeros(3)),
        1.0,
        [(a, b) for (a, _), (b, _) in zip(poses_1, poses_3, strict=True)],
    )
    marker = [_marker_terms(pair, camera_3, layout) for pair in pairs]
    state.T_v_c1 = _first(pairs, state.boards, marker, camera_3, layout)
    terms = [
        (
            _board_term(pair.board_1, camera_1, board, sigma_1),
            _board_term(pair.board_3, camera_3, board, sigma_3),
            seen,
        )
        for pair, seen in zip(pairs, marker, strict=True)
    ]
    relative = max(m.side_sigma_m / m.side_m for m in layout.markers)
    prior = np.zeros((GLOBAL, GLOBAL))
    prior[6, 6] = 1.0 / max(relative, 1e-5) ** 2
    reduced: list[tuple[Array, Array]] = []
    for _ in range(ITERATIONS):
        reduced, own = _reduced(state, terms)
        pull = np.zeros(GLOBAL)
        pull[6] = prior[6, 6] * (1.0 - state.scale)
        step = _solved(
            sum((S for S, _ in reduced), prior.copy()), sum((g for _, g in reduced), pull)
        )
        if not np.all(np.abs(step) < FARTHEST_STEP):  # also when it is no number
            raise NotSolvable("the fit runs away")
        _move(state, step, own)
        if float(np.abs(step).max()) < CONVERGED:
            break
    return _solution(pairs, state, marker, _reduced(state, terms)[0], prior)


Residual = Callable[[Pose, Pose, Pose, float], Array]
"""Whitened residuals from T_v_c1, T_c1_o, T_c3_o and the scale of the print."""


def _board_term(
    view: BoardView,
    camera: CameraModel,
    board: Board,
    sigma_px: float,
) -> Callable[[Pose], Array]:
    points = board.corners_o[view.ids]

    def residual(T_c_o: Pose) -> Array:
        return ((view.corners_px - camera.project(T_c_o.apply(points))) / sigma_px).ravel()

    return residual


def _marker_terms(
    pair: MountPair,
    camera: CameraModel,
    layout: MarkerLayout,
) -> Residual:
    """Whitened residuals of all markers of a pair."""
    seen: list[tuple[Array, Array, Array]] = []
    for found in pair.markers_3:
        printed = layout.marker(found.marker_id)
        if printed is not None:
            seen.append((printed.corners_v, found.corners_px, _root(found.covariance_px2)))

    def residual(
        T_v_c1: Pose,
        T_c1_o: Pose,
        T_c3_o: Pose,
        scale: float,
    ) -> Array:
        T_c3_v = T_c3_o @ (T_v_c1 @ T_c1_o).inverse()
        left = [
            _solved(root, (corners - camera.project(T_c3_v.apply(scale * points))).ravel())
            for points, corners, root in seen
        ]
        return np.concatenate(left)

    return residual


def _first(
    pairs: Sequence[MountPair],
    boards: Sequence[tuple[Pose, Pose]],
    terms: Sequence[Residual],
    camera: CameraModel,
    layout: MarkerLayout,
) -> Pose:
    """Returns, of both planar poses of every marker, the one that fits all pairs best."""
    matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    lens = np.array(camera.distortion)
    best = Pose(np.eye(3), np.zeros(3))
    least = math.inf
    for pair, (T_c1_o, T_c3_o) in zip(pairs, boards, strict=True):
        for found in pair.markers_3:
            printed = layout.marker(found.marker_id)
            if printed is None:
                continue
            square = printed.T_v_m.inverse().apply(printed.corners_v)
            _, turns, places, _ = cv2.solvePnPGeneric(
                square,
                found.corners_px,
                matrix,
                lens,
                flags=cv2.SOLVEPNP_IPPE_SQUARE,
            )
            for turn, place in zip(turns, places, strict=True):
                T_c3_m = Pose(
                    np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(place, float).ravel()
                )
                T_v_c1 = (T_c3_m @ printed.T_v_m.inverse()).inverse() @ T_c3_o @ T_c1_o.inverse()
                left = [
                    np.abs(np.nan_to_num(term(T_v_c1, *own, 1.0), nan=1e6)).mean()
                    for term, own in zip(terms, boards, strict=True)
                ]
                misfit = float(np.median(left))
                if misfit < least:
                    best = T_v_c1
                    least = misfit
    return best


def _solved(matrix: Array, values: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, values), np.float64)


def _root(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance), np.float64)


_Terms = tuple[Callable[[Pose], Array], Callable[[Pose], Array], Residual]


def _reduced(
    state: _MountState, terms: Sequence[_Terms]
) -> tuple[list[tuple[Array, Array]], list[tuple[Array, Array, Array]]]:
    """Each pair's information and gradient about the global unknowns, its own eliminated; and what
    gives these back.
    """
    reduced: list[tuple[Array, Array]] = []
    own: list[tuple[Array, Array, Array]] = []
    for (T_c1_o, T_c3_o), (board_1, board_3, marker) in zip(state.boards, terms, strict=True):

        def residual(
            step: Array,
            one: Pose = T_c1_o,
            three: Pose = T_c3_o,
            terms_: _Terms = (board_1, board_3, marker),
        ) -> Array:
            a = stepped(one, step[GLOBAL : GLOBAL + 6])
            b = stepped(three, step[GLOBAL + 6 :])
            seen = terms_[2](stepped(state.T_v_c1, step[:6]), a, b, state.scale + float(step[6]))
            return np.concatenate((terms_[0](a), terms_[1](b), seen))

        left = residual(np.zeros(GLOBAL + OWN))
        steps = STEP * np.eye(GLOBAL + OWN)
        J = np.stack([(residual(s) - residual(-s)) / (2.0 * STEP) for s in steps], axis=1)
        H = J.T @ J
        g = -J.T @ left
        back = _solved(H[GLOBAL:, GLOBAL:], np.column_stack((H[GLOBAL:, :GLOBAL], g[GLOBAL:])))
        reduced.append((H[:GLOBAL, :GLOBAL] - H[:GLOBAL, GLOBAL:] @ back[:, :-1],
                        g[:GLOBAL] - H[:GLOBAL, GLOBAL:] @ back[:, -1]))  # fmt: skip
        own.append((back[:, :-1], back[:, -1], left))
    return reduced, own


def _move(
    state: _MountState,
    step: Array,
    own: Sequence[tuple[Array, Array, Array]],
) -> None:
    state.T_v_c1 = stepped(state.T_v_c1, step[:6])
    state.scale += float(step[6])
    for number, (slope, free, _) in enumerate(own):
        change = free - slope @ step
        one, three = state.boards[number]
        state.boards[number] = (stepped(one, change[:6]), stepped(three, change[6:]))


def _solution(
    pairs: Sequence[MountPair],
    state: _MountState,
    terms: Sequence[Residual],
    reduced: Sequence[tuple[Array, Array]],
    prior: Array,
) -> MountSolution:
    alone = sum((S for S, _ in reduced), np.zeros((GLOBAL, GLOBAL)))
    whole = alone + prior
    whitened = [
        term(state.T_v_c1, *own, state.scale) for term, own in zip(terms, state.boards, strict=True)
    ]
    numbers = sum(len(left) for left in whitened)
    misfit = float(sum(left @ left for left in whitened)) / max(numbers - GLOBAL, 1)
    covariance = _solved(whole, np.eye(GLOBAL))
    count = len(pairs)
    steps = np.stack([np.linalg.solve(whole - S, -g) for S, g in reduced])
    jackknife = (count - 1) / count * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0)
    factor = max(1.0, misfit, float(np.median(jackknife[:6] / covariance.diagonal()[:6])))
    fits = tuple(
        PairFit(pair.name, _marker_rms(left, pair), float(left @ left) / len(left))
        for pair, left in zip(pairs, whitened, strict=True)
    )
    side_sigma = math.sqrt(float(np.linalg.inv(alone)[6, 6]) * max(1.0, misfit))
    # where the images alone would have it
    free = np.linalg.solve(alone, -prior[:, 6] * (1.0 - state.scale))
    return MountSolution(
        state.T_v_c1,
        covariance[:6, :6] * factor,
        misfit,
        state.scale + float(free[6]),
        side_sigma,
        fits,
    )


def _marker_rms(whitened: Array, pair: MountPair) -> float:
    """Rms distance of the marker's corners in px."""
    roots = [_root(found.covariance_px2) for found in pair.markers_3]
    left = [root @ part for root, part in zip(roots, whitened.reshape(-1, 8), strict=False)]
    return math.sqrt(2.0 * float((np.concatenate(left) ** 2).mean()))
