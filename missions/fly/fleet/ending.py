"""The end of a relay, or of a team's flights: its outcome, and what is written and shown of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from drivers.log.mcap_log import parts
from flight.harness.relay import RelayReport
from flight.outcome import Outcome, violated_outcome
from missions.fly.fleet.report import fleet_rows, fleet_table
from missions.fly.relay.crew import Crew
from missions.ground.lateness import for_lateness
from missions.ground.run_folder import write_json
from missions.ground.shown import FolderGone, say_unwritten
from missions.look.report.command import show
from missions.look.report.page import PageOf, write_page
from missions.look.report.records import RunFolderError, by_topic, drone_names

Values = dict[str, Any]
SUMMARY = "summary.json"
PAGE = "run.html"


def judge(base: Crew[Any, Any], report: RelayReport) -> tuple[Outcome, str]:
    """Return the outcome of the whole: what a computer that was too slow explains is blamed on
    nobody else.
    """
    return for_lateness(report, *_cause_of(report, base.outcome, base.detail))


def _cause_of(
    report: RelayReport,
    outcome: Outcome,
    detail: str,
) -> tuple[Outcome, str]:
    """The harness's own failure and violated monitors first.

    Args:
        outcome: as the ground has it, with its ``detail``.
    """
    if report.failure:
        return Outcome.HARNESS_FAILED, report.failure
    if report.violations:
        return violated_outcome(report.violations), "; ".join(report.notes[:3])
    if report.interrupted:
        return Outcome.INTERRUPTED, Outcome.INTERRUPTED.meaning
    if outcome is Outcome.COMMITTED and report.log_failure:
        return Outcome.LOG_FAILED, report.log_failure
    return outcome, detail


def leave(
    summary: Values,
    record: Values,
    folder: Path,
    picture_too: bool,
) -> int:
    """Write what came of a run and show it; return the exit code, that of a full disk where it
    cannot be written.
    """
    exit_code = int(summary["exit_code"])
    name = "team" if "targets" in summary else "relay"
    record_file = folder / f"{name}.json"
    picture = folder / f"{name}.png"
    try:
        record_file.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        write_json(folder / SUMMARY, summary)
        if picture_too:
            from missions.fly.fleet.picture import draw  # noqa: PLC0415 (matplotlib takes a second)

            draw(record, summary, picture)
        logs = {name: by_topic(*parts(folder, name)) for name in drone_names(folder)}
        write_page(folder / PAGE, _page(name, summary, picture), logs)
        show(fleet_table(summary), sys.stdout)
        names = (SUMMARY, record_file.name, picture.name, PAGE)
        sys.stdout.write(
            f"\n{folder}: {', '.join(name for name in names if (folder / name).exists())}\n"
        )
        sys.stdout.flush()
    except (OSError, RunFolderError) as error:
        say_unwritten(error if isinstance(error, OSError) else FolderGone.of(folder))
        return exit_code or Outcome.LOG_FAILED.exit_code
    return exit_code


def _page(
    name: str,
    summary: Values,
    picture: Path,
) -> PageOf:
    asked = " ".join(
        f"--{key} {summary[key]}"
        for key in ("rig", "drones", "targets", "hours", "seed")
        if key in summary
    )
    faults = "".join(f" --fault {fault}" for fault in summary["faults"])
    handed_over = f"{summary['legs_handed_over']} of {summary['legs']} legs handed over"
    observed = summary["observed_percent"]["all"]
    watched = "nothing observed" if observed is None else f"{observed:.2f} % of the time observed"
    return PageOf(
        outcome=summary["outcome"],
        good=not summary["exit_code"],
        why=summary["detail"] or f"{handed_over}, {watched}",
        command=f"path-handoff {name} {asked}{faults}",
        figures=fleet_rows(summary),
        notes=summary["notes"],
        pictures=[picture],
    )
