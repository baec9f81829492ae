"""``path-handoff report``, and the end of every run: summary.json, the table, the picture, the
page.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers.collector import collector_off
from drivers.log.mcap_log import parts
from flight.outcome import Outcome
from missions.ground.options.runs import ReportOptions
from missions.ground.run_folder import write_json
from missions.look.report.page import PageOf, write_page
from missions.look.report.records import (
    PAGE,
    PICTURE,
    SUMMARY,
    Records,
    RunFacts,
    RunRecords,
    by_topic,
    drone_names,
    last,
    load_run,
)
from missions.look.report.summary import summarize
from missions.look.report.tables import counts_text, figures_grid, plain_table, sum_of
from path.messages import Role

Rows = list[tuple[str, str]]
HANDED = "t_commit_s"
OF_ANY_FLIGHT = (
    "outcome", "exit_code", "detail", "rig", "level", "seed", "faults", "notes", "errors", "roles", "simulated_s",
    "wall_s", "realtime_factor", "min_separation_m", "separation_limit_m", "link_sent_bytes_per_s", "setpoint_gap_s",
    "monitors", "phases",
)  # fmt: skip
"""What a summary says of a mission in which nothing was handed over."""
_GOOD = (Outcome.COMMITTED.label, Outcome.FLOWN.label)


def run(options: ReportOptions) -> int:
    """``path-handoff report``. Raises RunFolderError."""
    make_report(options.folder, options.picture, sys.stdout)
    return 0


def make_report(folder: Path, picture: bool, stream: TextIO) -> dict[str, Any]:
    """Write summary.json, run.html, and run.png if wanted, into a run's folder; show the table.
    Returns the summary.

    Raises:
        RunFolderError: when the folder is no run's.
        OSError: when it cannot be written to.
    """
    with collector_off():  # of cycles: tens of thousands of records stay to the end
        summary = write_report(folder, picture)
    show(summary_table(summary), stream)
    written = [name for name in (SUMMARY, PICTURE, PAGE) if (folder / name).exists()]
    stream.write(f"\n{folder}: {', '.join(written)}\n")
    return summary


def write_report(folder: Path, picture: bool) -> dict[str, Any]:
    """Write the same, and show nothing. Raises the same."""
    recorded = load_run(folder)
    summary = summarize(recorded)
    own = recorded.facts is not None and recorded.facts.mission
    if own and summary["t_commit_s"] is None:
        summary = {name: summary[name] for name in OF_ANY_FLIGHT}
    write_json(folder / SUMMARY, summary)
    if picture and HANDED in summary:
        from missions.look.report.picture import draw_run  # noqa: PLC0415 (matplotlib takes a second to import)

        draw_run(recorded, summary, folder / PICTURE)
    write_page(folder / PAGE, _page_of(recorded, summary, folder), _logs(recorded, folder))
    return summary


def _logs(recorded: RunRecords, folder: Path) -> dict[str, Records]:
    """The records of all drones' logs: of the two roles as they were read, whoever else there is
    from the folder.
    """
    known = {role.value: recorded.role(role) for role in Role}
    return {name: known.get(name) or by_topic(*parts(folder, name)) for name in drone_names(folder)}


def _page_of(recorded: RunRecords, summary: Mapping[str, Any], folder: Path) -> PageOf:
    ends = [
        end.record["outcome"] for role in Role if (end := last(recorded.role(role), "/outcome"))
    ]
    outcome = summary["outcome"]
    # of one drone's flight in the field: nobody wrote down the whole
    if recorded.facts is None and ends:
        outcome = next((end for end in ends if end != Outcome.COMMITTED.label), ends[0])
    why = summary["detail"] if recorded.facts and summary["detail"] else _ending(recorded, summary)
    return PageOf(
        outcome=outcome,
        good=outcome in _GOOD,
        why=why,
        command=_command(recorded.facts),
        figures=_figure_rows(summary),
        notes=[note for note in summary["notes"] if note != summary["detail"]],
        pictures=[folder / PICTURE],
    )


def _ending(recorded: RunRecords, summary: Mapping[str, Any]) -> str:
    """Return how a run ended, in a sentence; of one drone's flight in the field as well, which has
    no facts.
    """
    if summary["outcome"] == Outcome.FLOWN.label:
        return Outcome.FLOWN.meaning
    if summary["outcome"] == Outcome.COMMITTED.label:
        return (
            f"{Outcome.COMMITTED.meaning}, {figure(summary['t_commit_s'], 's', 1)} after the start"
        )
    ends = [f"{role.value}: {end.record['detail'] or end.record['outcome']}"
            for role in Role if (end := last(recorded.role(role), "/outcome"))]  # fmt: skip
    return "; ".join(ends) or "nobody said how it ended"


def _command(facts: RunFacts | None) -> str:
    if facts is None:
        return "path-handoff sender, or receiver, on the drone"
    faults = "".join(f" --fault {fault}" for fault in facts.faults)
    level = facts.errors.get("level", "")
    said = (f" --errors {level}" if level else "") + (
        f" --scene {facts.scene}" if facts.scene else ""
    )
    flown = f"fly {facts.mission}" if facts.mission else "handoff"
    return f"path-handoff {flown} --rig {facts.rig} --seed {facts.seed}{said}{faults}"


def show(content: RenderableType, stream: TextIO) -> None:
    """Print to a stream, with colour on a terminal only."""
    Console(file=stream, highlight=False, width=None if stream.isatty() else 110).print(content)


def summary_table(summary: Mapping[str, Any]) -> RenderableType:
    """Return the table of one run for a person."""
    shown: list[RenderableType] = [Text(), *outcome_line(summary)]
    shown += [Text(), phase_table(summary["phases"]), Text(), figures_grid(_figure_rows(summary))]
    return Group(*shown)


def outcome_line(summary: Mapping[str, Any]) -> list[Text]:
    """Return how the run ended and what was flown; below it why, and what the harness noticed."""
    good = summary["exit_code"] == 0
    head = Text.assemble(
        (f" {summary['outcome']} ", "bold black on green" if good else "bold white on red")
    )
    head.append(f"  rig {summary['rig']}, seed {summary['seed']}")
    if summary["errors"]:
        head.append(f", errors: {summary['errors']['level']}")
    if summary.get("scene"):
        head.append(f", scene: {summary['scene']}")
    if summary["faults"]:
        head.append(f", faults: {', '.join(summary['faults'])}", "yellow")
    lines = [head]
    if summary["detail"]:
        lines.append(Text(f"  {summary['detail']}", "yellow"))
    return [
        *lines,
        *(Text(f"  {note}", "yellow") for note in summary["notes"] if note != summary["detail"]),
    ]


def phase_table(phases: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """The phases of both drones, side by side."""
    table = plain_table(
        "sender", "from", "for", "receiver", "from", "for", left=("sender", "receiver")
    )
    columns = [
        [(p["phase"], p["start_s"], p["duration_s"]) for p in phases[role.value]] for role in Role
    ]
    for k in range(max(len(column) for column in columns)):
        cells: list[str] = []
        for column in columns:
            if k < len(column):
                name, start_s, duration_s = column[k]
                cells += [name, figure(start_s, "s", 1), figure(duration_s, "s", 1)]
            else:
                cells += ["", "", ""]
        table.add_row(*cells)
    return table


def _figure_rows(s: Mapping[str, Any]) -> Rows:
    """(name, value) in reading order; values that are not known are a dash."""
    if HANDED not in s:
        return [
            ("smallest separation", _separation(s)),
            ("monitors", violations(s["monitors"])),
            ("speed", _speed(s)),
        ]
    frames = [
        f"{name} {figure(f['hz'], 'Hz', 1)}, {figure(f['missed'], 'missed', 0)}"
        for name, f in s["frames"].items()
    ]
    link = [f"{name} {figure(rate, '', 0)}" for name, rate in s["link_sent_bytes_per_s"].items()]
    wrong = {True: "YES", False: "no", None: "-"}[s["wrong_handover"]]
    slow = [("each role's share of a core", f"{s['slow']['share']:g}")] if s["slow"] else []
    shed = [f"{name}: {_seconds(gone)}" for name, gone in s["shed"].items() if gone]
    stepped = [f"{name} {steps}" for name, steps in s["estimator_steps"].items() if steps]
    return [
        ("committed after", figure(s["t_commit_s"], "s", 2)),
        ("agreement took", figure(s["agreement_s"], "s", 2)),
        ("agreeing pairs", _pairs(s)),
        (
            "IoU, median",
            f"{figure(s['iou_median'], '', 3)} (needed {figure(s['tau_median'], '', 3)})",
        ),
        ("misses", counts_text(s["misses"])),
        ("frames", "; ".join(frames)),
        *slow,
        *([("given up", "; ".join(shed))] if shed else []),
        *([("estimator stepped", ", ".join(stepped))] if stepped else []),
        ("error of D2", _error(s, "d2_error")),
        ("error of target", _error(s, "target_error")),
        ("error by both views", _error(s, "target_both_error")),
        ("wrong object handed over", wrong),
        ("kept after taking over", _kept(s)),
        ("smallest separation", _separation(s)),
        ("D1 behind the target", _following(s)),
        ("link, both ways", f"{figure(s['link_bytes_per_s'], 'B/s', 0)} ({', '.join(link)})"),
        ("monitors", violations(s["monitors"])),
        ("speed", _speed(s)),
    ]


def _speed(summary: Mapping[str, Any]) -> str:
    return f"{figure(summary['realtime_factor'], '', 1)} x real time ({figure(summary['wall_s'], 's', 1)})"


def _seconds(gone: Mapping[str, float]) -> str:
    return ", ".join(f"{what} for {seconds:.0f} s" for what, seconds in gone.items())


def _pairs(summary: Mapping[str, Any]) -> str:
    pairs = f"{summary['pairs_agreed']} of {summary['pairs_judged']}, {figure(summary['pairs_hz'], 'Hz', 1)}"
    most = summary["evidence_max"]
    row = summary["in_a_row"]
    if most is None or row is None:
        return pairs
    said = "enough" if row["complete"] else "not enough"
    return f"{pairs}; evidence {most:.1f} at most; by count {row['pairs']} in a row, {said}"


def _error(summary: Mapping[str, Any], name: str) -> str:
    median_m = summary[f"{name}_m"]
    p95_m = summary[f"{name}_p95_m"]
    if median_m is None:
        return "-"
    return f"{median_m * 1000:.1f} mm median, {p95_m * 1000:.1f} mm p95"


def _kept(summary: Mapping[str, Any]) -> str:
    lost = summary.get("lost_after_taking_over")
    if lost is None:
        return "-"
    seconds = figure(summary["kept_s"], "s", 1)
    return f"LOST after {seconds}" if lost else f"for {seconds}, as long as was looked"


def _separation(summary: Mapping[str, Any]) -> str:
    limit = summary["separation_limit_m"]
    return figure(summary["min_separation_m"], "m", 2) + (
        "" if limit is None else f" (limit {limit:.2f} m)"
    )


def _following(summary: Mapping[str, Any]) -> str:
    if summary["follow_overshoot_m"] is None:
        return "-"
    off = figure(summary["follow_error_m"], "m", 2)
    past = figure(summary["follow_overshoot_m"], "m", 2)
    unseen = figure(summary["target_unseen_s"], "s", 1)
    return f"{off} off its place in the median, {past} past it at most, target unseen for {unseen} at most"


def violations(monitors: Mapping[str, int]) -> str:
    """Return the monitors' violations in words."""
    return counts_text(monitors, "no violation")


