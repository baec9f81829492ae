"""The cost of every stage of PATH, held against ORB and XFeat on the same frames."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from missions.look.report.palette import COUNT, DIM, FAULT, NEEDED, ROLE, tidy
from missions.trials.cost.compute.film import SIZES, shoot_film
from missions.trials.cost.compute.path import DETECTORS, GEOMETRY, MESSAGES, SUMS
from missions.trials.cost.compute.photographs import PhotographTimes, time_photographs
from missions.trials.cost.compute.rounds import (
    HOT,
    QUICK,
    Array,
    ComputePlan,
    Timings,
    median_ms,
    p99_ms,
    time_all,
)
from missions.trials.shared.drawing import save, sheet
from missions.trials.shared.statistics import Statistic, bootstrap, figure_of, medians, percentiles
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.messages import Role

TITLE = "Compute: every stage of PATH against ORB and XFeat, one thread, same frames"
PAPER = "Hardware Performance"
NEEDS = ("renderer",)

# on photographs: the budget of a marker's pose on real frames of 1280x720
REAL_MEDIAN_MS = 1.5
REAL_P99_MS = 3.0
SEARCH_MS = 12.0  # of a whole photograph
MARKER_GOALS_MS = {"640x480": 1.3, "1280x720": 2.0}
CYCLE_GOAL_MS = 2.5
LOG_GOAL = 0.05
TITLES = {
    "d1_depth": "D1 depth over the box",
    "d1_target": "D1 back-projection, point in v",
    "d2_take": "D2 take target, gravity then",
    "d2_marker_detect": "D2 marker: find it where expected",
    "d2_marker_fit": "D2 marker: photometric corners",
    "d2_marker_pose": "D2 marker: pose with gravity",
    "d2_marker_filter": "D2 marker: filter, gates, region",
    "d2_marker": "D2 marker, all of it",
    "d2_prior": "D2 prior and its covariance",
    "d2_candidate": "D2 choice of the box",
    "d1_judge": "D1 box mapped back, IoU, window",
    "encode_target": "encode and sign target",
    "decode_target": "verify and decode target",
    "encode_candidate": "encode and sign candidate",
    "decode_candidate": "verify and decode candidate",
    HOT: "geometry, nothing between",
    "geometry": "geometry, both sides",
    "geometry_and_depth": "geometry and depth",
    "path_without_messages": "PATH without detectors, messages",
    "path": "PATH without detectors",
    "d1_log": "D1 log, whole",
    "d2_log": "D2 log, whole",
    "d1_cycle": "D1's cycle as flown, no detector",
    "d2_cycle": "D2's cycle as flown, no detector",
    "d1_detector": "colour detector, D1's region",
    "d2_detector": "colour detector, D2's region",
    "orb_boxes": "ORB cycle, in the boxes",
    "orb_whole": "ORB cycle, whole frames",
    "orb_features": "ORB features of both frames, alone",
    "xfeat_boxes": "XFeat cycle, in the boxes",
    "xfeat_whole": "XFeat cycle, whole frames",
    "xfeat_features": "XFeat features of both frames, alone",
}
COUNTED = {
    HOT: "geometry alone",
    "geometry": "geometry in the cycle",
    "path": "PATH with the marker's pose",
}
PICTURE = "compute.png"
MS = 1000.0
LEFT_MS = 4e-3  # where the picture begins


def run(request: TrialRequest) -> TrialResult:
    plan = QUICK if request.quick else ComputePlan()
    sizes = tuple(SIZES)[:1] if request.quick else tuple(SIZES)
    real = [time_photographs(file, request.photographs, request.seed) for file in request.sets]
    timings = {
        size: time_all(request, shoot_film(request, size, plan.frames), plan) for size in sizes
    }
    rng = np.random.default_rng([request.seed, 8])
    ratios = {size: _ratios(timing, rng) for size, timing in timings.items()}
    _draw(timings, request.out / PICTURE)
    stages = {
        size: {
            name: {"median_ms": median_ms(timing[name]), "p99_ms": p99_ms(timing[name])}
            for name in TITLES
            if name in timing
        }
        for size, timing in timings.items()
    }
    return TrialResult(
        summary={
            "photographs": {each.name: each.summary() for each in real},
            "stages": stages,
            "ratios": ratios,
            "machine": _machine(),
        },
        findings=(*_real_findings(real), *_budget_findings(timings, rng), *_ratio_findings(ratios)),
        noise=_conditions(plan),
        tables=(_stage_table(timings), _counted_table()),
        pictures={
            PICTURE: "Median time of stages and cycles; thin lines reach to the 99th percentile.",
        },
        notes=_notes(request),
    )


def _real_findings(real: Sequence[PhotographTimes]) -> list[TrialFinding]:
    """The marker's pose on photographs. OpenCV's detector on the same ones says how fast the machine
    is.
    """
    findings: list[TrialFinding] = []
    for each in real:
        told = each.summary()
        size = f"{each.camera.width}x{each.camera.height}"
        note = f"{told['looks']} looks; OpenCV's detector on the whole photograph: {told['opencv_median_ms']:.1f} ms"
        for name, key, goal in (
            ("marker's pose while tracking, median", "median_ms", REAL_MEDIAN_MS),
            ("marker's pose while tracking, p99", "p99_ms", REAL_P99_MS),
            ("a marker searched for everywhere, median", "search_median_ms", SEARCH_MS),
        ):
            ms = told[key]
            findings.append(
                TrialFinding(f"{each.name}: {name}, {size}, ms", f"{ms:.2f}", goal=f"≤ {goal:g}", note=note,
                             verdict=verdict(ms <= goal))
            )  # fmt: skip
    return findings


def _ratios(timing: Timings, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Return how many times a baseline's cycle costs what PATH does: medians, interval by
    resampling blocks.
    """
    found: dict[str, dict[str, float]] = {}
    for method in (name for name in timing if name.startswith(("orb_", "xfeat_"))):
        for counted in COUNTED:
            ours = np.median(timing[counted], axis=1)
            theirs = np.median(timing[method], axis=1)
            blocks = np.column_stack((theirs, ours))
            low, high = bootstrap(blocks, _ratios_of, rng)
            found[f"{counted}_vs_{method}"] = {
                "ratio": figure_of(_ratios_of, blocks),
                "low": low,
                "high": high,
            }
    return found


