"""A camera, the poses of a board and the board's curl, all from the same views.

Glued paper is never quite flat. A curl of 0.2 mm over 200 mm moves corners by a few hundredths of a
pixel, the same way in all views, and the focal length by some tenths of a per cent, which neither
residuals nor a jackknife show. So the board's surface is a paraboloid, ``z = h (a x^2 + b x y + c
y^2)``: x, y are in half lengths ``h`` of its longer side, from its middle. Its three unknowns are
expected to be small, as far as the views do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from path.arrays import Array, Flags
from path.values import frozen

CURL_SIGMA = 0.005  # of a, b and c that is expected: 0.5 mm from the middle to the ends of 200 mm
# unknowns
CAMERA = 9
POSE = 6
CURL = 3
MOST_STEPS = 20
NOISES = 2  # times that the corners' noise is estimated
SETTLED = 1e-10  # relative change of the cost
DAMPING = 1e-6
STRONGEST = 1e6


@frozen(eq=False)
class BundleView:
    """One view: points of the board (n, 3), as printed, and where they are seen (n, 2) px."""

    points_o: Array
    corners_px: Array


@frozen(eq=False)
class Bundle:
    """A solved bundle.

    Attributes:
        camera: (9,) fx, fy, cx, cy, k1, k2, p1, p2, k3; ``sigmas``: their standard errors, 0 of
            those not solved for.
        curl: (3,) a, b, c.
    """

    camera: Array
    sigmas: Array
    curl: Array


def curled(
    points_o: Array,
    size_m: tuple[float, float],
    curl: Array,
) -> Array:
    """Points (n, 3) of a flat print of this width and height, on the surface of the curled one."""
    h = 0.5 * max(size_m)
    return points_o + np.column_stack(
        [np.zeros((len(points_o), 2)), h * _shapes(points_o, size_m) @ curl]
    )


def solve_bundle(
    views: Sequence[BundleView],
    size_m: tuple[float, float],
    camera: Array,
    poses: Sequence[tuple[Array, Array]],
    free: Flags,
    curl: Array,
) -> Bundle:
    """Least squares by Levenberg and Marquardt; of each step the poses are eliminated.

    Args:
        size_m: width and height of the print.
        camera: (9,) to start from. ``free``: (9,) which of it is solved for.
        poses: rotation vector and translation (3,) of each view to start from.
        curl: (3,) to start from.
    """
    state = _State(camera.copy(), [np.concatenate(pose) for pose in poses], curl.copy())
    count = sum(2 * len(view.points_o) for view in views)
    freedom = max(count - POSE * len(views) - int(free.sum()), 1)
    known = np.concatenate([free, np.ones(CURL, np.bool_)])
    sums = _sums(views, size_m, state)
    for _ in range(NOISES):
        noise = sums.cost / freedom
        state, sums = _settled(views, size_m, state, sums, noise, known)
    matrix, _ = _reduced(sums, sums.cost / freedom, 0.0)
    variances = sums.cost / freedom * np.diag(_scaled_inverse(matrix[np.ix_(known, known)]))
    sigmas = np.zeros(CAMERA + CURL)
    sigmas[known] = np.sqrt(np.maximum(variances, 0.0))
    return Bundle(state.camera, sigmas[:CAMERA], state.curl)


@frozen(eq=False)
class _State:
    camera: Array
    poses: list[Array]
    curl: Array


@frozen(eq=False)
class _Sums:
    """Normal equations: of the common unknowns (12), and of each view its pose's, what couples
    both, and gradients.
    """

    common: Array
    gradient: Array
    own: list[Array]
    coupled: list[Array]
    pulls: list[Array]
    cost: float


def _settled(
    views: Sequence[BundleView],
    size_m: tuple[float, float],
    state: _State,
    sums: _Sums,
    noise: float,
    known: Flags,
) -> tuple[_State, _Sums]:
    """The state of least cost, for corners of this variance."""
    damping = DAMPING
    for _ in range(MOST_STEPS):
        moved = _moved(state, sums, noise, known, damping)
        after = _sums(views, size_m, moved)
        gain = _cost(state, sums, noise) - _cost(moved, after, noise)
        if gain >= 0.0:
            settled = gain <= SETTLED * sums.cost
            state = moved
            sums = after
            damping = max(0.1 * damping, DAMPING)
            if settled:
                break
        else:
            damping *= 100.0
            if damping > STRONGEST:
                break
    return state, sums


def _shapes(points_o: Array, size_m: tuple[float, float]) -> Array:
    h = 0.5 * max(size_m)
    x, y = ((points_o[:, k] - 0.5 * size_m[k]) / h for k in (0, 1))
    return np.column_stack([x * x, x * y, y * y])


def _sums(
    views: Sequence[BundleView],
    size_m: tuple[float, float],
    state: _State,
) -> _Sums:
    fx, fy, cx, cy, *lens = state.camera
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    h = 0.5 * max(size_m)
    common = np.zeros((CAMERA + CURL, CAMERA + CURL))
    gradient = np.zeros(CAMERA + CURL)
    own: list[Array] = []
    coupled: list[Array] = []
    pulls: list[Array] = []
    cost = 0.0
    for view, pose in zip(views, state.poses, strict=True):
        shapes = _shapes(view.points_o, size_m)
        points = curled(view.points_o, size_m, state.curl)
        seen, slopes = cv2.projectPoints(points, pose[:3], pose[3:], matrix, np.array(lens))
        left = (view.corners_px - np.asarray(seen, np.float64).reshape(-1, 2)).ravel()
        slopes = np.asarray(slopes, np.float64)
        R, _ = cv2.Rodrigues(pose[:3])
        by_height = h * slopes[:, 3:6] @ np.asarray(R, np.float64)[:, 2]
        J = np.column_stack(
            [slopes[:, 6 : 6 + CAMERA], by_height[:, None] * np.repeat(shapes, 2, axis=0)]
        )
        P = slopes[:, :POSE]
        common += J.T @ J
        gradient += J.T @ left
        own.append(P.T @ P)
        coupled.append(J.T @ P)
        pulls.append(P.T @ left)
        cost += float(left @ left)
    return _Sums(common, gradient, own, coupled, pulls, cost)


def _cost(
    state: _State,
    sums: _Sums,
    noise: float,
) -> float:
    """With what is expected of the curl; ``noise``: variance of the corners, px^2."""
    return sums.cost + noise * float((state.curl**2).sum()) / CURL_SIGMA**2


def _reduced(
    sums: _Sums,
    noise: float,
    damping: float,
) -> tuple[Array, Array]:
    """Normal equations of the common unknowns alone, the poses eliminated."""
    matrix = sums.common.copy()
    gradient = sums.gradient.copy()
    matrix[CAMERA:, CAMERA:] += noise / CURL_SIGMA**2 * np.eye(CURL)
    for own, coupled, pull in zip(sums.own, sums.coupled, sums.pulls, strict=True):
        gain = np.linalg.solve(
            own + damping * np.diag(np.diag(own)), np.column_stack([coupled.T, pull])
        )
        matrix -= coupled @ gain[:, :-1]
        gradient -= coupled @ gain[:, -1]
    return matrix, gradient


def _moved(
    state: _State,
    sums: _Sums,
    noise: float,
    known: Flags,
    damping: float,
) -> _State:
    matrix, gradient = _reduced(sums, noise, damping)
    gradient[CAMERA:] -= noise / CURL_SIGMA**2 * state.curl
    matrix = matrix + damping * np.diag(np.diag(sums.common))
    step = np.zeros(CAMERA + CURL)
    step[known] = _scaled_inverse(matrix[np.ix_(known, known)]) @ gradient[known]
    poses = [
        pose + np.linalg.solve(own + damping * np.diag(np.diag(own)), pull - coupled.T @ step)
        for pose, own, coupled, pull in zip(
            state.poses,
            sums.own,
            sums.coupled,
            sums.pulls,
            strict=True,
        )
    ]
    return _State(state.camera + step[:CAMERA], poses, state.curl + step[CAMERA:])


def _scaled_inverse(matrix: Array) -> Array:
    """The inverse of a symmetric matrix whose unknowns have different units; of what is not known,
    0.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale[:, None] * np.linalg.pinv(scale[:, None] * matrix * scale, hermitian=True) * scale
