"""A fisheye's views are told from those of a lens that Brown-Conrady describes, by the corners
alone.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from missions.field.calibrate.camera import BadViews, calibrate
from missions.field.calibrate.collect import Collected, CollectedImage
from path.calibration.board import Board, BoardView
from path.calibration.fisheye import fit_fisheye
from path.calibration.intrinsics import solve_intrinsics

BOARD = Board("charuco", 10, 7, 0.03, 0.0225)
SIZE = (1280, 720)


def views(
    focal_px: float, coefficients: tuple[float, ...], count: int, noise_px: float, seed: int
) -> list[BoardView]:
    """Corners of a board held everywhere before a camera: of a fisheye with four coefficients, else
    Brown-Conrady.
    """
    rng = np.random.default_rng(seed)
    K = np.array([[focal_px, 0.0, 639.5], [0.0, focal_px, 359.5], [0.0, 0.0, 1.0]])
    middle, k = BOARD.corners_o.mean(axis=0), np.array(coefficients)
    found: list[BoardView] = []
    while len(found) < count:
        R = cv2.Rodrigues(rng.uniform((-0.7, -0.7, -0.2), (0.7, 0.7, 0.2)))[0]
        away_m = rng.uniform(0.25, 0.7)
        reach = away_m * 0.6 / focal_px * np.array([640.0, 360.0])
        points = (BOARD.corners_o - middle) @ R.T + (*(rng.uniform(-1.0, 1.0, 2) * reach), away_m)
        if len(coefficients) == 4:
            flat = np.ascontiguousarray(points[None, :, :2] / points[None, :, 2:])
            seen = cv2.fisheye.distortPoints(flat, K, k)[0]
        else:
            seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, k)[0][:, 0]
        ids = np.flatnonzero(((seen > 4.0) & (seen < np.array(SIZE) - 5.0)).all(axis=1))
        if len(ids) >= 12:
            noisy = seen[ids] + noise_px * rng.standard_normal((len(ids), 2))
            found.append(BoardView(ids, noisy, np.full(len(ids), noise_px), 1.0))
    return found


def collected(seen: list[BoardView]) -> Collected:
    looks = [CollectedImage(f"{n}.png", SIZE, view, None) for n, view in enumerate(seen)]
    return Collected(looks)


@pytest.mark.parametrize("focal_px", [560.0, 450.0, 380.0])
def test_a_fisheye_is_refused_as_what_it_is(focal_px: float) -> None:
    seen = views(focal_px, (-0.02, 0.003, -0.002, 0.0005), 20, 0.05, 3)
    with pytest.raises(
        BadViews, match=rf"other_lens: the lens is a fisheye: .* \(fx {focal_px:.0f} px\)"
    ) as caught:
        calibrate(collected(seen), BOARD)
    assert "fisheyes are not flown with" in caught.value.remedy


@pytest.mark.parametrize(
    "coefficients",
    [(0.0,) * 5, (0.11, -0.23, 0.001, -0.0005, 0.09), (-0.3, 0.12, 0.0, 0.0, -0.02)],
    ids=["none", "D415", "barrel"],
)
@pytest.mark.parametrize("noise_px", [0.05, 0.2])
def test_a_lens_that_brown_conrady_describes_is_none(
    coefficients: tuple[float, ...], noise_px: float
) -> None:
    seen = views(800.0, coefficients, 20, noise_px, 4)
    fit = fit_fisheye(solve_intrinsics(seen, BOARD, SIZE), BOARD)
    assert fit is None or not fit.is_clear
    assert calibrate(collected(seen), BOARD).solution.values[0] == pytest.approx(800.0, rel=0.01)
