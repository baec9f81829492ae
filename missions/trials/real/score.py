"""One set of photographs, measured: corners by method, poses, and how honest what is stated about them is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from missions.trials.real.board import SetSeen, look_at_set
from missions.trials.real.corners import METHODS, corners_by
from missions.trials.real.errors import MethodPoses, measure_set
from missions.trials.real.poses import Poses, estimate_all, plate_tasks, single_tasks
from missions.trials.real.set import RealSet, read_set
from missions.trials.shared.statistics import Interval, bootstrap, mean, p95
from path.target import MAD_TO_SIGMA

SCORE_STREAM = 2
QUICK_IMAGES = 4
MEDIAN_OF = {8: 0.918, 6: 0.891}  # median of chi-square over its degrees of freedom, by these
THUMBNAIL_PX = 480

Array = NDArray[np.float64]
Groups = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SetTask:
    """One set to measure: its file, and what its paths are relative to."""

    file: Path
    photographs: Path | None
    seed: int
    quick: bool


@dataclass(frozen=True, slots=True)
class Figure95:
    """A figure with its 95 % interval; views are drawn together."""

    value: float
    interval: Interval

    def summary(self, name: str) -> dict[str, Any]:
        return {name: self.value, f"{name}_interval": list(self.interval)}

    def text(self, digits: int, scale: float = 1.0) -> str:
        low, high = (scale * end for end in self.interval)
        return f"{scale * self.value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


@dataclass(frozen=True, slots=True)
class CornerScore:
    """One method's corners: px per axis, with the print as the views show it, and with all markers printed alike."""

    found: int
    robust_px: Figure95
    nominal_px: float
    rms_px: float
    stated_px: float | None = None
    chi2: Figure95 | None = None

    def summary(self) -> dict[str, Any]:
        named = {"found": self.found, "nominal_px": self.nominal_px, "rms_px": self.rms_px}
        return {**self.robust_px.summary("robust_px"), **named}


@dataclass(frozen=True, slots=True)
class PoseScore:
    """Errors of D2's place in the marker's frame, of the rotation, and what was refused."""

    poses: int
    d2_mean_m: Figure95
    d2_median_m: Figure95
    d2_p95_m: Figure95
    rotation_median_deg: Figure95
    flips: int
    refused: dict[str, int]
    chi2: Figure95

    def summary(self) -> dict[str, Any]:
        return {
            "poses": self.poses,
            **self.d2_mean_m.summary("d2_mean_m"),
            **self.d2_median_m.summary("d2_median_m"),
            **self.d2_p95_m.summary("d2_p95_m"),
            **self.rotation_median_deg.summary("rotation_median_deg"),
            "flips": self.flips,
            "refused": self.refused,
            **self.chi2.summary("chi2_pose"),
        }


@dataclass(frozen=True, slots=True)
class SetScore:
    """A set.

    Attributes:
        images, views: photographs, and those that show the board. ``markers``: seen in all of them.
        board_px: residual of the board's own corners to pose and bend, median over views of the rms per axis.
        print_m: rms by which the printed corners are off, as all views show it; None when that cannot be told.
        poses: by what they rest on; empty on a chessboard. ``named``: what the fits called wrong, and how often.
        example: the photograph in the middle, for the page.
    """

    name: str
    images: int
    views: int
    markers: int
    side_px: float
    board_px: float
    print_m: float | None
    camera: tuple[float, float, float, float]
    camera_sigmas: tuple[float, float, float, float] | None
    corners: dict[str, CornerScore]
    poses: dict[str, PoseScore]
    named: dict[str, int]
    example: NDArray[np.uint8]

    def summary(self) -> dict[str, Any]:
        """The figures of single markers at the top, as ``docs/real.md`` names them."""
        own = self.corners.get("photometric")
        single = self.poses["single"].summary() if "single" in self.poses else {}
        chi2 = own.chi2.summary("chi2_corners") if own is not None and own.chi2 is not None else {}
        return {
            "images": self.images,
            "views": self.views,
            "markers": self.markers,
            "side_px": self.side_px,
            "board_px": self.board_px,
            "print_m": self.print_m,
            "camera": dict(zip(("fx", "fy", "cx", "cy"), self.camera, strict=True)),
            "camera_sigmas": self.camera_sigmas,
            **single,
            **chi2,
            "stated_px": None if own is None else own.stated_px,
            "corners": {name: score.summary() for name, score in self.corners.items()},
            "named_wrong": self.named,
            **{name: score.summary() for name, score in self.poses.items() if name != "single"},
        }