def _ratios_of(samples: Array) -> Array:
    return np.asarray(
        np.median(samples[..., 0], axis=1) / np.median(samples[..., 1], axis=1), np.float64
    )


def _budget_findings(
    timings: Mapping[str, Timings], rng: np.random.Generator
) -> Sequence[TrialFinding]:
    findings: list[TrialFinding] = []

    def add(
        size: str, quantity: str, name: str, statistic: Statistic, goal_ms: float | None = None
    ) -> None:
        us = timings[size][name]
        ours = figure_of(statistic, us) / MS
        low, high = bootstrap(us, statistic, rng)
        findings.append(
            TrialFinding(
                f"{quantity}, {size}, ms",
                f"{ours:.3f}",
                f"{low / MS:.3f} to {high / MS:.3f}",
                goal="" if goal_ms is None else f"≤ {goal_ms:g}",
                verdict="measured" if goal_ms is None else verdict(ours <= goal_ms),
            )
        )

    for size in timings:
        add(size, "geometry of both sides, nothing between its stages, median", HOT, medians)
        add(size, "geometry of both sides, within a whole cycle, median", "geometry", medians)
    for size in timings:
        add(size, "marker's pose while tracking, p99", "d2_marker", _p99s, MARKER_GOALS_MS[size])
    for size in timings:
        for number in (1, 2):
            name = f"whole cycle of D{number} as flown, without its detector, p99"
            add(size, name, f"d{number}_cycle", _p99s, CYCLE_GOAL_MS)
    findings += [
        _log_finding(timing, size, number) for size, timing in timings.items() for number in (1, 2)
    ]
    return findings


def _log_finding(timing: Timings, size: str, number: int) -> TrialFinding:
    """Return how much of a cycle goes into its log."""
    share = median_ms(timing[f"d{number}_log"]) / median_ms(timing[f"d{number}_cycle"])
    return TrialFinding(
        f"log of D{number}, {size}, share of its cycle", f"{share:.3f}", "of medians", "", f"≤ {LOG_GOAL:g}",
        verdict(share <= LOG_GOAL),
    )  # fmt: skip


def _p99s(samples: Array) -> Array:
    return percentiles(samples, 99.0)


def _ratio_findings(ratios: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[TrialFinding]:
    findings: list[TrialFinding] = []
    for size, found in ratios.items():
        for name, ratio in found.items():
            counted, method = name.split("_vs_")
            slow = "Mostly matching of 4096 features in numpy: see XFeat's features alone."
            findings.append(
                TrialFinding(
                    f"{TITLES[method]} / {COUNTED[counted]}, {size}, ratio",
                    f"{ratio['ratio']:.1f}",
                    f"{ratio['low']:.1f} to {ratio['high']:.1f}",
                    note=slow if method == "xfeat_whole" else "",
                )
            )
    return findings


def _machine() -> dict[str, str | int]:
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count() or 1,
        "python": platform.python_version(),
        "opencv": version("opencv-contrib-python-headless"),
        "numba": version("numba"),
        "onnxruntime": version("onnxruntime"),
    }


