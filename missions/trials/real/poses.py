"""One marker's pose, or a plate's of two, held against the whole board's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from missions.trials.real.board import MARKER_CORNERS, BoardSeen, SetSeen
from missions.trials.real.errors import MethodPoses, SeenMarker, printed
from missions.trials.real.set import RealSet
from path.arrays import Array
from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Vec3
from path.observations import MarkerDetection, Missed
from path.values import frozen

POSE_STREAM = 1
NOISE_STREAM = 3
KNOWN_DEG = 0.01  # gravity that is known
FLIPPED_RAD = math.radians(10.0)
PERFECT_PX = 0.01  # stated deviation of corners that are the board's own
PLATE_SIDES = 3.5  # farthest apart that two markers of a plate are, in sides
ROW_SHARE = 0.2  # of a side, by which their heights may differ
ANY_DICTIONARY = "DICT_4X4_1000"  # of layouts whose markers are found already
TO_BOARD = np.array([1.0, 1.0, -1.0])  # heights are against the board's z
BOARD_TO_MARKER = np.diag([1.0, -1.0, -1.0])  # the board's y is down and its z away from the viewer

Gravity = Literal["stated", "known", "none"]
"""The knowledge of gravity: as the set says, exact, or none at all."""


@frozen
class PoseError:
    """One pose against the board's.

    Attributes:
        d2_m: error of the camera's place in the marker's frame, scaled to the marker that the set
            names.
        rotation_rad: angle between both poses. ``flipped``: the other planar solution is the right
            one.
        chi2: squared error of the pose over its covariance, per number.
    """

    view: int
    d2_m: float
    rotation_rad: float
    flipped: bool
    chi2: float


@frozen
class Poses:
    """Errors of what was estimated, and the reasons of what was refused."""

    errors: tuple[PoseError, ...]
    refused: dict[str, int]


@frozen(eq=False)
class PoseTask:
    """Markers of one view that make up a frame ``v``: what is known of their print, and the true
    pose.
    """

    view: int
    seen: tuple[MarkerDetection, ...]
    layout: MarkerLayout
    T_c_v: Pose
    scale: float


def single_tasks(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses,
    *,
    perfect: bool = False,
    squared: bool = False,
) -> list[PoseTask]:
    """Each marker on its own.

    Args:
        perfect: with the corners that the whole board gives it. ``squared``: with its own, as if it
            had been printed as a square.
    """
    tasks: list[PoseTask] = []
    for marker in measured.seen:
        board, (T_o_m, side_m) = (
            seen.boards[marker.view],
            _print_frame(own, measured, marker.marker_id),
        )
        found = (
            _perfect(own, seen, measured, marker)
            if perfect
            else _detection(own, measured, marker, squared)
        )
        if found is not None:
            tasks.append(
                _task(own, marker.view, board, (found,), {found.marker_id: (T_o_m, side_m)}, T_o_m)
            )
    return tasks


def plate_tasks(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses,
    *,
    squared: bool = False,
) -> list[PoseTask]:
    """Neighbours in a row as a plate of two; frame ``v`` is the left one's. ``squared``: as
    ``single_tasks``.
    """
    tasks: list[PoseTask] = []
    for view, board in enumerate(seen.boards):
        there = {m.marker_id: m for m in measured.seen if m.view == view}
        for marker_id, marker in there.items():
            other = _right_of(own, marker_id, there)
            if other is None:
                continue
            prints = {i: _print_frame(own, measured, i) for i in (marker_id, other)}
            found = [_detection(own, measured, one, squared) for one in (marker, there[other])]
            both = tuple(one for one in found if one is not None)
            if len(both) == 2:
                tasks.append(_task(own, view, board, both, prints, prints[marker_id][0]))
    return tasks


def as_stated(
    camera: CameraModel,
    tasks: Sequence[PoseTask],
    seed: int,
    share: float = 1.0,
) -> list[PoseTask]:
    """The same with corners that err by what is stated of them and nothing else: print, paper and
    motion are right.

    ``share``: of the stated deviations, of corners that are better.
    """
    rng = np.random.default_rng([seed, NOISE_STREAM])
    drawn: list[PoseTask] = []
    for task in tasks:
        places = {
            marker.id: camera.project(task.T_c_v.apply(marker.corners_v))
            for marker in task.layout.markers
        }
        stated = [replace(one, covariance_px2=share**2 * one.covariance_px2) for one in task.seen]
        draws = [
            rng.multivariate_normal(places[one.marker_id].ravel(), one.covariance_px2)
            for one in stated
        ]
        found = tuple(
            replace(one, corners_px=px.reshape(4, 2)) for one, px in zip(stated, draws, strict=True)
        )
        drawn.append(replace(task, seen=found))
    return drawn


def estimate_all(
    own: RealSet, camera: CameraModel, tasks: Sequence[PoseTask], seed: int, *, gravity: Gravity = "stated",
    shapely: bool = False,
) -> Poses:  # fmt: skip
    """Estimate every pose; gravity has an error of its own in each. ``shapely``: no marker is too
    wide or skewed.
    """
    rng = np.random.default_rng([seed, POSE_STREAM])
    sigma = math.radians(own.file.gravity_sigma_deg if gravity != "known" else KNOWN_DEG)
    errors: list[PoseError] = []
    refused: dict[str, int] = {}
    for task in tasks:
        down_v = np.array(own.file.down) / np.linalg.norm(own.file.down)
        down_c = rotation.exp(sigma * rng.standard_normal(3)) @ task.T_c_v.R @ down_v
        settings = PoseSettings(sigma / math.sqrt(2.0), sigma / math.sqrt(2.0), focal_sigma=0.0)
        known = (None, None) if gravity == "none" else (_vec3(down_v), _vec3(down_c))
        if gravity == "none":
            settings = PoseSettings(focal_sigma=0.0, max_ambiguity=1.0, max_sigma_m=math.inf)
        settings = replace(settings, shape_sigma=0.0) if shapely else settings
        pose = estimate_pose(task.seen, task.layout, camera, *known, settings)
        if isinstance(pose, Missed):
            refused[pose.reason.value] = refused.get(pose.reason.value, 0) + 1
        else:
            errors.append(_error(task, pose))
    return Poses(tuple(errors), refused)


def _error(task: PoseTask, pose: MarkerPose) -> PoseError:
    estimate = pose.T_c_v
    true = task.T_c_v
    d2_m = float(np.linalg.norm(estimate.inverse().t - true.inverse().t)) * task.scale
    turn = rotation.log(estimate.R @ true.R.T)
    off = np.concatenate([estimate.t - true.t, turn])
    angle = float(np.linalg.norm(turn))
    others = [
        rotation.angle_between(candidate.T_c_v.R, true.R) for candidate in pose.candidates[1:]
    ]
    flipped = angle > FLIPPED_RAD and any(other < angle for other in others)
    return PoseError(
        task.view,
        d2_m,
        angle,
        flipped,
        float(off @ np.linalg.solve(pose.covariance, off)) / len(off),
    )


def _task(
    own: RealSet, view: int, board: BoardSeen, found: tuple[MarkerDetection, ...],
    prints: Mapping[int, tuple[Pose, float]], T_o_v: Pose,
) -> PoseTask:  # fmt: skip
    markers = tuple(
        Marker(i, side_m, 0.0, T_o_v.inverse() @ T_o_m) for i, (T_o_m, side_m) in prints.items()
    )
    side_m = markers[0].side_m
    T_c_v = board.pose_at(T_o_v) if own.file.flat else board.pose_under(T_o_v, side_m)
    return PoseTask(
        view,
        found,
        MarkerLayout(markers, ANY_DICTIONARY),
        T_c_v,
        own.file.scaled_side_m / side_m,
    )


def _print_frame(
    own: RealSet,
    measured: MethodPoses,
    marker_id: int,
) -> tuple[Pose, float]:
    """Return the pose of a marker on the board as printed, and its mean side: what a ruler would
    tell.

    Of a sheet that is not flat it lies in the plane through the corners that is nearest to them.
    """
    corners = _printed_at(own, measured, marker_id)
    flat = corners[:, :2]
    middle = corners.mean(axis=0)
    side_m = float(np.mean(np.hypot(*(np.roll(flat, -1, axis=0) - flat).T)))
    x = flat[1] + flat[2] - flat[0] - flat[3]
    y = flat[2] + flat[3] - flat[0] - flat[1]
    angle = math.atan2(float(x[1] - y[0]), float(x[0] + y[1]))
    rise = np.linalg.lstsq(flat - middle[:2], corners[:, 2] - middle[2], rcond=None)[0]
    turn = rotation.exp(np.array([rise[1], -rise[0], 0.0])) @ rotation.exp(
        np.array([0.0, 0.0, angle])
    )
    return Pose(turn @ BOARD_TO_MARKER, middle), side_m


def _detection(
    own: RealSet,
    measured: MethodPoses,
    marker: SeenMarker,
    squared: bool,
) -> MarkerDetection | None:
    covariance = marker.found.covariance_px2
    corners = marker.found.corners_px
    if covariance is None:
        return None
    if squared:
        T_o_m, side_m = _print_frame(own, measured, marker.marker_id)
        square = T_o_m.apply(side_m * np.column_stack([MARKER_CORNERS, np.zeros(4)]))
        off = _printed_at(own, measured, marker.marker_id) - square
        corners = corners - np.einsum("kij,kj->ki", marker.slopes, off[:, :2])
    return MarkerDetection(marker.marker_id, corners, covariance)


def _printed_at(
    own: RealSet,
    measured: MethodPoses,
    marker_id: int,
) -> Array:
    """The corners (4, 3) of a marker on the board, as its views show it."""
    off = measured.print_m.get(marker_id, np.zeros((4, 3)))
    return printed(own, measured.growth, marker_id) + off * TO_BOARD


def _perfect(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses,
    marker: SeenMarker,
) -> MarkerDetection:
    """The corners as board and print tell them, almost without error."""
    corners = seen.boards[marker.view].pixels(_printed_at(own, measured, marker.marker_id))
    return MarkerDetection(marker.marker_id, corners, PERFECT_PX**2 * np.eye(8))


def _right_of(
    own: RealSet,
    marker_id: int,
    there: Mapping[int, SeenMarker],
) -> int | None:
    """The nearest marker of the same row to the right."""
    side = own.file.side_m
    here = own.markers[marker_id].corners_o.mean(axis=0)
    best: tuple[float, int] | None = None
    for other in there:
        x, y, _ = own.markers[other].corners_o.mean(axis=0) - here
        if (
            abs(y) < ROW_SHARE * side
            and side < x < PLATE_SIDES * side
            and (best is None or x < best[0])
        ):
            best = (float(x), other)
    return None if best is None else best[1]


def _vec3(v: Array) -> Vec3:
    return float(v[0]), float(v[1]), float(v[2])
