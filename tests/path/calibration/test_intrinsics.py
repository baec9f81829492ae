"""The camera comes out as it truly is, and how sure that is; sets that do not determine it are
refused by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from path.calibration.board import BoardView, find_board
from path.calibration.bundle import curled
from path.calibration.intrinsics import Intrinsics, left_by, solve_intrinsics
from path.calibration.judge import (
    BadSet,
    SetLimits,
    empty_places,
    judge_solution,
    judge_views,
    sharp_enough,
    uneven_pixels,
)
from path.camera.model import CameraModel
from tests.path.calibration.rendered import CAMERA, CHARUCO, Held, grey, photographs, poses, seen

SIZE = (CAMERA.width, CAMERA.height)
TRUE = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, *CAMERA.distortion])
NOISE_PX = 0.05
LIMITS = SetLimits()


def views(held: Held, count: int, seed: int, sigma_px: float = NOISE_PX) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    return [seen(CHARUCO, pose, sigma_px, rng) for pose in poses(CHARUCO, held, count, seed)]


def reasons(found: list[BoardView]) -> set[BadSet]:
    solution = solve_intrinsics(found, CHARUCO, SIZE)
    return {
        fault.reason
        for fault in (*judge_views(found, SIZE, LIMITS), *judge_solution(solution, LIMITS))
    }


def test_rendered_boards_give_the_focal_length_to_a_thousandth_and_predict_unseen_views() -> None:
    where = list(poses(CHARUCO, Held(), 15, 7))
    found = [find_board(grey(color), CHARUCO) for color in photographs(CHARUCO, where, 7)]
    good = [view for view in found if view is not None]
    assert len(good) == 15
    solution = solve_intrinsics(good, CHARUCO, SIZE)
    off = np.array(solution.values) - TRUE
    assert np.abs(off[:2] / TRUE[:2]).max() < 0.001
    assert np.abs(off[2:4]).max() < 0.3
    floor_px = left_by(CAMERA, good, CHARUCO)
    assert solution.held_out_px == pytest.approx(floor_px, rel=0.1)
    assert judge_views(good, SIZE, LIMITS) == []
    assert judge_solution(solution, LIMITS) == []


def test_standard_errors_are_the_errors_there_are() -> None:
    ratios: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
    for seed in range(3):
        solution = solve_intrinsics(views(Held(), 15, seed), CHARUCO, SIZE)
        ratios.append((np.array(solution.values) - TRUE) / np.array(solution.sigmas))
        together = np.sqrt((np.array(solution.doubts) ** 2).sum(axis=0))
        assert (together[:4] >= 0.999 * np.array(solution.sigmas[:4])).all()
        pixels = np.array([[20.0, 20.0], [SIZE[0] - 20.0, 20.0], [0.5 * SIZE[0], SIZE[1] - 20.0]])
        assert solution.camera is not None
        rays = np.column_stack([solution.camera.rays(pixels), np.ones(3)])
        radial = np.isin(np.arange(9), (4, 5, 8))
        moved = [
            moved_by(solution.camera, np.where(radial, doubt, 0.0), rays)
            for doubt in solution.doubts
        ]
        apart = [
            moved_by(solution.camera, np.where(np.arange(9) == k, together, 0.0), rays)
            for k in np.flatnonzero(radial)
        ]
        # radial terms make up for each other: one by one they would move the corners of the image
        # by more
        assert np.linalg.norm(moved) < 0.7 * np.linalg.norm(apart)
    assert 0.3 < np.sqrt((np.array(ratios) ** 2).mean()) < 1.4


def moved_by(
    camera: CameraModel, change: Sequence[float] | np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    points_c: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:  # fmt: skip
    """By how many px points move in the image when the camera's numbers change."""
    before = np.array((camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion))
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (before + np.asarray(change, float)).tolist()
    other = CameraModel(camera.width, camera.height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    return other.project(points_c) - camera.project(points_c)


def test_the_residual_is_the_noise_and_corners_far_off_are_left_out() -> None:
    found = views(Held(), 16, 3)
    spoiled = found[4].corners_px.copy()
    spoiled[7] += (9.0, -4.0)
    found[4] = replace(found[4], corners_px=spoiled)
    solution = solve_intrinsics(found, CHARUCO, SIZE)
    assert [view.outliers for view in solution.views] == [0, 0, 0, 0, 1] + 11 * [0]
    assert solution.rms_px == pytest.approx(NOISE_PX * np.sqrt(2.0), rel=0.1)
    assert 1.0 < solution.held_out_px / solution.rms_px < 1.1


@pytest.mark.parametrize(
    ("held", "count", "reason"),
    [
        (Held(), 8, BadSet.TOO_FEW_VIEWS),
        (Held(tilt_deg=(0.0, 3.0)), 14, BadSet.NO_TILT),
        (Held(distance_m=(0.5, 0.52)), 14, BadSet.ONE_DISTANCE),
        (Held(distance_m=(0.9, 1.4), reach=0.05), 14, BadSet.CLUSTERED),
        (Held(distance_m=(0.9, 1.4), tilt_deg=(0.0, 3.0), reach=0.05), 14, BadSet.UNCERTAIN),
    ],
)
def test_a_set_that_does_not_determine_the_camera_is_refused(
    held: Held, count: int, reason: BadSet
) -> None:
    assert reason in reasons(views(held, count, 1))


def test_a_good_set_is_not() -> None:
    assert reasons(views(Held(), 25, 1)) == set()


def test_a_boards_curl_is_told_from_the_focal_length() -> None:
    """0.3 mm over 330: taken as flat, the camera is off by more than is stated, and nothing shows
    it.
    """
    rng = np.random.default_rng(5)
    size_m = (CHARUCO.columns * CHARUCO.square_m, CHARUCO.rows * CHARUCO.square_m)
    true_m = np.array([0.0003, 0.0, -0.0001])
    surface = curled(CHARUCO.corners_o, size_m, true_m / (0.5 * size_m[0]))
    bent: list[BoardView] = []
    for pose, flat in zip(poses(CHARUCO, Held(), 15, 5), views(Held(), 15, 5), strict=True):
        corners = CAMERA.project(pose.apply(surface))[flat.ids]
        bent.append(replace(flat, corners_px=corners + rng.normal(0.0, NOISE_PX, corners.shape)))
    solution = solve_intrinsics(bent, CHARUCO, SIZE)
    off = (np.array(solution.values) - TRUE) / np.array(solution.sigmas)
    assert np.abs(off[:4]).max() < 2.5
    assert solution.rms_px == pytest.approx(NOISE_PX * np.sqrt(2.0), rel=0.1)
    assert np.abs(np.array(solution.curl_m) - true_m).max() < 0.0001


def test_a_board_other_than_said_is_seen_in_the_residual() -> None:
    rng = np.random.default_rng(0)
    bent = [
        replace(view, corners_px=view.corners_px + rng.normal(0.0, 2.0, view.corners_px.shape))
        for view in views(Held(), 14, 2)
    ]
    assert BadSet.WRONG_BOARD in reasons(bent)


def test_a_camera_that_leaves_out_pixels_is_named() -> None:
    """Of every three columns one is where it should be, and two are off by some; corners follow
    them by halves.
    """
    even = views(Held(), 15, 2)
    off = np.array([0.1, -0.1, 0.0])
    uneven = [
        replace(view, corners_px=view.corners_px - off[np.round(view.corners_px).astype(int) % 3])
        for view in even
    ]
    period, off_px = uneven_pixels(solve_intrinsics(uneven, CHARUCO, SIZE))
    assert period == 3
    assert 0.05 < off_px < 0.12
    assert uneven_pixels(solve_intrinsics(even, CHARUCO, SIZE))[1] == 0.0
    assert reasons(uneven) == reasons(even) | {BadSet.UNEVEN_PIXELS}


def test_views_that_do_not_predict_each_other_are_refused() -> None:
    solution = solve_intrinsics(views(Held(), 16, 3), CHARUCO, SIZE)
    worse: Intrinsics = replace(solution, held_out_px=2.0 * solution.rms_px)
    assert [fault.reason for fault in judge_solution(worse, LIMITS)] == [BadSet.NOT_PREDICTIVE]


def test_blurred_views_are_those_far_from_the_sharpest() -> None:
    found = [replace(view, blur_px=0.7) for view in views(Held(), 6, 0)]
    found[2], found[5] = replace(found[2], blur_px=2.0), replace(found[5], blur_px=1.2)
    assert sharp_enough(found, LIMITS) == [True, True, False, True, True, True]
    assert sharp_enough([], LIMITS) == []


def test_empty_places_are_named() -> None:
    corner = BoardView(np.arange(2), np.array([[10.0, 10.0], [600.0, 250.0]]), np.ones(2), 0.7)
    empty = empty_places([corner], SIZE)
    assert "top left" not in empty
    assert "right" not in empty
    assert len(empty) == 7