def _cpu() -> str:
    """The processor's name where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _conditions(plan: ComputePlan) -> TrialTable:
    machine = ", ".join(f"{name} {value}" for name, value in _machine().items())
    return TrialTable(
        "How it was timed",
        ("what", "how"),
        (
            ("machine", machine),
            ("time", "that the thread kept a core busy; what the clock itself takes is taken off"),
            ("threads", "one; numpy's matrix product in XFeat's matching may use more, which are not counted"),
            ("frames", f"{plan.frames} rendered pairs: swaying drones, four cars; the same for all methods"),
            ("rounds", f"{plan.blocks}: {plan.path} PATH, {plan.orb} ORB, {plan.xfeat} XFeat cycles, order turning"),
            ("intervals", "95 %, rounds resampled"),
            ("log", "as in flight: every record a write to the file; in the cycles as flown only"),
            ("not counted", "cameras, event loop, sockets, pictures in the log"),
        ),
    )  # fmt: skip


def _stage_table(timings: Mapping[str, Timings]) -> TrialTable:
    names = [name for name in TITLES if any(name in timing for timing in timings.values())]
    rows = tuple(
        (TITLES[name], *(text for timing in timings.values() for text in _two(timing, name)))
        for name in names
    )
    columns = tuple(text for size in timings for text in (f"{size} median", "p99"))
    return TrialTable(
        "Time of each stage, ms",
        ("", *columns),
        rows,
        "Decoding and pose are measured again by themselves; photometric corners and filter are what is left.",
    )


def _two(timing: Timings, name: str) -> tuple[str, str]:
    return f"{median_ms(timing[name]):.3f}", f"{p99_ms(timing[name]):.3f}"


def _counted_table() -> TrialTable:
    def stages(names: tuple[str, ...]) -> str:
        return "; ".join(TITLES[name] for name in names)

    return TrialTable(
        "What is counted",
        ("name", "stages"),
        (
            ("geometry, both sides", stages(GEOMETRY)),
            ("PATH without detectors", stages(SUMS["path"])),
            ("messages", stages(MESSAGES)),
            ("D1's cycle as flown", stages(SUMS["d1_cycle"])),
            ("D2's cycle as flown", stages(SUMS["d2_cycle"])),
            ("ORB, XFeat in the boxes", "features in enlarged windows around D1's and all of D2's boxes, ratio test, "
             "mutual check, affine RANSAC, choice; the boxes are given"),
            ("ORB, XFeat on whole frames", "features of both frames (XFeat: at 640 px), matched and verified alike; no "
             "box is needed"),
            ("in neither", stages(DETECTORS)),
        ),
    )  # fmt: skip


def _notes(request: TrialRequest) -> tuple[str, ...]:
    notes = [
        "The paper ran on a Jetson Nano and gives no times, only that PATH keeps 30–60 Hz and that the baselines load "
        "the board. Ratios carry over to another machine better than times do, but not exactly.",
        "Both ratios are given because 'PATH without the detector' can be read both ways: the geometry alone, which "
        "the paper argues with, and all that PATH runs besides the object detectors, the marker's pose included.",
        "The baselines match in numpy, as PATH's geometry is Python, which takes long on whole frames. What a faster "
        "matcher could leave of them at best is the row of their features alone.",
    ]
    if not request.sets:
        notes.append(
            "No photographs were named (--set): drawn frames need less of a fit than real ones do."
        )
    if request.xfeat is None:
        notes.append("XFeat was left out: its weights were not named (--xfeat FILE).")
    return tuple(notes)


def _draw(timings: Mapping[str, Timings], path: Path) -> None:
    figure = sheet(6.2 * len(timings) + 1.5, 6.6)
    for number, (size, timing) in enumerate(timings.items()):
        axes = figure.add_subplot(1, len(timings), number + 1)
        _draw_stages(axes, timing, labels=number == 0)
        axes.set_title(size, loc="left", fontsize=10)
    save(figure, path)


def _draw_stages(axes: Axes, timing: Timings, labels: bool) -> None:
    names = [name for name in reversed(TITLES) if name in timing]
    medians = [max(median_ms(timing[name]), LEFT_MS) for name in names]
    widths = [median - LEFT_MS for median in medians]
    axes.barh(
        range(len(names)), widths, 0.66, left=LEFT_MS, color=[_colour(name) for name in names]
    )
    for row, name in enumerate(names):
        axes.plot(
            [medians[row], max(p99_ms(timing[name]), LEFT_MS)], [row, row], color=NEEDED, lw=0.8
        )
        axes.text(
            max(p99_ms(timing[name]), medians[row]) * 1.15,
            row,
            f"{medians[row]:.3g}",
            va="center",
            fontsize=7,
        )
    axes.set_xscale("log")
    axes.set_xlim(LEFT_MS, 4e3)
    axes.set_yticks(
        range(len(names)), [TITLES[name] for name in names] if labels else [""] * len(names)
    )
    axes.axvline(min(MARKER_GOALS_MS.values()), color=DIM, lw=0.8, ls="--")
    axes.set_xlabel("ms, median    (dashed: goal of the marker)", fontsize=8)
    tidy(axes)


def _colour(name: str) -> str:
    if name.startswith(("orb", "xfeat")):
        return FAULT
    if name in SUMS or name in (HOT, "d2_marker"):
        return COUNT
    if name in DETECTORS:
        return DIM
    return (
        ROLE[Role.SENDER]
        if name.startswith("d1_") or name.endswith("_target")
        else ROLE[Role.RECEIVER]
    )
