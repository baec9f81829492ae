"""The reasons for the thresholds: a sweep over recorded series of true and of wrong pairs, and a stated rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from missions.trials.handshake.handovers import runner_of
from missions.trials.shared.statistics import upper_bound, wilson
from missions.trials.shared.trial import TrialFinding, TrialPicture, TrialRequest, TrialResult, TrialTable
from missions.trials.thresholds import series
from missions.trials.thresholds.choice import (
    MAY_COST,
    PAPER_N,
    RocCurve,
    Shares,
    choose,
    commits,
    curve,
    difference,
    halves,
    index_of,
)
from missions.trials.thresholds.grid import FRAMES, MAPPINGS, RIGHT, WRONG, Setting, grid
from missions.trials.thresholds.pictures import draw_map, draw_roc
from missions.trials.thresholds.series import WAYS, GridAttempt, Rolled

TITLE = "Thresholds: tau_min, tau_max, z0, N and the mapping of the box, swept over recorded agreements"
PAPER = "Adaptive threshold and temporal verification"

TRUE, EACH_WAY, EACH_ROLL = 420, 80, 10
QUICK_TRUE, QUICK_EACH_WAY, QUICK_EACH_ROLL = 14, 4, 1
ROC, MAP = "thresholds-roc.png", "thresholds-map.png"
STEP = 5  # of the points of a ROC in the summary, in hundredths


def run(request: TrialRequest) -> TrialResult:
    rig = str(request.rig.file)
    runner = runner_of(rig)  # compiled here, before two processes would do it twice
    sizes = (QUICK_TRUE, QUICK_EACH_WAY, QUICK_EACH_ROLL) if request.quick else (TRUE, EACH_WAY, EACH_ROLL)
    asked = [*series.true_attempts(rig, request.seed, sizes[0]), *series.wrong_attempts(rig, request.seed, sizes[1])]
    tried = request.work.map("series", series.sweep, asked)
    rolled = request.work.map("rolled cameras", series.roll, series.rolled_attempts(rig, request.seed, sizes[2]))
    rng = np.random.default_rng([request.seed, 13])
    to_choose, to_report = halves(tried)
    chosen, default = choose(Shares.of(to_choose)), index_of(Setting.of(request.rig.method))
    shares = Shares.of(to_report)
    curves = [each for each in (curve(tried, mapping, rng) for mapping in MAPPINGS) if each is not None]
    draw_roc(curves, Shares.of(tried), rolled, default, chosen, request.out / ROC)
    draw_map(Shares.of(tried), default, chosen, request.out / MAP)
    summary = _summary(tried, to_report, curves, shares, default, chosen, rng)
    return TrialResult(
        summary=summary,
        findings=_findings(summary, curves),
        noise=TrialTable("What Monte-Carlo hand-overs are drawn from", ("what", "how much"), runner.conditions()),
        tables=(
            _settings_table(tried, {"default": default, "chosen": chosen}),
            _ways_table(tried, default, chosen),
            _windows_table(tried, default),
            _roll_table(rolled),
        ),
        pictures=(
            TrialPicture(
                ROC, "Pairs: a fixed threshold from 0 to 1. Hand-overs: a dot for each setting. Both mappings."
            ),
            TrialPicture(MAP, "Hand-overs in time and wrong ones over both thresholds, in percent of the attempts."),
        ),
        notes=_notes(len(to_choose), len(to_report)),
    )


# --- figures ------------------------------------------------------------------------------------------------------


def _summary(
    tried: Sequence[GridAttempt],
    to_report: Sequence[GridAttempt],
    curves: Sequence[RocCurve],
    shares: Shares,
    default: int,
    chosen: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    everything = Shares.of(tried)
    return {
        "attempts": {"true": sum(not each.way for each in tried), "forced": sum(bool(each.way) for each in tried)},
        "auc": {each.mapping: {"value": each.auc, "interval": list(each.interval)} for each in curves},
        "roc_pairs": {
            each.mapping: [
                {"tau": round(float(each.tau[k]), 2), "true": float(each.true[k]), "false": float(each.false[k])}
                for k in range(0, len(each.tau), STEP)
            ]
            for each in curves
        },
        "roc_hand_overs": [
            {**_as_dict(setting), "true": float(everything.right[k, PAPER_N]), "wrong": float(w)}
            for k, (setting, w) in enumerate(zip(grid(), everything.wrong[:, PAPER_N], strict=True))
        ],
        "chosen": _held_out(to_report, shares, chosen),
        "default": _held_out(to_report, shares, default),
        "chosen_minus_default": {
            "true": list(difference(to_report, default, chosen, forced=False, rng=rng)),
            "wrong": list(difference(to_report, default, chosen, forced=True, rng=rng)),
        },
        "may_cost": MAY_COST,
    }


def _as_dict(setting: Setting) -> dict[str, Any]:
    return {"mapping": setting.mapping, "tau_min": setting.tau_min, "tau_max": setting.tau_max, "z0_m": setting.z0_m}


def _held_out(tried: Sequence[GridAttempt], shares: Shares, k: int) -> dict[str, Any]:
    """Returns the shares of one setting with the paper's window, on attempts that were not chosen on."""
    beside = [each for each in tried if each.way in (series.ABSENT, series.NEAR) and _distance(each) >= 0.3]
    wrong = sum(each.outcomes.commit[k, PAPER_N] == WRONG for each in beside)
    return {
        **_as_dict(grid()[k]),
        "true": float(shares.right[k, PAPER_N]),
        "wrong": float(shares.wrong[k, PAPER_N]),
        "slipped": float(shares.slipped[k, PAPER_N]),
        "right_prior_from_0_3_m": {
            "attempts": len(beside),
            "wrong": int(wrong),
            "upper_95": upper_bound(int(wrong), len(beside)),
        },
    }


