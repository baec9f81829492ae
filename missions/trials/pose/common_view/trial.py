"""The trial of relative poses without the marker: real pairs of frames, and what drones know."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.link.wire import PART_WIRE_BYTES
from flight.common_view import KEYFRAME_S
from missions.ground.work import call
from missions.trials.pose.common_view.sequence import (
    Pair,
    Sequence,
    every,
    pairs_between,
    read_sequence,
)
from missions.trials.shared.statistics import wilson
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.camera.model import CameraModel
from path.common_view.estimate import CommonView, common_view
from path.common_view.keyframe import Keyframe
from path.common_view.parts import Gathered, KeyframeSource, parts_of
from path.common_view.read import OWN, SENT, read_keyframe
from path.common_view.search import Prior
from path.geometry import rotation

TITLE = "Without the marker: where the other camera is, by what both see, on real pairs"
PAPER = ""
ROWS = ((15.0, 30.0), (30.0, 45.0), (45.0, 60.0), (60.0, 90.0))
GOALS = (0.95, 0.92, 0.85, 0.65)
PAIRS = 200
QUICK_PAIRS = 3
PIECE = 10
APART_M = (0.5, 1.5)
OVERLAP = 0.2
GRAVITY_SIGMA_RAD = math.radians(0.5)
HEADING_SIGMA_RAD = math.radians(5.0)
"""Between both drones' headings."""
POSITION_SIGMA_M = 0.5
"""Of the reported place of one in the frame of the other, along each axis."""
RIGHT_M, RIGHT_DEG = 0.1, 3.0
WRONG_M, WRONG_DEG = 0.3, 10.0
GOAL_CHI2 = (0.7, 1.5)
GOAL_MS = 60.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of one pair.

    Attributes:
        why: "" when a pose was given, else why none was.
        off_m, off_deg: error of the pose, given or not; NaN without any.
        chi2: by its stated covariance, by each of four numbers.
        cpu_ms: without features. ``sent``: bytes of the first keyframe on a link, signed, over UDP.
    """

    why: str
    off_m: float
    off_deg: float
    chi2: float
    cpu_ms: float
    sent: int

    @property
    def right(self) -> bool:
        return self.why == "" and self.off_m < RIGHT_M and self.off_deg < RIGHT_DEG

    @property
    def wrong(self) -> bool:
        return self.why == "" and (self.off_m > WRONG_M or self.off_deg > WRONG_DEG)


def run(request: TrialRequest) -> TrialResult:
    if request.common_view is None:
        reason = "no RGB-D sequence was named (--common-view)"
        nothing = TrialFinding("relative poses without the marker", "not measured", note=reason)
        return TrialResult({"rows": {}, "reason": reason}, (nothing,))
    sequence = read_sequence(request.common_view)
    number = QUICK_PAIRS if request.quick else PAIRS
    pieces: list[partial[list[Answer]]] = []
    rows_of: list[int] = []
    there: list[int] = []
    for row, angles in enumerate(ROWS):
        rng = np.random.default_rng((request.seed, row))
        pairs = pairs_between(sequence, angles, APART_M, OVERLAP, number, rng)
        there.append(len(pairs))
        numbered = list(every(pairs, number))
        some = [numbered[k : k + PIECE] for k in range(0, len(numbered), PIECE)]
        pieces += [
            partial(answer_pairs, request.common_view, (request.seed, row), own) for own in some
        ]
        rows_of += [row] * len(some)
    answers = request.work.map("pairs", call, pieces)
    rows: list[list[Answer]] = [[] for _ in ROWS]
    for row, own in zip(rows_of, answers, strict=True):
        rows[row] += own
    summaries = [_summary(own, pairs) for own, pairs in zip(rows, there, strict=True)]
    named = {f"{low:.0f}-{high:.0f}": s for (low, high), s in zip(ROWS, summaries, strict=True)}
    everything = [answer for own in rows for answer in own]
    return TrialResult(
        {"rows": named, **_summary(everything, sum(there))},
        tuple(_findings(rows)),
        tables=(_table(named),),
        notes=(
            f"Right: within {RIGHT_M * 1e3:.0f} mm and {RIGHT_DEG:.0f} degrees; wrong: given, and off by "
            f"more than {WRONG_M * 1e3:.0f} mm or {WRONG_DEG:.0f} degrees. The sequence's own poses are "
            "good to some centimetres.",
            "Before: gravity 0.5 degrees in each, heading 5 degrees between them, position 0.5 m along "
            "each axis, drawn by seed for each pair. Where a row has fewer pairs than are asked, some "
            "are asked again with other errors.",
        ),
    )  # fmt: skip


def answer_pairs(
    folder: Path, seed: tuple[int, int], pairs: list[tuple[int, Pair]]
) -> list[Answer]:
    """Ask for some pairs' poses; each has a number, by which its errors are drawn."""
    sequence = read_sequence(folder)
    return [
        answer_pair(sequence, pair, np.random.default_rng((*seed, number)))
        for number, pair in pairs
    ]