def figure(value: float | None, unit: str, digits: int) -> str:
    """A number with its unit; a dash when it is not known."""
    return "-" if value is None else f"{value:.{digits}f} {unit}".rstrip()


# --- many runs


def summarize_many(summaries: Sequence[Mapping[str, Any]], command: str) -> dict[str, Any]:
    """Figures over the summaries of several runs; quantiles over the runs that have the figure.

    Args:
        command: what flies the same runs again.
    """
    from scipy.stats import binomtest  # noqa: PLC0415 (takes most of a second to import)

    outcomes = Counter(summary["outcome"] for summary in summaries)
    misses, monitors = (
        sum_of(summary[name] for summary in summaries) for name in ("misses", "monitors")
    )
    names = (
        *(
            "t_commit_s",
            "agreement_s",
            "iou_median",
            "min_separation_m",
            "d2_error_m",
            "target_error_m",
        ),
        "target_both_error_m",
        *("follow_overshoot_m", "follow_error_m", "follow_error_p95_m", "target_unseen_s"),
        *("link_bytes_per_s", "realtime_factor"),
    )
    committed = outcomes["committed"]
    between = binomtest(committed, len(summaries)).proportion_ci(method="wilson")
    return {
        "command": command,
        "runs": len(summaries),
        "outcomes": dict(outcomes),
        "commit_rate": round(committed / len(summaries), 4),
        "commit_rate_interval": [round(between.low, 4), round(between.high, 4)],
        "wrong_handovers": sum(summary["wrong_handover"] is True for summary in summaries),
        "lost_after_taking_over": sum(
            summary.get("lost_after_taking_over") is True for summary in summaries
        ),
        "monitors": dict(monitors),
        "misses": dict(misses),
        "failed_seeds": {
            str(s["seed"]): s["outcome"] for s in summaries if s["outcome"] != "committed"
        },
        **{name: _quantiles([s[name] for s in summaries if s[name] is not None]) for name in names},
    }