def _distance(each: GridAttempt) -> float:
    return each.attempt.wrong.distance_m if each.attempt.wrong is not None else 0.0


# --- findings and tables ------------------------------------------------------------------------------------------


def _findings(summary: dict[str, Any], curves: Sequence[RocCurve]) -> tuple[TrialFinding, ...]:
    default, chosen, off = summary["default"], summary["chosen"], summary["chosen_minus_default"]
    alone = default["right_prior_from_0_3_m"]
    found = [
        TrialFinding(f"one pair: ROC area, mapping {each.mapping}", f"{each.auc:.4f}", _span(each.interval, 4),
                note=f"{each.pairs[0]} pairs of the target, {each.pairs[1]} of something else; attempts resampled")
        for each in curves
    ]  # fmt: skip
    return (
        *found,
        TrialFinding("setting chosen by the rule", _words(chosen), "", note=_RULE),
        TrialFinding("default setting", _words(default)),
        TrialFinding("true hand-overs in time, chosen minus default, percentage points",
                f"{100 * (chosen['true'] - default['true']):+.1f}", _span([100 * v for v in off["true"]], 1),
                note=f"default {default['true']:.1%}, on attempts that were not chosen on; all kinds of fault"),
        TrialFinding("forced wrong hand-overs, chosen minus default, percentage points",
                f"{100 * (chosen['wrong'] - default['wrong']):+.1f}", _span([100 * v for v in off["wrong"]], 1),
                note=f"default {default['wrong']:.1%} of attempts in which D2 always answers with something else"),
        TrialFinding("wrong hand-overs when the prior is right and the look-alike 0.3 m away or farther, default",
                f"{alone['wrong']} of {alone['attempts']}", f"≤ {alone['upper_95']:.1%}", "", "0",
                "met" if alone["wrong"] == 0 else "short"),
    )  # fmt: skip


_RULE = (
    f"the strictest that costs next to nothing: of all settings that lose at most {MAY_COST:.0%} of the true attempts "
    "against the best one, the fewest wrong hand-overs with 350 pairs, then with 25, then the most true ones"
)


def _words(setting: dict[str, Any]) -> str:
    return f"{setting['mapping']}, {setting['tau_min']:g} to {setting['tau_max']:g}, z0 {setting['z0_m']:g} m"


def _span(ends: Sequence[float], digits: int) -> str:
    return f"{ends[0]:.{digits}f} to {ends[1]:.{digits}f}"


def _share(count: int, total: int) -> str:
    low, high = wilson(count, total)
    return f"{count / total:.1%} ({low:.1%}-{high:.1%})" if total else "none"


