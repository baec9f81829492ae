"""The ambiguity trial: finding the target among six similar people, PATH against ORB and XFeat on
the same frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from missions.trials.rivals.examples import draw_view
from missions.trials.rivals.frame import FrameResult, FrameTask, judge
from missions.trials.rivals.own import method_of
from missions.trials.rivals.pictures import Sweep, draw_outcomes, draw_sweeps
from missions.trials.rivals.report import (
    TITLES,
    cause_table,
    findings,
    noise_table,
    notes,
    of_path,
    outcome_table,
)
from missions.trials.rivals.score import Ballot, FrameTally, Rule, best_rule, tally
from missions.trials.rivals.stage import Case, Wanted
from missions.trials.rivals.variants import ORB_VARIANTS, XFEAT_VARIANTS, same_look, sentence, told
from missions.trials.shared.trial import TrialRequest, TrialResult, TrialTable
from path.baselines.association import BaselineConfig

TITLE = "Visual ambiguity: which of six similar people is the target"
PAPER = "Receiver-Side Target Acquisition under Visual Ambiguity"
NEEDS = ("renderer", "errors")

FRAMES: dict[Case, int] = {"present": 317, "outside": 17, "hidden": 16}
QUICK_FRAMES: dict[Case, int] = {"present": 4, "outside": 1, "hidden": 1}
DISTANCES_M = (0.5, 0.7, 0.9, 1.3, 2.0)
VIEWPOINTS_DEG = (0.0, 15.0, 30.0, 50.0, 70.0)
QUICK_DISTANCES_M = (0.9,)
QUICK_VIEWPOINTS_DEG = (30.0,)
SWEEP_FRAMES = 20
QUICK_SWEEP_FRAMES = 1
TRIED = 60
QUICK_TRIED = 2
# drones metres apart need a larger marker
WIDE_MARKER_M = 0.15
WIDE_NEAREST_M = (0.8, 2.0)
PATHS = ("path", "path_color")

Variants = dict[str, tuple[BaselineConfig, ...]]


def run(request: TrialRequest) -> TrialResult:
    if request.method is not None:
        method_of(request.method)  # refused before any frame is drawn
    wanted = _wanted(request)
    judged, variants = _judged(request, wanted)
    rules = {"orb": best_rule([each.orb for each in judged], len(variants["orb"]))}
    if request.xfeat is not None:
        rules["xfeat"] = best_rule(_xfeat(judged), len(variants["xfeat"]))
    tallies = tallied(judged, rules)
    sweeps = _sweeps(request, variants, rules)
    sentences = {
        "path": "the method's defaults",
        "path_color": "the same, from colour alone at D2",
        "own": request.method or "",
        **{method: sentence(variants[method], rule) for method, rule in rules.items()},
    }
    return TrialResult(
        summary=_summary(judged, tallies, variants, rules, sweeps),
        findings=findings(tallies),
        noise=noise_table(request.part("errors")(request.rig)),
        tables=(
            outcome_table(tallies, sentences),
            cause_table(judged, rules),
            *(_sweep_table(sweep, request.quick) for sweep in sweeps.values()),
        ),
        pictures=_draw(
            request,
            _tasks(request, 0, wanted, variants),
            judged,
            rules,
            tallies,
            sweeps,
        ),
        notes=notes(judged, request.xfeat is not None),
    )


def _wanted(request: TrialRequest) -> list[Wanted]:
    """Return the conditions of the frames, in an order by chance: the first of them shall be like
    all of them.
    """
    frames = QUICK_FRAMES if request.quick else FRAMES
    wanted = [Wanted(case) for case, count in frames.items() for _ in range(count)]
    return [
        wanted[i]
        for i in np.random.default_rng([request.seed, 2]).permutation(len(wanted)).tolist()
    ]


def _tasks(
    request: TrialRequest,
    part: int,
    wanted: Sequence[Wanted],
    variants: Variants,
) -> list[FrameTask]:
    parts = request.part("renderer"), request.part("errors"), request.rig
    return [
        FrameTask(
            *parts,
            each,
            (request.seed, part, number),
            request.xfeat,
            variants["orb"],
            variants["xfeat"],
            request.method,
        )
        for number, each in enumerate(wanted)
    ]


def _judged(request: TrialRequest, wanted: Sequence[Wanted]) -> tuple[list[FrameResult], Variants]:
    """Every method on every frame, and the variants of the baselines that all frames were given to.

    Features take longest: the first frames say which way of looking for them is best, the others
    keep to it.
    """
    tried = QUICK_TRIED if request.quick else TRIED
    variants: Variants = {"orb": ORB_VARIANTS, "xfeat": XFEAT_VARIANTS}
    first = request.work.map(
        "frames, all variants",
        judge,
        _tasks(request, 0, wanted, variants)[:tried],
    )
    kept = {
        "orb": same_look(
            ORB_VARIANTS, best_rule([each.orb for each in first], len(ORB_VARIANTS)).variant
        )
    }
    if request.xfeat is not None:
        kept["xfeat"] = same_look(
            XFEAT_VARIANTS, best_rule(_xfeat(first), len(XFEAT_VARIANTS)).variant
        )
    chosen = {
        method: tuple(variants[method][i] for i in kept.get(method, ())) for method in variants
    }
    first = [
        replace(
            each,
            orb=each.orb.only(kept["orb"]),
            xfeat=None if each.xfeat is None else each.xfeat.only(kept["xfeat"]),
        )
        for each in first
    ]
    rest = request.work.map("frames", judge, _tasks(request, 0, wanted, chosen)[tried:])
    return first + rest, chosen


def _xfeat(judged: Sequence[FrameResult]) -> list[Ballot]:
    return [each.xfeat for each in judged if each.xfeat is not None]


def tallied(judged: Sequence[FrameResult], rules: Mapping[str, Rule]) -> dict[str, FrameTally]:
    """Outcomes of every method."""
    found = {
        "path": FrameTally.of(of_path(each, each.path) for each in judged),
        "path_color": FrameTally.of(of_path(each, each.path_color) for each in judged),
        "orb": tally([each.orb for each in judged], rules["orb"]),
    }
    own = [(each, each.own) for each in judged if each.own is not None]
    if own:
        found["own"] = FrameTally.of(of_path(each, answer) for each, answer in own)
    if "xfeat" in rules:
        found["xfeat"] = tally(_xfeat(judged), rules["xfeat"])
    return found


def _sweeps(
    request: TrialRequest,
    variants: Variants,
    rules: Mapping[str, Rule],
) -> dict[str, Sweep]:
    """Accuracy over the distance of the nearest look-alike, and over the angle between the views.

    The target is present in all frames. The baselines keep the rules that were best on the main
    frames.
    """
    distances, angles = (
        (QUICK_DISTANCES_M, QUICK_VIEWPOINTS_DEG)
        if request.quick
        else (DISTANCES_M, VIEWPOINTS_DEG)
    )
    count = QUICK_SWEEP_FRAMES if request.quick else SWEEP_FRAMES
    points = [Wanted("present", (distance, distance)) for distance in distances]
    points += [
        Wanted("present", WIDE_NEAREST_M, math.radians(angle), WIDE_MARKER_M) for angle in angles
    ]
    used: Variants = {method: (variants[method][rule.variant],) for method, rule in rules.items()}
    used = {"xfeat": (), **used}
    tasks = _tasks(request, 1, [point for point in points for _ in range(count)], used)
    judged = request.work.map("sweeps", judge, tasks)
    alone = {method: Rule(0, rule.min_inliers, rule.min_lead) for method, rule in rules.items()}
    found = [tallied(judged[k * count : (k + 1) * count], alone) for k in range(len(points))]
    return {
        "distance": ("nearest look-alike, m", distances, found[: len(distances)]),
        "viewpoint": ("angle between the lines of sight, °", angles, found[len(distances) :]),
    }


def _summary(
    judged: Sequence[FrameResult],
    tallies: Mapping[str, FrameTally],
    variants: Variants,
    rules: Mapping[str, Rule],
    sweeps: Mapping[str, Sweep],
) -> dict[str, Any]:
    methods: dict[str, Any] = {}
    for method, counts in tallies.items():
        rule = told(variants[method], rules[method]) if method in rules else "the method's defaults"
        methods[method] = {**counts.summary(), "rule": rule}
    for method in PATHS:
        wrong = [
            owned.answer.agreed
            for each in judged
            if of_path(each, owned := each.path if method == "path" else each.path_color) == "fp"
        ]
        methods[method]["fp_agreed"] = sum(wrong)
    positives = sum(each.present for each in judged)
    return {
        "methods": methods,
        "frames": len(judged),
        "positives": positives,
        "negatives": len(judged) - positives,
        "sweeps": {
            name: {
                "unit": title,
                "values": list(values),
                "methods": {
                    method: [each[method].summary() for each in points] for method in tallies
                },
            }
            for name, (title, values, points) in sweeps.items()
        },
        "xfeat": "xfeat" in rules,
    }


def _sweep_table(sweep: Sweep, quick: bool) -> TrialTable:
    title, values, points = sweep
    rows = tuple(
        (f"{value:g}", *(f"{_percent(counts)}" for counts in point.values()))
        for value, point in zip(values, points, strict=True)
    )
    count = QUICK_SWEEP_FRAMES if quick else SWEEP_FRAMES
    return TrialTable(
        f"Right answers over: {title}", (title, *(TITLES[method] for method in points[0])), rows,
        f"{count} frames a point, the target present in all of them; 95 % intervals in brackets.",
    )  # fmt: skip


def _percent(counts: FrameTally) -> str:
    low, high = counts.interval("tp", "tn")
    return f"{100 * counts.accuracy:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _draw(
    request: TrialRequest,
    tasks: Sequence[FrameTask],
    judged: Sequence[FrameResult],
    rules: Mapping[str, Rule],
    tallies: Mapping[str, FrameTally],
    sweeps: Mapping[str, Sweep],
) -> dict[str, str]:
    draw_outcomes(tallies, TITLES, request.out / "outcomes.png")
    draw_sweeps(list(sweeps.values()), TITLES, request.out / "sweeps.png")
    caption = draw_view(request, tasks, judged, rules)
    return {
        "outcomes.png": "Frames by outcome. Rates are of all frames, as the paper's are.",
        "sweeps.png": "Right answers over the nearest look-alike's distance and over the angle of the views.",
        "examples.png": caption,
    }