def series_table(series: Mapping[str, Any]) -> RenderableType:
    """Return the table of several runs for a person."""
    low, high = (100 * end for end in series["commit_rate_interval"])
    between = f"{low:.1f} to {high:.1f} with 95 % confidence"
    rows = [
        ("runs", f"{series['runs']}: {counts_text(series['outcomes'])}"),
        ("committed", f"{series['commit_rate'] * 100:.1f} % ({between})"),
        ("wrong object handed over", str(series["wrong_handovers"])),
        ("lost after taking over", str(series["lost_after_taking_over"])),
        ("monitors", violations(series["monitors"])),
        ("misses", counts_text(series["misses"])),
    ]
    if series["failed_seeds"]:
        rows.append(("seeds without a commit", counts_text(series["failed_seeds"])))
    table = plain_table("", "min", "median", "p95", "max")
    for name, quantiles in series.items():
        if isinstance(quantiles, dict) and "median" in quantiles:
            table.add_row(
                name, *(f"{quantiles[key]:.4g}" for key in ("min", "median", "p95", "max"))
            )
    return Group(Text(), figures_grid(rows), Text(), table)


def _quantiles(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    low, median, p95, high = (round(float(np.percentile(values, q)), 4) for q in (0, 50, 95, 100))
    return {"min": low, "median": median, "p95": p95, "max": high}
