"""The judgement of a set of views: what is wrong with it for calibration is named, each with what
to do.

Some sets determine a camera badly and still leave small residuals: the residuals alone say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Literal

import numpy as np

from path.arrays import Array, Whole
from path.calibration.board import BoardView
from path.calibration.intrinsics import Intrinsics
from path.values import frozen

Grade = Literal["good", "fair", "weak"]

PERIODS = (2, 3, 4, 5)  # px, of a camera that leaves out pixels
NO_CHANCE = 20.0
GRID = (8, 6)  # cells of the coverage map, across and down
PLACES = (
    ("top left", "top", "top right"),
    ("left", "middle", "right"),
    ("bottom left", "bottom", "bottom right"),
)


class BadSet(Enum):
    """A fault of a set of views. Values are stable: they are written and tested."""

    NO_BOARD = "no_board"
    MIXED_SIZES = "mixed_sizes"
    TOO_FEW_VIEWS = "too_few_views"
    BLURRED = "blurred"
    CLUSTERED = "clustered"
    ONE_DISTANCE = "one_distance"
    NO_TILT = "no_tilt"
    NOT_SOLVABLE = "not_solvable"
    UNCERTAIN = "uncertain"
    WRONG_BOARD = "wrong_board"
    NOT_PREDICTIVE = "not_predictive"
    UNEVEN_PIXELS = "uneven_pixels"
    OTHER_LENS = "other_lens"


@frozen
class SetFault:
    """One thing that is wrong with a set: what was found, and what to do."""

    reason: BadSet
    found: str
    fix: str


@frozen
class SetLimits:
    """Limits of a good set. A set that has less gives a calibration of a lower grade, as long as it
    says anything.

    Attributes:
        min_views: usable ones. ``fewest_views``: with less there is no calibration.
        max_blur_px: standard deviation of the blur across edges; and ``max_blur_ratio`` times that
            of the sharpest third of the views. Blurred views are left out.
        min_coverage: share of the ``GRID`` cells of the image with a corner.
        min_distance_ratio: of the farthest view to the nearest.
        min_tilt_span_deg: between the boards most tilted to either side, about each axis of the
            image.
        max_focal_sigma: standard error of fx and fy, relative. ``fair_focal_sigma``: the same of a
            fair set;
            ``most_focal_sigma``: above it a set says nothing.
        max_rms_px: residual of the solution.
        max_held_out_ratio: rms of views that were left out over rms of the solution.
        max_uneven_px: by how much corners may be off in step with their place in the image.
    """

    min_views: int = 12
    fewest_views: int = 5
    max_blur_px: float = 2.5
    max_blur_ratio: float = 2.5
    min_coverage: float = 0.6
    min_distance_ratio: float = 1.3
    min_tilt_span_deg: float = 30.0
    max_focal_sigma: float = 0.002
    fair_focal_sigma: float = 0.01
    most_focal_sigma: float = 0.1
    max_rms_px: float = 1.0
    max_held_out_ratio: float = 1.3
    max_uneven_px: float = 0.04


def sharp_enough(views: Sequence[BoardView], limits: SetLimits) -> list[bool]:
    """Returns, for each view, whether it is sharp enough."""
    if not views:
        return []
    blurs = sorted(view.blur_px for view in views)
    sharp = float(np.median(blurs[: max(1, len(blurs) // 3)]))
    limit = min(limits.max_blur_px, limits.max_blur_ratio * sharp)
    return [view.blur_px <= limit for view in views]


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> Whole:
    """Corners in each cell of the image, shape (GRID[1], GRID[0])."""
    return _histogram(views, size, GRID)


def judge_views(
    views: Sequence[BoardView],
    size: tuple[int, int],
    limits: SetLimits,
) -> list[SetFault]:
    """Return the faults known before a camera is solved: the number of views, and their places in
    the image.
    """
    faults: list[SetFault] = []
    if len(views) < limits.min_views:
        faults.append(
            SetFault(
                BadSet.TOO_FEW_VIEWS,
                f"{len(views)} usable views, at least {limits.min_views} are needed",
                "take more, some 20 to 40 in all, each with the board at another place and angle",
            )
        )
    cells = coverage(views, size)
    share = float((cells > 0).mean())
    empty = empty_places(views, size)
    if share < limits.min_coverage or empty:
        where = f"; none in the {', '.join(empty)}" if empty else ""
        faults.append(
            SetFault(
                BadSet.CLUSTERED,
                f"corners in {100.0 * share:.0f} % of the image, {100.0 * limits.min_coverage:.0f} % are needed{where}",
                "bring the board into every part of the image, up to its corners: the distortion is largest there",
            )
        )
    return faults


def judge_solution(solution: Intrinsics, limits: SetLimits) -> list[SetFault]:
    """Return the faults that the solution shows in its views."""
    faults: list[SetFault] = []
    if solution.rms_px > limits.max_rms_px:
        faults.append(
            SetFault(
                BadSet.WRONG_BOARD,
                f"the best camera leaves {solution.rms_px:.2f} px, {limits.max_rms_px:g} px are allowed",
                "is the board the one that was named (squares, size of the markers), flat, and the lens a normal one? "
                "a fisheye is none",
            )
        )
    faults += _judge_poses(solution, limits)
    worst = focal_sigma(solution)
    if not worst <= limits.max_focal_sigma:
        faults.append(
            SetFault(
                BadSet.UNCERTAIN,
                f"the focal length is known to {100.0 * worst:.2f} %, {100.0 * limits.max_focal_sigma:g} % are needed",
                "take more views with the board tilted by 30 to 45 degrees, large in the image",
            )
        )
    ratio = solution.held_out_px / solution.rms_px
    if not ratio <= limits.max_held_out_ratio:
        faults.append(
            SetFault(
                BadSet.NOT_PREDICTIVE,
                f"views that were left out fit {ratio:.2f} times worse than the others, {limits.max_held_out_ratio:g} "
                "is allowed",
                "take more views, different ones; leave out views in which the board or the camera moved",
            )
        )
    period, off_px = uneven_pixels(solution)
    if off_px > limits.max_uneven_px:
        faults.append(
            SetFault(
                BadSet.UNEVEN_PIXELS,
                f"corners are off by {off_px:.2f} px in step with every {period} pixels: the camera makes this image "
                "out of a larger one by leaving out pixels",
                "take a stream of the sensor's own size: in this one markers are off as well",
            )
        )
    if solution.camera is None:
        faults.append(
            SetFault(
                BadSet.UNCERTAIN,
                f"the solution is no camera: {solution.camera_problem}",
                "bring the board into the corners of the image, where the distortion is determined",
            )
        )
    return faults


def uneven_pixels(solution: Intrinsics) -> tuple[int, float]:
    """Return the period, in pixels, and the amplitude in px by which corners are off most in step
    with their place.

    0 px where it may be chance: noise has a power of ``NO_CHANCE`` times its mean in one of 10^8
    sets.
    """
    places = np.concatenate([view.corners_px for view in solution.views])
    errors = np.concatenate([view.errors_px for view in solution.views])
    best = (0, 0.0)
    for period in PERIODS:
        for axis in (0, 1):
            wave = np.exp(-2j * np.pi * places[:, axis] / period)
            size = float(np.abs(wave @ errors[:, axis]))
            power = size**2 / max(float((errors[:, axis] ** 2).sum()), 1e-12)
            if power > NO_CHANCE:
                best = max(best, (period, 2.0 * size / len(places)), key=lambda found: found[1])
    return best


def focal_sigma(solution: Intrinsics) -> float:
    """Standard error of fx or fy, whichever is worse, relative."""
    return max(solution.sigmas[k] / abs(solution.values[k]) for k in (0, 1))


def useless(solution: Intrinsics, limits: SetLimits) -> bool:
    """Return whether a solution is useless: no camera, another board than named, or nothing known
    of it.
    """
    known = focal_sigma(solution) <= limits.most_focal_sigma
    return solution.camera is None or not known or solution.rms_px > limits.max_rms_px


def grade_of(
    solution: Intrinsics,
    faults: Sequence[SetFault],
    limits: SetLimits,
) -> Grade:
    """Return the grade of a calibration: good without any fault, fair or weak by what is known of
    fx and fy.
    """
    if not faults:
        return "good"
    return "fair" if focal_sigma(solution) <= limits.fair_focal_sigma else "weak"


def tilts_deg(solution: Intrinsics) -> Array:
    """Tilt of the board about the image's x and y axes in every view, (n, 2)."""
    normals = np.stack([view.T_c_o.R[:, 2] for view in solution.views])
    normals *= np.sign(normals[:, 2:])
    return np.degrees(np.arctan2(normals[:, [1, 0]], normals[:, 2:]))


