"""Corner methods on a photograph of a board of markers: a real camera and print, whose truth is the board itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from missions.trials.board.file import BoardPhotograph
from missions.trials.board.measure import Left, measure
from missions.trials.corners.methods import OPENCV, PIXEL_CENTRE, TITLES
from missions.trials.corners.score import calibration_text
from missions.trials.shared.statistics import Array, Interval, bootstrap, means, robust_sigma, robust_sigmas, whitened
from missions.trials.shared.trial import TrialTable
from path.geometry.transforms import Matrix
from path.marker.detect import refine_corners

ENLARGED = 3
BOARD_STREAM = 5
BOARD_GOAL_PX = 0.10
FINER_ORDER = 6
PICTURE = "corners_board.png"


@dataclass(frozen=True, slots=True)
class Refinement:
    """One of OpenCV's, on the photograph enlarged ``scale`` times."""

    title: str
    flag: int
    scale: int = 1
    pixel_centre: float = 0.0


NATIVE = {
    "none": Refinement("cv2, not refined", cv2.aruco.CORNER_REFINE_NONE),
    "subpix": Refinement(TITLES["subpix"], cv2.aruco.CORNER_REFINE_SUBPIX),
    **{name: Refinement(TITLES[name], flag, 1, PIXEL_CENTRE[name]) for name, flag in OPENCV.items()},
}
BY_OPENCV = {
    **NATIVE,
    **{
        f"{name}_enlarged": Refinement(f"{own.title}, enlarged", own.flag, ENLARGED, own.pixel_centre)
        for name, own in NATIVE.items()
        if name != "none"
    },
}
START = "contour"
BOARD_TITLES = {**{name: own.title for name, own in BY_OPENCV.items()}, "photometric": TITLES["photometric"]}


@dataclass(frozen=True, slots=True)
class OnBoard:
    """One method on one photograph.

    Attributes:
        left: errors of the corners, of the markers ``ids``; corners_px: those found, (n, 4, 2).
        rms_px, robust_px: per axis; ``robust`` is 1.48 times the median size. ``interval_px``: of that, 95 %.
        finer_px: the robust one when lens and paper may be of sixth order.
        calibration: mean squared error in units of the stated covariance, None where none is stated; what the board's
            unknowns take of it is given back.
        stated_px: median stated standard deviation of a corner per axis.
    """

    left: Left
    ids: tuple[int, ...]
    corners_px: Array
    rms_px: float
    robust_px: float
    interval_px: Interval
    finer_px: float
    calibration: float | None = None
    calibration_interval: Interval | None = None
    stated_px: float | None = None

    @property
    def honesty(self) -> str:
        """The calibration as text, "" without one."""
        return calibration_text(self.calibration, self.calibration_interval)

    def summary(self) -> dict[str, Any]:
        own: dict[str, Any] = {
            "rms_px": self.rms_px,
            "robust_px": self.robust_px,
            "interval": list(self.interval_px),
            "finer_px": self.finer_px,
            "markers": len(self.ids),
            "side_m": self.left.side_m,
        }
        if self.calibration is not None and self.calibration_interval is not None:
            own |= {"calibration": self.calibration, "calibration_interval": list(self.calibration_interval)}
            own["stated_px"] = self.stated_px
        return own


Corners = dict[int, tuple[Matrix, Matrix | None]]
"""By id: corners (4, 2) and their covariance (8, 8), if any."""


def look_at(board: BoardPhotograph, seed: int) -> dict[str, OnBoard]:
    """Every method that finds at least half of the markers, by name."""
    found = {name: _by_opencv(board, refinement) for name, refinement in BY_OPENCV.items()}
    found["photometric"] = _photometric(board, found[START])
    return {name: _score(board, own, seed) for name, own in found.items() if 2 * len(own) >= len(board.patterns)}


def _by_opencv(board: BoardPhotograph, refinement: Refinement) -> Corners:
    parameters, scale = cv2.aruco.DetectorParameters(), refinement.scale
    parameters.cornerRefinementMethod = refinement.flag
    grey = board.grey
    if scale > 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    quads, ids, _ = cv2.aruco.ArucoDetector(board.dictionary, parameters).detectMarkers(grey)
    found: Corners = {}
    for quad, marker_id in zip(quads, np.ravel(ids) if quads else (), strict=True):
        if int(marker_id) in board.patterns:
            corners = np.asarray(quad, float).reshape(4, 2) - refinement.pixel_centre
            found[int(marker_id)] = ((corners + 0.5) / scale - 0.5, None)
    return found


def _photometric(board: BoardPhotograph, start: Corners) -> Corners:
    """The project's corners; markers at which it falls back to others count with those."""
    found: Corners = {}
    for marker_id, (quad, _) in start.items():
        pattern = board.patterns[marker_id]
        refined = refine_corners(board.grey, (0, 0), np.ascontiguousarray(quad), pattern, board.camera)
        if refined is not None:
            found[marker_id] = refined
    return found


def _score(board: BoardPhotograph, found: Corners, seed: int) -> OnBoard:
    ids = sorted(found)
    corners = np.stack([found[i][0] for i in ids])
    centres = np.stack([board.centres_m[i] for i in ids])
    left = measure(corners, centres, board.file.side_m, board.camera)
    rng = np.random.default_rng([seed, BOARD_STREAM])
    squares = [whitened(e, c) for e, i in zip(left.errors_px, ids, strict=True) if (c := found[i][1]) is not None]
    own = OnBoard(
        left,
        tuple(ids),
        corners,
        math.sqrt(float(np.mean(left.errors_px**2))),
        robust_sigma(left.errors_px),
        bootstrap(left.errors_px, robust_sigmas, rng),
        robust_sigma(measure(corners, centres, board.file.side_m, board.camera, FINER_ORDER).errors_px),
    )
    if not squares:
        return own
    sigmas = [math.sqrt(float(np.trace(c)) / 8.0) for i in ids if (c := found[i][1]) is not None]
    calibration = np.array(squares) * left.errors_px.size / (left.errors_px.size - left.fitted)
    return replace(
        own,
        calibration=float(calibration.mean()),
        calibration_interval=bootstrap(calibration, means, rng),
        stated_px=float(np.median(sigmas)),
    )


def board_table(board: BoardPhotograph, scores: Mapping[str, OnBoard]) -> TrialTable:
    rows = [
        (
            BOARD_TITLES[name],
            f"{own.rms_px:.3f}",
            f"{own.robust_px:.3f} ({own.interval_px[0]:.3f}–{own.interval_px[1]:.3f})",
            f"{own.finer_px:.3f}",
            " / ".join(f"{robust_sigma(own.left.errors_px[..., axis]):.3f}" for axis in (0, 1)),
            f"{1000.0 * own.left.side_m:.2f}",
            str(len(own.ids)),
            "" if own.stated_px is None else f"{own.stated_px:.3f}",
            own.honesty,
        )
        for name, own in scores.items()
    ]
    return TrialTable(
        f"Corners on the photograph {board.file.image.name}: what the best board leaves of them, px per axis",
        ("method", "rms", "robust", "sixth order", "along u / v", "side, mm", "markers", "stated", "error² / stated²"),
        tuple(rows),
        "One homography, the markers' side and polynomials of fourth order are fitted to all corners of a method. "
        "Robust: 1.48 times the median size, with 95 % over the markers. Enlarged: OpenCV sees the photograph "
        f"{ENLARGED} times larger. What paper and lens do beyond fourth order is in all figures but those "
        "in the column of sixth order.",
    )