def _settings_table(tried: Sequence[GridAttempt], named: dict[str, int]) -> TrialTable:
    """The chosen one, the default one, and fixed thresholds."""
    true, forced = commits(tried, forced=False), commits(tried, forced=True)
    fixed = [("fixed", k) for k, setting in enumerate(grid()) if setting.tau_min == setting.tau_max]
    rows: list[tuple[str, ...]] = []
    for name, k in [*named.items(), *fixed]:
        setting = grid()[k]
        right, slipped = (int(np.sum(true[:, k, PAPER_N] == what)) for what in (RIGHT, WRONG))
        wrong = int(np.sum(forced[:, k, PAPER_N] == WRONG))
        z0 = f"{setting.z0_m:g}" if setting.tau_min < setting.tau_max else ""
        rows.append((name, setting.mapping, f"{setting.tau_min:g}", f"{setting.tau_max:g}", z0,
                     _share(right, len(true)), str(slipped), _share(wrong, len(forced))))  # fmt: skip
    return TrialTable(
        "Settings with 350 pairs, all attempts",
        ("", "mapping", "tau_min", "tau_max", "z0, m", "true, in time", "something else instead", "forced wrong"),
        tuple(rows),
        f"In time: within {series.TRUE_LIMIT_S:g} s, most of which have a fault that takes part of them.",
    )


def _ways_table(tried: Sequence[GridAttempt], default: int, chosen: int) -> TrialTable:
    rows: list[tuple[str, ...]] = []
    for way in WAYS:
        some = [each for each in tried if each.way == way]
        for distance in sorted({_distance(each) for each in some}):
            own = [each for each in some if _distance(each) == distance]
            cells = [
                _share(sum(each.outcomes.commit[k, n] == WRONG for each in own), len(own))
                for k, n in ((default, PAPER_N), (chosen, PAPER_N), (default, 0))
            ]
            pairs = sum(int(each.outcomes.pairs[0, 0].sum()) for each in own)
            rows.append((way, f"{distance:g}", str(len(own)), f"{pairs}", *cells))
    return TrialTable(
        "Wrong hand-overs by what is forced",
        (
            "what is forced",
            "look-alike, m",
            "attempts",
            "pairs",
            "default, 350",
            "chosen, 350",
            f"default, {FRAMES[0]}",
        ),
        tuple(rows),
        "No pairs: the look-alike is outside the region where D2 looks. Where D2's pose itself puts the prior on the "
        "look-alike, the boxes agree by the same wrong pose, and thresholds tell only some.",
    )


def _windows_table(tried: Sequence[GridAttempt], default: int) -> TrialTable:
    true, forced = commits(tried, forced=False), commits(tried, forced=True)
    rows = tuple(
        (str(frames), _share(int(np.sum(true[:, default, n] == RIGHT)), len(true)),
         str(int(np.sum(true[:, default, n] == WRONG))),
         _share(int(np.sum(forced[:, default, n] == WRONG)), len(forced)))
        for n, frames in enumerate(FRAMES)
    )  # fmt: skip
    return TrialTable(
        "Length of the window, default thresholds",
        ("pairs", "true, in time", "something else instead", "forced wrong"),
        rows,
        "n pairs also have to last n / 50 s.",
    )


def _roll_table(rolled: Sequence[Rolled]) -> TrialTable:
    rows: list[tuple[str, ...]] = []
    for angle in sorted({each.roll_deg for each in rolled}):
        known = [each.iou for each in rolled if each.roll_deg == angle and each.iou is not None]
        cells = [f"{np.median([iou[k] for iou in known]):.2f}" if known else "no pair" for k in range(len(MAPPINGS))]
        rows.append((f"{angle:g}", str(len(known)), *cells))
    return TrialTable(
        "Overlap on the target when D2's camera is rolled on its mount",
        ("roll, degrees", "attempts with pairs", *(f"mapping {mapping}" for mapping in MAPPINGS)),
        tuple(rows),
        "Both drones know of the roll. The median of all pairs of an attempt, then of all attempts.",
    )


def _notes(to_choose: int, to_report: int) -> tuple[str, ...]:
    return (
        f"{len(grid())} settings and {len(FRAMES)} window lengths judge the same recorded series by the window's own "
        f"rules. The setting is chosen on {to_choose} attempts; what is said of it and of the default is measured on "
        f"{to_report} others.",
        "True attempts carry every kind of fault, from 0.6 to 1.5 times the usual distance. In a forced attempt D2 "
        "answers with a look-alike all the time: far more often than any field has it. Its share is a yardstick "
        "between settings, not a rate.",
        f"A prior beside a look-alike: {series.BESIDE_M:g} m per axis (standard deviation); on it: {series.ON_M:g} m. "
        "The ROC of pairs leaves the latter out.",
        "Three pieces of the method stop a look-alike before any threshold: D2's search region, the margin between two "
        "candidates, the limit on D2's pose. They are at work here as ever.",
    )
