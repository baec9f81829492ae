"""Sets of views as people bring them: boards of every kind, cameras of every size, held with care
and without.

Each is to end in a calibration with a grade whose stated errors are true, or in a refusal that says
what is wrong. The camera has a sensor's mosaic, sharpening and compression, and the paper is
curled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from flight.harness.renderer import (
    REALISTIC,
    FrameRenderer,
    PlacedBoard,
    RenderedInstant,
    RendererSetup,
)
from missions.field.calibrate.board import otherwise
from missions.field.calibrate.camera import BadViews, Calibrated, calibrate
from missions.field.calibrate.collect import Collected
from missions.trials.pose.calibration.views import HERE, T_W_C, Held, board_poses, grey, placed
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict
from path.calibration.board import Board, find_board
from path.calibration.judge import BadSet
from path.camera.model import CameraModel
from path.geometry.rotation import exp
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.values import frozen

SAG_M = 0.0002  # of the middle of the curled print over its ends
WITHIN = 2.0  # stated standard errors
LENS = (0.112, -0.236, 0.0006, -0.0004, 0.095)
WIDE = Held()
NEAR_ONE_DISTANCE = Held(distance_m=(0.55, 0.60), tilt_deg=(0.0, 12.0), reach=0.2)
FLAT_ON = Held(distance_m=(0.50, 0.70), tilt_deg=(0.0, 2.0), reach=0.1)


@frozen
class ViewsKind:
    """One kind of a set of views.

    Attributes:
        named: the board as the person names it, None: as it is.
        refusal: why nothing can be made of it, None when there is to be a calibration.
        fault: what must be said of it though there is a calibration, if it must.
    """

    board: Board
    size: tuple[int, int]
    views: int
    held: Held = WIDE
    named: Board | None = None
    refusal: BadSet | None = None
    fault: BadSet | None = None


CHESSBOARD = Board("chessboard", 9, 7, 0.030)
SQUARE = Board("chessboard", 8, 8, 0.0254)
CHARUCO = Board("charuco", 8, 8, 0.0254, 0.01905)
FINE = Board("charuco", 10, 7, 0.030, 0.0225)
LEGACY = replace(CHARUCO, legacy=True)
KINDS: Mapping[str, ViewsKind] = {
    "chessboard 320x240, 20 views": ViewsKind(CHESSBOARD, (320, 240), 20),
    "chessboard 640x480, 25 views of one distance": ViewsKind(
        SQUARE,
        (640, 480),
        25,
        NEAR_ONE_DISTANCE,
    ),
    "chessboard 640x480, 30 views": ViewsKind(SQUARE, (640, 480), 30),
    "chessboard 960x720, 15 views, counted wrongly": ViewsKind(
        CHESSBOARD,
        (960, 720),
        15,
        named=replace(CHESSBOARD, columns=10),
        refusal=BadSet.NO_BOARD,
    ),
    "chessboard 1280x720, 12 views, its inner corners named": ViewsKind(
        CHESSBOARD,
        (1280, 720),
        12,
        named=replace(CHESSBOARD, columns=8, rows=6),
    ),
    "chessboard 1920x1080, 10 views": ViewsKind(CHESSBOARD, (1920, 1080), 10),
    "chessboard 640x480, 10 views, never tilted": ViewsKind(SQUARE, (640, 480), 10, FLAT_ON),
    "ChArUco 640x480, 17 views": ViewsKind(CHARUCO, (640, 480), 17),
    "ChArUco 640x480, old pattern, 20 views": ViewsKind(LEGACY, (640, 480), 20),
    "ChArUco 1280x720, old pattern named as new, 10 views": ViewsKind(
        LEGACY,
        (1280, 720),
        10,
        named=CHARUCO,
    ),
    "ChArUco 1280x720, 30 views of one distance": ViewsKind(
        CHARUCO,
        (1280, 720),
        30,
        NEAR_ONE_DISTANCE,
    ),
    "ChArUco 1920x1080, 12 views": ViewsKind(CHARUCO, (1920, 1080), 12),
    "ChArUco 640x480, 16 views, hardly tilted": ViewsKind(
        FINE,
        (640, 480),
        16,
        Held(tilt_deg=(0.0, 4.0)),
        fault=BadSet.NO_TILT,
    ),
    "ChArUco 640x480, 16 views of exactly one distance": ViewsKind(
        FINE,
        (640, 480),
        16,
        Held(distance_m=(0.5, 0.53)),
        fault=BadSet.ONE_DISTANCE,
    ),
    "ChArUco 640x480, 16 views, in the middle only": ViewsKind(
        FINE,
        (640, 480),
        16,
        Held(distance_m=(0.9, 1.2), reach=0.05),
        fault=BadSet.CLUSTERED,
    ),
    "ChArUco 640x480, 8 views": ViewsKind(FINE, (640, 480), 8, fault=BadSet.TOO_FEW_VIEWS),
}
QUICK = tuple(list(KINDS)[k] for k in (0, 3, 7))


@frozen
class KindResult:
    """The end of one set.

    Attributes:
        grade: None when it was refused. ``reasons``: what was said to be wrong.
        off: of fx, fy, cx and cy, in units of their stated errors; empty when refused.
        focal: the worse relative error of fx and fy, and the worse one stated.
        expected: whether it was refused, or not, as it should.
    """

    name: str
    grade: str | None
    reasons: tuple[str, ...]
    off: tuple[float, ...]
    focal: tuple[float, float]
    expected: bool

    @property
    def within(self) -> bool:
        return all(abs(each) <= WITHIN for each in self.off)

    def summary(self) -> dict[str, Any]:
        return {
            "grade": self.grade,
            "reasons": list(self.reasons),
            "as_expected": self.expected,
            "off_sigmas": list(self.off),
            "focal_off": self.focal[0],
            "focal_sigma": self.focal[1],
        }


def kind_findings(results: Sequence[KindResult]) -> list[TrialFinding]:
    right = sum(each.expected for each in results)
    graded = [each for each in results if each.off]
    within = sum(each.within for each in graded)
    return [
        TrialFinding("kinds of sets that end in a calibration or a refusal, and are told what is wrong, as they should",
                     f"{right} of {len(results)}", goal=f"{len(results)}", verdict=verdict(right == len(results))),
        TrialFinding("of those calibrated, fx, fy, cx and cy within two stated standard errors",
                     f"{within} of {len(graded)}", goal=f"{len(graded)}", verdict=verdict(within == len(graded))),
    ]  # fmt: skip


def kind_table(results: Sequence[KindResult]) -> TrialTable:
    rows = [
        (
            each.name,
            each.grade or "refused",
            ", ".join(dict.fromkeys(each.reasons)),
            f"{100.0 * each.focal[0]:.3f}" if each.off else "",
            f"{100.0 * each.focal[1]:.3f}" if each.off else "",
            " / ".join(f"{off:+.1f}" for off in each.off),
        )
        for each in results
    ]
    return TrialTable(
        "Sets of every kind, as the command takes them",
        (
            "set",
            "grade",
            "said to be wrong",
            "fx, fy off, %",
            "stated, %",
            "fx / fy / cx / cy off, stated errors",
        ),
        rows,
        f"Realistic imaging; the print is curled by {1e3 * SAG_M:g} mm, from its middle to its ends.",
    )


def calibrate_kind(renderer: type[FrameRenderer], name: str, seed: int) -> KindResult:
    """Shoot one set, and calibrate from it as the command does."""
    kind = KINDS[name]
    camera = camera_of(kind.size)
    images = _photographs(renderer, camera, kind, seed)
    named = kind.named or kind.board
    collected = _collected(images, named)
    if not any(look.view for look in collected.looks):
        again = _collected(images, otherwise(named))
        if any(look.view for look in again.looks):
            collected = again
            named = otherwise(named)
    try:
        done = calibrate(collected, named)
    except BadViews as refusal:
        reasons = tuple(fault.reason for fault in refusal.faults)
        right = (kind.refusal or kind.fault) in reasons
        return KindResult(
            name,
            None,
            tuple(r.value for r in reasons),
            (),
            (math.nan, math.nan),
            right,
        )
    told = kind.fault is None or kind.fault in (fault.reason for fault in done.faults)
    return _result(name, done, camera, kind.refusal is None and told)


def camera_of(size: tuple[int, int]) -> CameraModel:
    """An ordinary webcam's lens before a sensor of this size; its centre is not the image's."""
    width, height = size
    focal = 0.95 * width if 4 * height == 3 * width else 0.72 * width
    return CameraModel(
        width,
        height,
        focal,
        1.001 * focal,
        0.5 * width + 0.004 * width,
        0.5 * height - 0.003 * width,
        LENS,
    )


def _result(
    name: str,
    done: Calibrated,
    camera: CameraModel,
    expected: bool,
) -> KindResult:
    solution = done.solution
    truth = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    errors = np.array(solution.values[:4]) - truth
    sigmas = np.array(solution.sigmas[:4])
    focal = np.abs(errors[:2]) / truth[:2], sigmas[:2] / truth[:2]
    return KindResult(
        name,
        done.grade,
        tuple(fault.reason.value for fault in done.faults),
        tuple(float(each) for each in errors / sigmas),
        (float(focal[0].max()), float(focal[1].max())),
        expected,
    )


def _photographs(
    renderer: type[FrameRenderer],
    camera: CameraModel,
    kind: ViewsKind,
    seed: int,
) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    setup = RendererSetup(camera, HERE, HERE, single_marker(), imaging=REALISTIC)
    made = renderer(setup, seed)
    where = board_poses(camera, kind.board, kind.held, kind.views, seed)
    stages = (
        RenderedInstant({Role.SENDER: T_W_C}, boards=curled(kind.board, T_W_C @ T_c_o))
        for T_c_o in where
    )
    return [
        grey(made.shoot(stage, Role.SENDER, number).color) for number, stage in enumerate(stages)
    ]


def curled(
    board: Board,
    T_w_o: Pose,
    sag_m: float = SAG_M,
) -> tuple[PlacedBoard, ...]:
    """The print, curled about its y axis: strips that meet in the middles of squares, where no
    corner is.

    They lie on a circle; the board's frame is that of its middle.
    """
    flat = placed(board, T_w_o)
    columns = flat.print_shades.shape[1]
    per_square = columns // (board.columns + 2)
    seams = [0, *range(per_square // 2, columns, per_square), columns]
    if per_square < 2:  # a cell is a square
        flat = replace(
            flat,
            side_m=0.5 * flat.side_m,
            print_shades=np.kron(flat.print_shades, np.ones((2, 2), np.uint8)),
        )
        columns = 2 * columns
        seams = [0, *range(1, columns, 2), columns]
    radius_m = (columns * flat.side_m) ** 2 / (8.0 * sag_m)
    middle_m = 0.5 * columns * flat.side_m
    strips: list[PlacedBoard] = []
    for first, last in pairwise(seams):
        start, end = ((k * flat.side_m - middle_m) / radius_m for k in (first, last))
        turned = exp(np.array([0.0, -0.5 * (start + end), 0.0]))
        at = np.array(
            [middle_m + radius_m * math.sin(start), 0.0, radius_m * (1.0 - math.cos(start))]
        )
        strips.append(
            replace(
                flat,
                T_w_o=flat.T_w_o @ Pose(turned, at),
                print_shades=flat.print_shades[:, first:last],
            )
        )
    return tuple(strips)


def _collected(
    images: Sequence[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]], board: Board
) -> Collected:
    collected = Collected()
    for number, image in enumerate(images):
        collected.add(str(number), image, find_board(image, board))
    return collected