def _judge_poses(solution: Intrinsics, limits: SetLimits) -> list[SetFault]:
    faults: list[SetFault] = []
    distances = np.array([view.distance_m for view in solution.views])
    ratio = float(np.percentile(distances, 95) / np.percentile(distances, 5))
    if ratio < limits.min_distance_ratio:
        faults.append(
            SetFault(
                BadSet.ONE_DISTANCE,
                f"all views are from about the same distance (1 to {ratio:.2f}, at least 1 to "
                f"{limits.min_distance_ratio:g} is needed)",
                "take some views with the board filling the image, and some from twice as far",
            )
        )
    spans = np.ptp(tilts_deg(solution), axis=0)
    for axis, span in zip(
        ("nodded (top away or towards)", "turned (left side away or towards)"),
        spans,
        strict=True,
    ):
        if span < limits.min_tilt_span_deg:
            faults.append(
                SetFault(
                    BadSet.NO_TILT,
                    f"the board was {axis} over {span:.0f} degrees only, {limits.min_tilt_span_deg:g} are needed: "
                    "without tilt the focal length cannot be told from the distance",
                    "tilt the board by 20 to 45 degrees, to all four sides",
                )
            )
    return faults


def _histogram(
    views: Sequence[BoardView],
    size: tuple[int, int],
    grid: tuple[int, int],
) -> Whole:
    cells = np.zeros((grid[1], grid[0]), np.int64)
    if views:
        corners = np.concatenate([view.corners_px for view in views])
        columns = np.clip((corners[:, 0] + 0.5) / size[0] * grid[0], 0, grid[0] - 1).astype(
            np.int64
        )
        rows = np.clip((corners[:, 1] + 0.5) / size[1] * grid[1], 0, grid[1] - 1).astype(np.int64)
        np.add.at(cells, (rows, columns), 1)
    return cells


def empty_places(views: Sequence[BoardView], size: tuple[int, int]) -> list[str]:
    """Return the names of those ninths of the image in which no view has a corner."""
    cells = _histogram(views, size, (3, 3))
    return [
        PLACES[row][column] for row in range(3) for column in range(3) if cells[row, column] == 0
    ]
