"""The trial of camera calibration from views of a board, on rendered boards whose camera is
known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from flight.harness.renderer import IDEAL, REALISTIC, REALISTIC_VIDEO, FrameRenderer, Imaging
from missions.ground.work import call
from missions.trials.pose.calibration.kinds import (
    KINDS,
    QUICK,
    calibrate_kind,
    kind_findings,
    kind_table,
)
from missions.trials.pose.calibration.views import Held, board_poses, grey, photographs
from missions.trials.shared.statistics import bootstrap, means, rms
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.calibration.board import Board, BoardView, find_board, find_corners
from path.calibration.intrinsics import left_by, solve_intrinsics
from path.camera.model import CameraModel
from path.values import frozen

TITLE = "Calibration from rendered boards: the camera that comes out against the one that is there"
PAPER = "Experimental Setup (a chessboard calibration; its accuracy is not evaluated there)"
NEEDS = ("renderer",)

CAMERA = CameraModel(1280, 720, 920.0, 919.0, 642.0, 358.0, (0.112, -0.236, 0.0006, -0.0004, 0.095))
QUICK_CAMERA = CameraModel(
    640,
    480,
    615.2,
    615.9,
    322.1,
    241.3,
    (0.112, -0.236, 0.0006, -0.0004, 0.095),
)
BOARDS = {
    "charuco": Board("charuco", 10, 7, 0.030, 0.0225),
    "chessboard": Board("chessboard", 10, 7, 0.030),
}
CONDITIONS: Mapping[str, Imaging] = {
    "ideal": IDEAL,
    "realistic": REALISTIC,
    "realistic_video": REALISTIC_VIDEO,
    "motion": replace(IDEAL, motion_px=(4.0, 2.0)),
}
SETS = 2
VIEWS = 20
QUICK_SETS = 1
QUICK_VIEWS = 13
FOCAL_GOAL = 0.001
HELD_OUT_GOAL = 0.10


@frozen
class SetResult:
    """The result of a set: errors of the corners (n, 2) px by method, relative ones of fx and fy,
    and the residuals.

    Attributes:
        normalised: errors of all nine parameters in units of their stated standard errors.
        floor_px: residual of the true camera on the same views.
    """

    board: str
    condition: str
    opencv_px: np.ndarray[Any, np.dtype[np.float64]]
    own_px: np.ndarray[Any, np.dtype[np.float64]]
    focal: tuple[float, float]
    centre_px: float
    normalised: np.ndarray[Any, np.dtype[np.float64]]
    held_out_px: float
    floor_px: float


def run(request: TrialRequest) -> TrialResult:
    camera = QUICK_CAMERA if request.quick else CAMERA
    sets, views = (QUICK_SETS, QUICK_VIEWS) if request.quick else (SETS, VIEWS)
    renderer = request.part("renderer")
    conditions = ("ideal", "realistic") if request.quick else tuple(CONDITIONS)
    kinds = QUICK if request.quick else tuple(KINDS)
    pieces = [
        partial(
            calibrate_set, renderer, camera, board, condition, 1000 * request.seed + number, views
        )
        for condition in conditions
        for board in BOARDS
        for number in range(sets)
    ]
    outcomes = request.work.map("sets of views", call, pieces)
    ends = request.work.map(
        "kinds of sets",
        call,
        [partial(calibrate_kind, renderer, kind, request.seed) for kind in kinds],
    )
    groups = {
        (c, b): [o for o in outcomes if (o.condition, o.board) == (c, b)]
        for c in conditions
        for b in BOARDS
    }
    findings = [*_focal_findings(outcomes, groups), *kind_findings(ends)]
    return TrialResult(
        summary={
            "camera": [camera.width, camera.height],
            "sets": sets,
            "views": views,
            "by_condition": {f"{c}/{b}": _summary(own) for (c, b), own in groups.items()},
            "kinds": {end.name: end.summary() for end in ends},
        },
        findings=findings,
        noise=_noise(),
        tables=(_table(groups, camera, sets, views), kind_table(ends)),
        notes=(
            "The lens that is calibrated is of the model that is fitted: what a real lens adds is not in these "
            "figures. Boards are flat, but in the sets of every kind.",
            "Held-out: each view's error when the camera was solved without it and only its pose was fitted; the noise "
            "floor is the same with the true camera.",
        ),
    )


def calibrate_set(
    renderer: type[FrameRenderer],
    camera: CameraModel,
    board_name: str,
    condition: str,
    seed: int,
    count: int,
) -> SetResult:
    """Shoot one set of so many views, and calibrate from it."""
    board = BOARDS[board_name]
    where = list(board_poses(camera, board, Held(), count, seed))
    images = photographs(renderer, camera, board, where, seed, CONDITIONS[condition])
    views: list[BoardView] = []
    own: list[np.ndarray[Any, np.dtype[np.float64]]] = []
    opencv: list[np.ndarray[Any, np.dtype[np.float64]]] = []
    for T_c_o, color in zip(where, images, strict=True):
        raw = find_corners(grey(color), board)
        view = find_board(grey(color), board)
        if raw is None or view is None:
            continue
        true = camera.project(T_c_o.apply(board.corners_o))
        # a chessboard, by half a turn
        turned = float(np.abs(view.corners_px - true[view.ids]).max()) > 20.0
        count = len(true) - 1
        own.append(view.corners_px - true[count - view.ids if turned else view.ids])
        opencv.append(raw.corners_px - true[count - raw.ids if turned else raw.ids])
        views.append(view)
    solution = solve_intrinsics(views, board, (camera.width, camera.height))
    truth = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    off = np.array(solution.values) - truth
    return SetResult(
        board_name,
        condition,
        np.concatenate(opencv),
        np.concatenate(own),
        (float(off[0] / camera.fx), float(off[1] / camera.fy)),
        float(np.abs(off[2:4]).max()),
        off / np.array(solution.sigmas),
        solution.held_out_px,
        left_by(camera, views, board),
    )


Groups = Mapping[tuple[str, str], Sequence[SetResult]]


def _focal_findings(outcomes: Sequence[SetResult], groups: Groups) -> list[TrialFinding]:
    findings: list[TrialFinding] = []
    for (condition, board), own in groups.items():
        worst = max(max(abs(f) for f in outcome.focal) for outcome in own)
        findings.append(
            TrialFinding(
                f"fx, fy off by at most, {board}, {condition}",
                f"{100.0 * worst:.3f} %",
                f"worst of {len(own)} sets",
                goal=f"≤ {100.0 * FOCAL_GOAL:g} %",
                verdict=verdict(worst <= FOCAL_GOAL),
            )
        )
    ratios = np.array([outcome.held_out_px / outcome.floor_px for outcome in outcomes])
    findings.append(
        TrialFinding(
            "held-out rms over the noise floor",
            f"{ratios.min():.3f} to {ratios.max():.3f}",
            f"all {len(ratios)} sets",
            goal=f"within {100.0 * HELD_OUT_GOAL:.0f} %",
            verdict=verdict(float(np.abs(ratios - 1.0).max()) <= HELD_OUT_GOAL),
        )
    )
    squares = np.array([float((outcome.normalised**2).mean()) for outcome in outcomes])
    low, high = bootstrap(squares, means, np.random.default_rng(0))
    findings.append(
        TrialFinding(
            "squared error of the parameters over the stated",
            f"{squares.mean():.2f}",
            f"{low:.2f} to {high:.2f}",
            note="1 is honest, below 1 careful.",
        )
    )
    return findings


def _summary(own: Sequence[SetResult]) -> dict[str, Any]:
    return {
        "focal_worst": max(max(abs(f) for f in outcome.focal) for outcome in own),
        "centre_worst_px": max(outcome.centre_px for outcome in own),
        "corner_rms_px": rms(np.concatenate([outcome.own_px for outcome in own])),
        "opencv_rms_px": rms(np.concatenate([outcome.opencv_px for outcome in own])),
        "corner_bias_px": np.concatenate([outcome.own_px for outcome in own]).mean(axis=0),
        "opencv_bias_px": np.concatenate([outcome.opencv_px for outcome in own]).mean(axis=0),
        "held_out_px": [outcome.held_out_px for outcome in own],
        "floor_px": [outcome.floor_px for outcome in own],
    }


def _table(
    groups: Groups,
    camera: CameraModel,
    sets: int,
    views: int,
) -> TrialTable:
    rows = [
        (
            f"{condition}, {board}",
            f"{rms(np.concatenate([o.opencv_px for o in own])):.4f}",
            " / ".join(
                f"{b:+.4f}" for b in np.concatenate([o.opencv_px for o in own]).mean(axis=0)
            ),
            f"{rms(np.concatenate([o.own_px for o in own])):.4f}",
            " / ".join(f"{b:+.4f}" for b in np.concatenate([o.own_px for o in own]).mean(axis=0)),
            f"{100.0 * max(max(abs(f) for f in o.focal) for o in own):.3f}",
            f"{max(o.centre_px for o in own):.2f}",
            f"{np.mean([o.held_out_px for o in own]):.4f}",
            f"{np.mean([o.floor_px for o in own]):.4f}",
        )
        for (condition, board), own in groups.items()
    ]
    return TrialTable(
        f"{sets} sets of {views} views at {camera.width}x{camera.height}: corners, px per axis, and the camera",
        ("", "OpenCV rms", "bias u / v", "fitted rms", "bias u / v", "worst fx, fy, %", "worst cx, cy, px",
         "held out, px", "floor, px"),
        rows,
        "OpenCV: CharucoDetector's corners, and findChessboardCornersSB's. Fitted: the image around each corner as a "
        "whole, from there on. Held out and floor: rms distance, both axes together.",
    )  # fmt: skip


def _noise() -> TrialTable:
    held = Held()
    return TrialTable(
        "Boards and cameras",
        ("what", "how much", "how it is applied"),
        (
            ("boards", "10x7 squares of 30 mm", "ChArUco with markers of 22.5 mm, DICT_4X4_50; chessboard"),
            ("distance, tilt", f"{held.distance_m[0]}–{held.distance_m[1]} m, {held.tilt_deg[0]:.0f}–"
             f"{held.tilt_deg[1]:.0f}°", "uniform; its middle in the middle 60 % of the image, rolled by up to 57°"),
            ("every camera", f"blur {IDEAL.blur_sigma_px} px", f"read noise {IDEAL.read_sigma} grey levels, shot noise "
             f"variance {IDEAL.shot_gain} per grey level, 8 bit"),
            ("realistic", "mosaic, gamma 2.2, sharpening, JPEG 90", "as a webcam; realistic_video: H.264 crf 23"),
            ("motion", "4.5 px", "along one line, during the exposure"),
        ),
    )  # fmt: skip
