"""One set of photographs, measured: corners by method, poses, and how honest what is stated about
them is.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import PartError
from flight.harness.renderer import FrameRenderer
from missions.trials.real.board import SetSeen, look_at_set
from missions.trials.real.corners import METHODS, corners_by
from missions.trials.real.errors import MethodPoses, measure_set
from missions.trials.real.poses import (
    Gravity,
    Poses,
    PoseTask,
    as_stated,
    estimate_all,
    plate_tasks,
    single_tasks,
)
from missions.trials.real.results import CornerScore, Figure95, PoseScore, SetScore, TwinScore
from missions.trials.real.set import RealSet, read_set
from missions.trials.real.shutter import held_still
from missions.trials.real.twin import render_twin
from missions.trials.shared.statistics import (
    Statistic,
    bootstrap,
    figure_of,
    means,
    medians,
    p95s,
    robust_sigma,
    robust_sigmas,
)
from path.arrays import Array, Image

SCORE_STREAM = 2
QUICK_IMAGES = 4
MEDIAN_OF = {8: 0.918, 6: 0.891}  # median of chi-square over its degrees of freedom, by these
THUMBNAIL_PX = 480
SHARES = {"as_stated": 1.0, "as_stated_half": 0.5, "as_stated_quarter": 0.25}
"""Of the stated deviations of corners: the better ones tell how good corners would have to be."""
KNOWN_GRAVITY = ("single", "plate", "still", "still_plate", "as_stated", "as_stated_plate")
"""Poses that are estimated once more with gravity known."""
SHAPELY = ("perfect_corners", "as_stated")  # poses of corners whose print is known

Groups = NDArray[np.int64]


def score_set(
    file: Path,
    photographs: Path | None,
    seed: int,
    quick: bool,
    renderer: type[FrameRenderer] | None = None,
    twins: Path = Path("twins"),
) -> SetScore:
    """Measure one set and its rendered twin. Raises PartError.

    Args:
        photographs: what the file's paths are relative to; None: its own folder.
        renderer: draws the set's twin into the folder ``twins``; None for no twin.
    """
    own = read_set(file, photographs)
    images = own.images[:: max(1, len(own.images) // QUICK_IMAGES)] if quick else own.images
    seen = look_at_set(own, images)
    measured = _measure(own, seen)
    score = _score(own, images, seen, measured, seed)
    if renderer is None:
        return score
    try:
        best = measured.get("photometric")
        twin = render_twin(own, seen, best, images, renderer, seed, twins)
        if twin is None:
            return replace(score, untwinned="the camera's response shows in too few straight edges")
        drawn, response = twin
        again = look_at_set(own, drawn)
    except (ValueError, PartError) as error:
        # What was measured on the photographs stands: a twin is drawn beside it.
        return replace(score, untwinned=str(error))
    rendered = _score(own, drawn, again, _measure(own, again), seed)
    return replace(score, twin=TwinScore(response, rendered))


def _measure(own: RealSet, seen: SetSeen) -> dict[str, MethodPoses]:
    """Every marker by every method that finds any."""
    measured: dict[str, MethodPoses] = {}
    for method in METHODS if own.markers else ():
        found = [
            corners_by(method, own, shot.grey, start, seen.camera)
            for shot, start in zip(seen.photographs, seen.starts, strict=True)
        ]
        measured[method] = measure_set(own, seen, found)
    return {name: some for name, some in measured.items() if some.seen}


def _score(
    own: RealSet,
    images: Sequence[Path],
    seen: SetSeen,
    measured: dict[str, MethodPoses],
    seed: int,
) -> SetScore:
    rng = np.random.default_rng([seed, SCORE_STREAM])
    camera = seen.camera
    best = measured.get("photometric")
    still = (
        None
        if best is None or own.board is None or not own.file.flat
        else held_still(own, seen, best)
    )
    return SetScore(
        own.name,
        len(images),
        len(seen.photographs),
        0 if best is None else len(best.seen),
        math.nan if best is None else float(np.median([m.side_px for m in best.seen])),
        float(np.median([board.left_px for board in seen.boards])),
        None if best is None or not best.print_m else _print_m(best),
        None if best is None else _height_m(best),
        (camera.fx, camera.fy, camera.cx, camera.cy),
        seen.sigmas,
        camera.thinning,
        {name: _corner_score(some, rng) for name, some in measured.items()},
        {}
        if best is None
        else _pose_scores(own, seen, best, None if still is None else still[:2], seed, rng),
        {}
        if best is None
        else dict(Counter(wrong for marker in best.seen for wrong in marker.found.wrong)),
        _thumbnail(seen),
        None if still is None else still[2],
    )


def _corner_score(measured: MethodPoses, rng: np.random.Generator) -> CornerScore:
    groups = np.array([marker.view for marker in measured.seen])
    errors = np.stack([marker.error_px for marker in measured.seen])
    robust = _figure(errors, robust_sigmas, groups, rng)
    across = _figure(
        np.stack([marker.across_px for marker in measured.seen]),
        robust_sigmas,
        groups,
        rng,
    )
    nominal = robust_sigma(np.stack([marker.nominal_px for marker in measured.seen]))
    rms = math.sqrt(float(np.mean(errors**2)))
    chi2 = np.array([marker.chi2 for marker in measured.seen])
    if np.isnan(chi2).any():
        return CornerScore(len(measured.seen), robust, across, nominal, rms)
    traces = [
        float(np.trace(m.found.covariance_px2))
        for m in measured.seen
        if m.found.covariance_px2 is not None
    ]
    stated = math.sqrt(float(np.median(traces)) / 8.0)
    honesty = _honesty(chi2, 8, groups, rng)
    doubts = [marker.doubt_px2 for marker in measured.seen if marker.doubt_px2 is not None]
    if not doubts:
        return CornerScore(len(measured.seen), robust, across, nominal, rms, stated, honesty)
    doubt = math.sqrt(float(np.median([np.trace(one) for one in doubts])) / 8.0)
    both = _honesty(np.array([marker.chi2_with_doubt for marker in measured.seen]), 8, groups, rng)
    return CornerScore(
        len(measured.seen),
        robust,
        across,
        nominal,
        rms,
        stated,
        honesty,
        doubt,
        both,
    )


def _print_m(measured: MethodPoses) -> float:
    return float(np.sqrt(np.mean(np.stack([*measured.print_m.values()])[:, :, :2] ** 2)))


def _height_m(measured: MethodPoses) -> float:
    """By how much paper leaves its smooth surface: what moves corners along its normal more than
    across.
    """
    along, across = (
        robust_sigma(np.stack([getattr(m, name) for m in measured.seen]))
        for name in ("along_px", "across_px")
    )
    rise = float(np.median([np.linalg.norm(marker.rises, axis=1) for marker in measured.seen]))
    return math.sqrt(max(along**2 - across**2, 0.0)) / rise


def _pose_scores(
    own: RealSet, seen: SetSeen, measured: MethodPoses, still: tuple[SetSeen, MethodPoses] | None, seed: int,
    rng: np.random.Generator,
) -> dict[str, PoseScore]:  # fmt: skip
    singles = single_tasks(own, seen, measured)
    plates = plate_tasks(own, seen, measured)
    kinds: dict[str, list[PoseTask]] = {
        "single": singles,
        "plate": plates,
        "squared": single_tasks(own, seen, measured, squared=True),
        "squared_plate": plate_tasks(own, seen, measured, squared=True),
        "perfect_corners": single_tasks(own, seen, measured, perfect=True),
    }
    for name, share in SHARES.items():
        kinds[name] = as_stated(seen.camera, singles, seed, share)
        kinds[f"{name}_plate"] = as_stated(seen.camera, plates, seed, share)
    if still is not None:
        kinds["still"] = single_tasks(own, *still, squared=True)
        kinds["still_plate"] = plate_tasks(own, *still, squared=True)

    def poses(name: str, gravity: Gravity) -> Poses:
        return estimate_all(
            own,
            seen.camera,
            kinds[name],
            seed,
            gravity=gravity,
            shapely=name.startswith(SHAPELY),
        )

    found = {name: poses(name, "stated") for name in kinds}
    found["without_gravity"] = poses("single", "none")
    found |= {
        f"{name}_known_gravity": poses(name, "known") for name in KNOWN_GRAVITY if name in kinds
    }
    return {name: _pose_score(some, rng) for name, some in found.items() if some.errors}


def _pose_score(poses: Poses, rng: np.random.Generator) -> PoseScore:
    groups = np.array([error.view for error in poses.errors])
    d2 = np.array([error.d2_m for error in poses.errors])
    turns = np.degrees([error.rotation_rad for error in poses.errors])
    return PoseScore(
        len(poses.errors),
        _figure(d2, means, groups, rng),
        _figure(d2, medians, groups, rng),
        _figure(d2, p95s, groups, rng),
        _figure(turns, medians, groups, rng),
        sum(error.flipped for error in poses.errors),
        poses.refused,
        _honesty(np.array([error.chi2 for error in poses.errors]), 6, groups, rng),
    )


def _honesty(
    chi2: Array,
    freedom: int,
    groups: Groups,
    rng: np.random.Generator,
) -> Figure95:
    """Median of chi-squares over their degrees of freedom, in units of what it is when the
    covariance is right.
    """
    return _figure(chi2 / MEDIAN_OF[freedom], medians, groups, rng)


def _figure(
    values: Array,
    statistic: Statistic,
    groups: Groups,
    rng: np.random.Generator,
) -> Figure95:
    together = groups if len(np.unique(groups)) > 2 else None
    return Figure95(figure_of(statistic, values), bootstrap(values, statistic, rng, together))


def _thumbnail(seen: SetSeen) -> Image:
    shot = seen.photographs[len(seen.photographs) // 2].grey
    scale = min(1.0, THUMBNAIL_PX / shot.shape[1])
    small: Sequence[Any] | Any = cv2.resize(
        shot,
        None,
        fx=scale,
        fy=scale,
        interpolation=cv2.INTER_AREA,
    )
    return np.asarray(small, np.uint8)