def answer_pair(
    sequence: Sequence,
    pair: Pair,
    rng: np.random.Generator,
) -> Answer:
    """Ask for one pair's pose, with errors of what drones know."""
    one = sequence.frames[pair.first]
    two = sequence.frames[pair.second]
    sigmas = np.array([GRAVITY_SIGMA_RAD, GRAVITY_SIGMA_RAD, HEADING_SIGMA_RAD / math.sqrt(2.0)])
    R1 = rotation.exp(rng.normal(size=3) * sigmas) @ sequence.R_l_w @ one.T_w_c.R
    R2 = rotation.exp(rng.normal(size=3) * sigmas) @ sequence.R_l_w @ two.T_w_c.R
    camera = sequence.camera
    seen = read_keyframe(one.color(), one.depth(), camera, R1, GRAVITY_SIGMA_RAD, SENT)
    first, sent = over_link(seen, camera.depth)
    second = read_keyframe(
        two.color(),
        two.depth(),
        camera,
        R2,
        GRAVITY_SIGMA_RAD,
        OWN,
        first.patch_m,
    )
    T = one.T_w_c.inverse() @ two.T_w_c
    t = R1 @ T.t
    R = R1 @ T.R @ R2.T
    sigma = np.full(3, POSITION_SIGMA_M)
    prior = Prior(0.0, HEADING_SIGMA_RAD, t + rng.normal(size=3) * sigma, sigma)
    began = time.thread_time()
    found = common_view(first, second, prior)
    cpu_ms = 1e3 * (time.thread_time() - began)
    why = "" if isinstance(found, CommonView) else found.why.value
    best = found if isinstance(found, CommonView) else found.best
    if best is None:
        return Answer(why, math.nan, math.nan, math.nan, cpu_ms, sent)
    yaw = math.remainder(best.yaw_rad - math.atan2(R[1, 0], R[0, 0]), math.tau)
    off = np.append(best.t_m - t, yaw)
    chi2 = float(off @ np.linalg.solve(best.covariance, off)) / 4.0
    off_m = float(np.linalg.norm(off[:3]))
    return Answer(why, off_m, abs(math.degrees(yaw)), chi2, cpu_ms, sent)


def over_link(seen: Keyframe, camera: CameraModel) -> tuple[Keyframe, int]:
    """Return a keyframe as it comes over a link that loses nothing, and the bytes it takes."""
    sigma = seen.depth_sigma_at_1m_m
    gathered = Gathered(KeyframeSource(camera, SENT, sigma, seen.gravity_sigma_rad))
    parts = parts_of(seen, camera, 1)
    for part in parts:
        gathered.add(part)
    return gathered.keyframe(), len(parts) * PART_WIRE_BYTES


def _summary(answers: list[Answer], pairs: int) -> dict[str, Any]:
    """Return the figures of some answers; ``pairs``: how many different ones were asked."""
    given = [answer for answer in answers if not answer.why]
    off = np.array([answer.off_m for answer in given])
    reasons = sorted({answer.why for answer in answers} - {""})
    return {
        "asked": len(answers),
        "pairs": pairs,
        "right": _share(sum(answer.right for answer in answers), len(answers)),
        "wrong_accepted": sum(answer.wrong for answer in answers),
        "dont_know": _share(len(answers) - len(given), len(answers)),
        "why": {why: sum(answer.why == why for answer in answers) for why in reasons},
        "d2_median_m": float(np.median(off)) if len(off) else math.nan,
        "d2_p95_m": float(np.percentile(off, 95.0)) if len(off) else math.nan,
        "yaw_median_deg": _median([answer.off_deg for answer in given]),
        "chi2": float(np.mean([answer.chi2 for answer in given])) if given else math.nan,
        "cpu_ms": _median([answer.cpu_ms for answer in answers]),
        "bytes_per_s": max((answer.sent for answer in answers), default=0) / KEYFRAME_S,
    }


def _share(some: int, of: int) -> float:
    return some / of if of else math.nan


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _findings(rows: list[list[Answer]]) -> list[TrialFinding]:
    found: list[TrialFinding] = []
    for (low, high), goal, answers in zip(ROWS, GOALS, rows, strict=True):
        right = sum(answer.right for answer in answers)
        ours = _share(right, len(answers))
        a, b = wilson(right, len(answers))
        found.append(
            TrialFinding(
                f"right at {low:.0f}-{high:.0f} degrees, %", f"{100 * ours:.1f}",
                f"{100 * a:.1f} to {100 * b:.1f}", goal=f">= {100 * goal:.0f}",
                verdict=verdict(ours >= goal),
            )
        )  # fmt: skip
    everything = [answer for answers in rows for answer in answers]
    whole = _summary(everything, 0)
    wrong = whole["wrong_accepted"]
    chi2 = whole["chi2"]
    ms = whole["cpu_ms"]
    honest = GOAL_CHI2[0] <= chi2 <= GOAL_CHI2[1]
    return [
        *found,
        TrialFinding("wrong and given", f"{wrong} of {len(everything)}", goal="0",
                     verdict=verdict(wrong == 0)),
        TrialFinding("honesty of the covariance", f"{chi2:.2f}", goal="0.7 to 1.5",
                     verdict=verdict(honest)),
        TrialFinding("a pair without features, ms CPU", f"{ms:.0f}", goal=f"<= {GOAL_MS:.0f}",
                     verdict=verdict(ms <= GOAL_MS)),
    ]  # fmt: skip


def _table(rows: dict[str, dict[str, Any]]) -> TrialTable:
    columns = (
        "angle between views", "asked (pairs)", "right", "wrong and given", "don't know",
        "D2, median / p95, mm", "yaw, median", "chi2", "ms CPU",
    )  # fmt: skip
    lines = [
        (
            f"{name} degrees", f"{row['asked']} ({row['pairs']})", f"{100 * row['right']:.1f} %",
            str(row["wrong_accepted"]), f"{100 * row['dont_know']:.1f} %",
            f"{1e3 * row['d2_median_m']:.0f} / {1e3 * row['d2_p95_m']:.0f}",
            f"{row['yaw_median_deg']:.2f} degrees", f"{row['chi2']:.2f}", f"{row['cpu_ms']:.0f}",
        )
        for name, row in rows.items()
    ]  # fmt: skip
    return TrialTable("Real pairs by the angle between the views", columns, tuple(lines))