def score_set(task: SetTask) -> SetScore:
    """Measure one set. Raises PartError."""
    own = read_set(task.file, task.photographs)
    images = own.images[:: max(1, len(own.images) // QUICK_IMAGES)] if task.quick else own.images
    seen = look_at_set(own, images)
    measured: dict[str, MethodPoses] = {}
    for method in METHODS if own.markers else ():
        found = [
            corners_by(method, own, shot.grey, start, seen.camera)
            for shot, start in zip(seen.photographs, seen.starts, strict=True)
        ]
        measured[method] = measure_set(own, seen, found)
    measured = {name: some for name, some in measured.items() if some.seen}
    rng = np.random.default_rng([task.seed, SCORE_STREAM])
    camera = seen.camera
    best = measured.get("photometric")
    return SetScore(
        own.name,
        len(images),
        len(seen.photographs),
        0 if best is None else len(best.seen),
        math.nan if best is None else float(np.median([m.side_px for m in best.seen])),
        float(np.median([board.left_px for board in seen.boards])),
        None if best is None or not best.print_m else float(np.sqrt(np.mean(np.stack([*best.print_m.values()]) ** 2))),
        (camera.fx, camera.fy, camera.cx, camera.cy),
        seen.sigmas,
        {name: _corner_score(some, rng) for name, some in measured.items()},
        {} if best is None else _pose_scores(own, seen, best, task.seed, rng),
        {} if best is None else dict(Counter(wrong for marker in best.seen for wrong in marker.found.wrong)),
        _thumbnail(seen),
    )


def _corner_score(measured: MethodPoses, rng: np.random.Generator) -> CornerScore:
    groups = np.array([marker.view for marker in measured.seen])
    errors = np.stack([marker.error_px for marker in measured.seen])
    robust = _figure(errors, _robust, groups, rng)
    nominal = _robust(np.stack([marker.nominal_px for marker in measured.seen]))
    rms = math.sqrt(float(np.mean(errors**2)))
    chi2 = np.array([marker.chi2 for marker in measured.seen])
    if np.isnan(chi2).any():
        return CornerScore(len(measured.seen), robust, nominal, rms)
    traces = [float(np.trace(m.found.covariance_px2)) for m in measured.seen if m.found.covariance_px2 is not None]
    stated = math.sqrt(float(np.median(traces)) / 8.0)
    return CornerScore(len(measured.seen), robust, nominal, rms, stated, _honesty(chi2, 8, groups, rng))


def _pose_scores(
    own: RealSet, seen: SetSeen, measured: MethodPoses, seed: int, rng: np.random.Generator
) -> dict[str, PoseScore]:
    singles = single_tasks(own, seen, measured)
    found = {
        "single": estimate_all(own, seen.camera, singles, seed),
        "without_gravity": estimate_all(own, seen.camera, singles, seed, gravity=False),
        "perfect_corners": estimate_all(own, seen.camera, single_tasks(own, seen, measured, perfect=True), seed),
        "plate": estimate_all(own, seen.camera, plate_tasks(own, seen, measured), seed),
    }
    return {name: _pose_score(poses, rng) for name, poses in found.items() if poses.errors}


def _pose_score(poses: Poses, rng: np.random.Generator) -> PoseScore:
    groups = np.array([error.view for error in poses.errors])
    d2 = np.array([error.d2_m for error in poses.errors])
    turns = np.degrees([error.rotation_rad for error in poses.errors])
    return PoseScore(
        len(poses.errors),
        _figure(d2, mean, groups, rng),
        _figure(d2, _median, groups, rng),
        _figure(d2, p95, groups, rng),
        _figure(turns, _median, groups, rng),
        sum(error.flipped for error in poses.errors),
        poses.refused,
        _honesty(np.array([error.chi2 for error in poses.errors]), 6, groups, rng),
    )


def _honesty(chi2: Array, freedom: int, groups: Groups, rng: np.random.Generator) -> Figure95:
    """Median of chi-squares over their degrees of freedom, in units of what it is when the covariance is right."""
    return _figure(chi2 / MEDIAN_OF[freedom], _median, groups, rng)


def _figure(values: Array, statistic: Any, groups: Groups, rng: np.random.Generator) -> Figure95:
    together = groups if len(np.unique(groups)) > 2 else None
    return Figure95(statistic(values), bootstrap(values, statistic, rng, together))


def _median(values: Array) -> float:
    return float(np.median(values))


def _robust(errors: Array) -> float:
    return MAD_TO_SIGMA * float(np.median(np.abs(errors)))


def _thumbnail(seen: SetSeen) -> NDArray[np.uint8]:
    shot = seen.photographs[len(seen.photographs) // 2].grey
    scale = min(1.0, THUMBNAIL_PX / shot.shape[1])
    small: Sequence[Any] | Any = cv2.resize(shot, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)
