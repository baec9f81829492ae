"""run.png: a run at a glance. Phases, agreement, separation, and what both cameras saw at the
commit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drivers.log.mcap_log import LogRecord
from missions.look.report.camera_views import draw_view
from missions.look.report.following import following_of
from missions.look.report.palette import COUNT, DIM, FAULT, NEEDED, PHASES, ROLE, tidy
from missions.look.report.records import RunRecords, judged_pairs, last, phase_changes
from missions.look.report.summary import start_ns
from missions.look.report.truth import Truth, truth_of
from path.messages import Role

Clock = Callable[[Role, int], float]
WIDTH_IN = 13.0
HEIGHT_IN = 10.6
DPI = 110
TIMELINE = (0.058, 0.838, 0.931, 0.122)
AGREEMENT = (0.058, 0.543, 0.262, 0.224)
SEPARATION = (0.393, 0.543, 0.262, 0.224)
FOLLOWING = (0.727, 0.543, 0.262, 0.224)
VIEWS = {Role.SENDER: (0.058, 0.046, 0.428, 0.394), Role.RECEIVER: (0.561, 0.046, 0.428, 0.394)}
"""The places of the plots: left, bottom, width and height, as shares of the picture. Found by
matplotlib they take half as long again."""
LETTER_SHARE = 0.0055  # width of a letter, as a share of the timeline


def draw_run(
    run: RunRecords,
    summary: Mapping[str, Any],
    path: Path,
) -> None:
    """Draw a run as PNG. Whatever the records do not hold is left empty. Raises OSError when it
    cannot be written.
    """
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DPI)
    truth = truth_of(run.world)
    seconds = _clock(run, truth)
    figure.suptitle(_title(summary), x=0.012, y=0.992, ha="left", fontsize=13, fontweight="bold")
    _draw_phases(figure.add_axes(TIMELINE), run, seconds)
    _draw_agreement(figure.add_axes(AGREEMENT), run, seconds)
    _draw_separation(figure.add_axes(SEPARATION), run, summary, truth, seconds)
    _draw_following(figure.add_axes(FOLLOWING), run, truth, seconds)
    for role in Role:
        draw_view(figure.add_axes(VIEWS[role]), run, role, truth)
    figure.savefig(path, format="png", metadata={"Software": None})


def _title(summary: Mapping[str, Any]) -> str:
    parts = [
        f"{summary['outcome']}",
        f"rig {summary['rig']}, seed {summary['seed']}",
        *summary["faults"],
    ]
    if summary["agreement_s"] is not None:
        parts.append(f"agreement {summary['agreement_s']:.2f} s")
    if summary["d2_error_m"] is not None:
        parts.append(f"D2 off by {summary['d2_error_m'] * 1000:.1f} mm")
    if summary["target_error_m"] is not None:
        parts.append(f"target off by {summary['target_error_m'] * 1000:.1f} mm")
    return "   ·   ".join(parts)


def _clock(run: RunRecords, truth: Truth | None) -> Clock:
    """Seconds since the run began; on one clock for both roles when the world's log tells their
    offsets.
    """
    starts = {role: start_ns(run, role) for role in Role}
    if truth is None:
        return lambda role, stamp_ns: (stamp_ns - starts[role]) * 1e-9
    begin_ns = min(
        (truth.to_world_ns(role, starts[role]) for role in Role if starts[role]), default=0
    )
    return lambda role, stamp_ns: (truth.to_world_ns(role, stamp_ns) - begin_ns) * 1e-9


def _draw_phases(
    axes: Axes,
    run: RunRecords,
    seconds: Clock,
) -> None:
    """One bar per role; the part where it is responsible is underlined."""
    end_s = 0.0
    bars: list[tuple[float, float, int, str]] = []
    for row, role in enumerate(Role):
        changes = phase_changes(run.role(role))
        stamps = [seconds(role, r.stamp_ns) for r in changes]
        stamps.append(
            seconds(role, max((t[-1].stamp_ns for t in run.role(role).values()), default=0))
        )
        end_s = max(end_s, stamps[-1])
        for k, change in enumerate(changes):
            name = change.record["phase"]
            length = stamps[k + 1] - stamps[k]
            axes.barh(
                row,
                length,
                left=stamps[k],
                height=0.52,
                color=PHASES.get(name, DIM),
                edgecolor="white",
            )
            bars.append((stamps[k], length, row, name))
        for start_s, stop_s in _responsible(
            run.role(role).get("/responsibility", ()),
            role,
            seconds,
            stamps[-1],
        ):
            axes.plot(
                [start_s, stop_s],
                [row + 0.36] * 2,
                color=ROLE[role],
                lw=4,
                solid_capstyle="butt",
            )
    for begin_s, length, row, name in bars:
        if length > LETTER_SHARE * len(name) * end_s:  # else it would run into its neighbours
            axes.text(
                begin_s + length / 2,
                row,
                name,
                ha="center",
                va="center",
                fontsize=8,
                color="#222222",
            )
    _mark_commit(axes, run, seconds)
    axes.set_xlim(0.0, max(end_s, 1e-3))
    axes.set_ylim(1.55, -0.45)
    axes.set_yticks([0, 1], [role.value for role in Role])
    axes.set_xlabel("s    (line below a bar: responsible for the target)", fontsize=8, color=DIM)
    tidy(axes)
    axes.tick_params(axis="y", length=0, labelsize=10)
    axes.spines["left"].set_visible(False)


def _responsible(
    records: Sequence[LogRecord],
    role: Role,
    seconds: Clock,
    end_s: float,
) -> list[tuple[float, float]]:
    """Spans in which a role was responsible."""
    spans: list[tuple[float, float]] = []
    for record, after in zip_longest(records, records[1:]):
        if record.record["responsible"]:
            stop_s = end_s if after is None else seconds(role, after.stamp_ns)
            until_ns = record.record["until_ns"]
            over_s = stop_s if until_ns is None else min(stop_s, seconds(role, until_ns))
            spans.append((seconds(role, record.stamp_ns), over_s))
    return spans


def _draw_agreement(
    axes: Axes,
    run: RunRecords,
    seconds: Clock,
) -> None:
    """IoU of each judged pair against what was needed, and the count."""
    pairs = judged_pairs(run)
    axes.set_title("agreement of the two views", loc="left", fontsize=10)
    axes.set_ylabel("IoU", fontsize=9)
    axes.set_ylim(0.0, 1.02)
    tidy(axes)
    if not pairs:
        _empty(axes, "no pair was judged")
        return
    stamps = np.array([seconds(Role.SENDER, r.stamp_ns) for r in pairs])
    known = np.array([r.record["iou"] is not None for r in pairs])
    agreed = np.array([bool(r.record["agreed"]) for r in pairs])
    iou = np.array([r.record["iou"] if r.record["iou"] is not None else np.nan for r in pairs])
    tau = np.array([r.record["tau"] if r.record["tau"] is not None else np.nan for r in pairs])
    axes.plot(stamps, tau, color=NEEDED, lw=1.4, label="needed (τ)")
    axes.plot(stamps[agreed], iou[agreed], ".", ms=3, color=ROLE[Role.SENDER], label="agreed")
    axes.plot(
        stamps[known & ~agreed],
        iou[known & ~agreed],
        "x",
        ms=5,
        color=FAULT,
        label="does not count",
    )
    missed = ~agreed & ~known
    axes.plot(
        stamps[missed],
        np.full(int(missed.sum()), 0.015),
        "|",
        ms=9,
        color=FAULT,
        label="missed",
    )
    count = axes.twinx()
    # whichever the gate goes by
    name = "count" if pairs[-1].record.get("evidence") is None else "evidence"
    count.plot(
        stamps,
        [r.record[name] for r in pairs],
        color=COUNT,
        lw=1.4,
        label=f"{name} (right)",
    )
    needed = pairs[-1].record["needed" if name == "count" else "evidence_needed"]
    count.axhline(needed, color=COUNT, lw=0.8, ls=":")
    count.set_ylim(0, needed * 1.06)
    count.tick_params(labelsize=8, colors=COUNT)
    for side in ("top", "left", "right"):
        count.spines[side].set_visible(False)
    handles = [*axes.get_lines(), count.get_lines()[0]]
    shown = [line for line in handles if len(np.asarray(line.get_xdata())) > 0]
    _legend(axes, shown)


def _draw_separation(
    axes: Axes,
    run: RunRecords,
    summary: Mapping[str, Any],
    truth: Truth | None,
    seconds: Clock,
) -> None:
    """Between the drones: true where there is a world, and as D2 measured it by the marker."""
    axes.set_title("separation", loc="left", fontsize=10)
    axes.set_ylabel("m", fontsize=9)
    tidy(axes)
    measured = [r for r in run.receiver.get("/marker", ()) if r.record["position_v_m"]]
    if truth is None and not measured:
        _empty(axes, "nothing is known")
        return
    if truth is not None:
        offset_s = seconds(Role.SENDER, truth.scene.clock_offset_ns[Role.SENDER])
        axes.plot(
            truth.stamps_ns * 1e-9 + offset_s,
            truth.separation_m,
            color="#333333",
            lw=1.6,
            label="true, bodies",
        )
    if measured:
        stamps = [seconds(Role.RECEIVER, r.stamp_ns) for r in measured]
        distance = [float(np.linalg.norm(r.record["position_v_m"])) for r in measured]
        axes.plot(
            stamps,
            distance,
            ".",
            ms=1.5,
            color=ROLE[Role.RECEIVER],
            label="D2's camera to the marker",
        )
    if summary["separation_limit_m"] is not None:
        axes.axhline(summary["separation_limit_m"], color=FAULT, lw=1.2, ls="--", label="limit")
    axes.set_ylim(0.0, 1.15 * axes.get_ylim()[1])
    _mark_commit(axes, run, seconds)
    _legend(axes, [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")])


def _draw_following(
    axes: Axes,
    run: RunRecords,
    truth: Truth | None,
    seconds: Clock,
) -> None:
    """D1 from its place behind the target, in truth."""
    axes.set_title("D1 from its place behind the target", loc="left", fontsize=10)
    axes.set_ylabel("m", fontsize=9)
    tidy(axes)
    followed = following_of(run, truth)
    if followed is None or truth is None:
        _empty(axes, "it did not follow, or nothing is known")
        return
    stamps = followed.stamps_ns * 1e-9 + seconds(
        Role.SENDER, truth.scene.clock_offset_ns[Role.SENDER]
    )
    axes.axhline(0.0, color=DIM, lw=0.8, ls=":")
    for column, name, style in ((0, "ahead: past it", "-"), (1, "to the right", "--")):
        axes.plot(
            stamps,
            followed.off_m[:, column],
            color=ROLE[Role.SENDER],
            lw=1.4,
            ls=style,
            label=name,
        )
    axes.set_ylim(-1.0, 1.0)
    _mark_commit(axes, run, seconds)
    _legend(axes, [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")])


def _legend(axes: Axes, lines: Sequence[Line2D]) -> None:
    """Below the plot: it covers nothing."""
    axes.legend(
        handles=list(lines), fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, frameon=False,
        columnspacing=1.2, handlelength=1.6,
    )  # fmt: skip


def _mark_commit(
    axes: Axes,
    run: RunRecords,
    seconds: Clock,
) -> None:
    commit = last(run.sender, "/commit")
    if commit is not None:
        x = seconds(Role.SENDER, commit.stamp_ns)
        axes.axvline(x, color="#2a9d3a", lw=1.5)
        axes.annotate(
            "commit", (x, 1.0), (-3, -2), xycoords=("data", "axes fraction"), textcoords="offset points", va="top",
            ha="right", fontsize=8, color="#2a9d3a",
        )  # fmt: skip


def _empty(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=DIM)
