"""Real images decide: corners and poses on photographs of boards, held against the boards
themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from drivers.interfaces import PartError
from missions.ground.work import call
from missions.trials.real.corners import METHOD_TITLES, METHODS
from missions.trials.real.pictures import draw_sets
from missions.trials.real.results import Figure95, SetScore, TwinScore
from missions.trials.real.score import KNOWN_GRAVITY, score_set
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)

NEEDS = ("renderer",)
TITLE = "Photographs of boards: corners and poses of single markers against the whole board"
PAPER = ""

LARGE_PX = 40.0  # side from which on the goals of large markers hold
GOAL_CORNERS_PX = 0.10
GOAL_HONEST = (0.7, 1.5)
GOAL_PLATE_M = 0.005
GOAL_TWIN = (0.8, 1.25)
PICTURE = "real.png"
TWIN_TITLES = {
    "corners_px": ("corners, px robust per axis", 3, 1.0),
    "across_px": ("corners across the paper's height, px robust", 3, 1.0),
    "chi2_corners": ("honesty of corners", 2, 1.0),
    "d2_mean_m": ("D2, mean, mm", 1, 1e3),
    "chi2_pose": ("honesty of poses", 2, 1.0),
}
"""Of each figure that is compared: its title, digits and scale."""
_TITLES = {
    "single": "one marker, gravity",
    "without_gravity": "one marker, no gravity",
    "plate": "two markers, gravity",
    "squared": "one marker, printed square, gravity",
    "squared_plate": "two markers, printed square, gravity",
    "still": "one marker, printed square and held still, gravity",
    "still_plate": "two markers, printed square and held still, gravity",
    "as_stated": "one marker whose corners err as stated, gravity",
    "as_stated_plate": "two markers whose corners err as stated, gravity",
    "as_stated_half": "one marker whose corners err half as much, gravity",
    "as_stated_half_plate": "two markers whose corners err half as much, gravity",
    "as_stated_quarter": "one marker whose corners err a quarter as much, gravity",
    "as_stated_quarter_plate": "two markers whose corners err a quarter as much, gravity",
    "perfect_corners": "the board's own corners, gravity",
}
POSE_TITLES = _TITLES | {
    f"{name}_known_gravity": f"{title.removesuffix(', gravity')}, gravity known"
    for name, title in _TITLES.items()
    if name in KNOWN_GRAVITY
}


def run(request: TrialRequest) -> TrialResult:
    if not request.sets:
        return _nothing()
    names = [file.stem for file in request.sets]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise PartError(
            f"--set: {twice[0]} is named twice", "sets are told apart by the names of their files"
        )
    renderer = request.part("renderer")
    tasks = [
        partial(
            score_set,
            file,
            request.photographs,
            request.seed,
            request.quick,
            renderer,
            request.out / "twins" / file.stem,
        )
        for file in request.sets
    ]
    scores = request.work.map("sets", call, tasks)
    draw_sets(scores, request.out / PICTURE)
    return TrialResult(
        summary={"sets": {score.name: score.summary() for score in scores}},
        findings=tuple(finding for score in scores for finding in _findings(score)),
        tables=(
            _corner_table(scores),
            _pose_table(scores),
            _twin_table(scores),
            _set_table(scores),
        ),
        pictures={
            PICTURE: "A view of each set and its twin, corners by method, D2's error by what the pose rests on.",
        },
        notes=(
            "The board's pose comes from all its corners; what all views of a marker agree on is the print's, not an "
            "error of its corners. The row of the board's own corners is the floor: what gravity, print, and a board "
            "that is not flat leave when the corners are as the whole board says. Printed square: the same photographs "
            "with corners moved by what the print is off a square, as a marker drawn with exact edges would have them. "
            "Held still: also without the shear of each view, which is what moves while rows are read, and more. "
            "Corners that err as stated: drawn with the covariance that its fit states, print, paper and motion right: "
            "what is left is camera and gravity. Gravity known: its error taken out, so that each has its share.",
            "Of a camera that leaves out pixels, so that those it keeps are not evenly spaced, every method's corners "
            "are put where they are in an evenly spaced image.",
            "Intervals are 95 %, views drawn together. Honesty is the median chi-square per number over what it is "
            "when the covariance is right: 1 is honest, 4 means errors twice as large as stated.",
        ),
    )


def _nothing() -> TrialResult:
    reason = "no set of photographs was named (--set)"
    return TrialResult(
        {"sets": {}, "reason": reason},
        (TrialFinding("photographs of boards", "not measured", note=reason),),
    )


def _findings(score: SetScore) -> list[TrialFinding]:
    found: list[TrialFinding] = []
    single = score.poses.get("single")
    corners = score.corners.get("photometric")
    if single is not None:
        large = score.side_px >= LARGE_PX
        found.append(_length(score, "D2, mean, mm", single.d2_mean_m, 0.010 if large else 0.015))
        if large:
            found.append(_length(score, "D2, median, mm", single.d2_median_m, 0.008))
        found.append(_honesty(score, "honesty of poses", single.chi2))
        found.append(
            TrialFinding(f"{score.name}: flips", f"{single.flips} of {single.poses}", goal="0",
                    verdict=verdict(single.flips == 0))
        )  # fmt: skip
    if "plate" in score.poses:
        found.append(
            _length(
                score, "D2 by two markers, mean, mm", score.poses["plate"].d2_mean_m, GOAL_PLATE_M
            )
        )
    if corners is not None:
        rival = score.corners.get("apriltag")
        limit = min(
            GOAL_CORNERS_PX, rival.robust_px.value if rival is not None else GOAL_CORNERS_PX
        )
        found.append(
            TrialFinding(f"{score.name}: corners, px robust per axis", corners.robust_px.text(3), goal=f"≤ {limit:.3f}",
                    verdict=verdict(corners.robust_px.value <= limit))
        )  # fmt: skip
        if corners.chi2 is not None:
            found.append(_honesty(score, "honesty of corners", corners.chi2))
    found += _twin_findings(score)
    if not found:
        found.append(
            TrialFinding(
                f"{score.name}: corners of the board, px rms per axis", f"{score.board_px:.3f}"
            )
        )
    return found


def _twin_findings(score: SetScore) -> list[TrialFinding]:
    """The twin's figures over the photographs': 1 when simulation promises what photographs
    keep.
    """
    if score.twin is None and score.untwinned:
        return [
            TrialFinding(f"{score.name}: twin over photographs", "no twin", note=score.untwinned)
        ]
    if score.twin is None:
        return []
    low, high = GOAL_TWIN
    return [
        TrialFinding(
            f"{score.name}: twin over photographs, {TWIN_TITLES[name][0]}", f"{ratio:.2f}", goal=f"{low:g} to {high:g}",
            verdict=verdict(low <= ratio <= high),
        )
        for name, ratio in score.twin.ratios(score).items()
    ]  # fmt: skip


def _length(score: SetScore, what: str, figure: Figure95, goal_m: float) -> TrialFinding:
    low, high = figure.interval
    return TrialFinding(
        f"{score.name}: {what}", f"{1e3 * figure.value:.1f}", f"{1e3 * low:.1f} to {1e3 * high:.1f}",
        goal=f"≤ {1e3 * goal_m:g}", verdict=verdict(figure.value <= goal_m),
    )  # fmt: skip


def _honesty(score: SetScore, what: str, figure: Figure95) -> TrialFinding:
    low, high = GOAL_HONEST
    return TrialFinding(
        f"{score.name}: {what}", f"{figure.value:.2f}", f"{figure.interval[0]:.2f} to {figure.interval[1]:.2f}",
        goal=f"{low:g} to {high:g}", verdict=verdict(low <= figure.value <= high),
    )  # fmt: skip


def _corner_table(scores: Sequence[SetScore]) -> TrialTable:
    rows = [
        (
            score.name,
            METHOD_TITLES[method],
            str(own.found),
            own.robust_px.text(3),
            f"{own.across_px.value:.3f}",
            f"{own.nominal_px:.3f}",
            f"{own.rms_px:.3f}",
            "" if own.stated_px is None else f"{own.stated_px:.3f}",
            "" if own.chi2 is None else own.chi2.text(2),
            "" if own.doubt_px is None else f"{own.doubt_px:.3f}",
            "" if own.chi2_with_doubt is None else own.chi2_with_doubt.text(2),
        )
        for score in scores
        for method in METHODS
        if (own := score.corners.get(method)) is not None
    ]
    return TrialTable(
        "Corners against the board, px per axis",
        ("set", "method", "markers", "robust", "across", "markers printed alike", "rms", "stated", "honesty",
         "the board's doubt", "honesty with it"),
        rows,
        "Robust: 1.48 times the median size; across: the same in the one direction in the image in which paper that is "
        "not flat moves no corner. Each method measures the print with its own corners, where three views "
        "or more show a marker: a bias that is the same everywhere is not counted, except in the column of markers "
        "printed alike, in which only their common side is free. The board's doubt: how well its own corners tell "
        "where a marker's are; with it, errors are held against it and what is stated together.",
    )  # fmt: skip


def _pose_table(scores: Sequence[SetScore]) -> TrialTable:
    rows = [
        (
            score.name,
            title,
            str(own.poses),
            own.d2_mean_m.text(1, 1e3),
            own.d2_median_m.text(1, 1e3),
            own.d2_p95_m.text(0, 1e3),
            own.rotation_median_deg.text(2),
            str(own.flips),
            ", ".join(f"{count} {reason}" for reason, count in own.refused.items()),
            own.chi2.text(2) if kind != "perfect_corners" else "",
        )
        for score in scores
        for kind, title in POSE_TITLES.items()
        if (own := score.poses.get(kind)) is not None
    ]
    return TrialTable(
        "Poses against the board's, D2 in mm for a marker of the scaled side",
        (
            "set",
            "from",
            "poses",
            "D2 mean",
            "median",
            "p95",
            "rotation, median deg",
            "flips",
            "refused",
            "honesty",
        ),
        rows,
    )


def _twin_table(scores: Sequence[SetScore]) -> TrialTable:
    rows = [
        (
            score.name,
            TWIN_TITLES[name][0],
            figure.text(*TWIN_TITLES[name][1:]),
            twin[name].text(*TWIN_TITLES[name][1:]),
            f"{score.twin.ratios(score)[name]:.2f}",
        )
        for score in scores
        if score.twin is not None
        for twin in (score.twin.score.compared(),)
        for name, figure in score.compared().items()
        if name in twin
    ]
    cameras = "; ".join(_camera_of(score, score.twin) for score in scores if score.twin is not None)
    return TrialTable(
        "Photographs and their rendered twins",
        ("set", "", "photographs", "twin", "twin over photographs"),
        rows,
        "A twin is the same board with its ink where the photographs show it, drawn at the same places by the "
        "harness's renderer, with the camera's response as straight edges of the photographs show it: "
        + cameras
        + ".",
    )


def _camera_of(score: SetScore, twin: TwinScore) -> str:
    own = twin.response.imaging
    thin = score.thinning
    kept = (
        ""
        if thin is None
        else f"of {thin.of} rows and columns of the sensor {thin.kept} are kept, "
    )
    jpeg = "none" if own.jpeg_quality is None else str(own.jpeg_quality)
    return (
        f"{score.name}: {kept}blur {own.blur_sigma_px:.2f} px, "
        f"sharpening {own.sharpen:.2f} over {own.sharpen_sigma_px:.1f} px, "
        f"gamma {own.gamma:.2f}, noise of the light {own.read_sigma:.1f} grey levels, JPEG {jpeg}, "
        f"{100.0 * twin.response.misfit:.1f} % of an edge unexplained"
    )


def _set_table(scores: Sequence[SetScore]) -> TrialTable:
    rows = [
        (
            score.name,
            f"{score.views} of {score.images}",
            "" if not score.markers else f"{score.side_px:.0f}",
            f"{score.board_px:.3f}",
            "" if score.print_m is None else f"{1e3 * score.print_m:.3f}",
            "" if score.height_m is None else f"{1e3 * score.height_m:.2f}",
            _motion(score),
            f"{score.camera[0]:.1f}",
            "given" if score.camera_sigmas is None else f"{100.0 * score.camera_sigmas[0]:.2f} %",
            ", ".join(f"{name} {count}" for name, count in score.named.items()),
        )
        for score in scores
    ]
    return TrialTable(
        "The sets",
        ("set", "views with the board", "marker, px", "board left, px", "print off, mm", "paper off, mm", "motion, px",
         "fx", "its error", "called wrong"),
        rows,
        "Board left: what neither pose nor bend explain of the board's own corners. Print off: by how much the corners "
        "of the markers are off on the print, rms over all of them. Paper off: by how much it leaves its smooth "
        "surface, as what moves corners along its normal more than across tells. Motion: while rows are read, "
        "as the shear of its board tells it, and what a pose leaves of the board's corners without and with it. Called "
        "wrong: what the photometric fits named.",
    )  # fmt: skip


def _motion(score: SetScore) -> str:
    own = score.row_motion
    return "" if own is None else f"{own.motion_px:.1f} ({own.pose_px:.3f} to {own.rows_px:.3f})"
