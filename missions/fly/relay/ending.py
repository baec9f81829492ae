"""The end of a relay, or of a team's flights: its outcome, and what is written and shown of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from drivers.log.mcap_log import parts
from drivers.rig.parts import import_factory
from flight.harness.relay import RelayReport
from flight.outcome import Outcome, violated_outcome
from missions.ground.run_folder import write_json
from missions.ground.shown import FolderGone, say_unwritten
from missions.look.report.command import show
from missions.look.report.page import PageOf, write_page
from missions.look.report.records import RunFolderError, by_topic, drone_names
from path.values import frozen

Values = dict[str, Any]
SUMMARY = "summary.json"
PAGE = "run.html"


def cause_of(report: RelayReport, outcome: Outcome, detail: str) -> tuple[Outcome, str]:
    """The outcome of the whole: the harness's own failure and violated monitors first.

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


@frozen
class Showing:
    """The showing of one kind of run at its end.

    Attributes:
        name: of its command, its record and its picture.
        draw: ``module:function`` that draws the picture of a record and a summary.
        why: says of a summary how well it went.
        rows, table: what the page and the terminal show of a summary.
    """

    name: str
    draw: str
    why: Callable[[Values], str]
    rows: Callable[[Values], list[tuple[str, str]]]
    table: Callable[[Values], RenderableType]

    def page(self, summary: Values, folder: Path) -> PageOf:
        asked = " ".join(
            f"--{key} {summary[key]}"
            for key in ("rig", "drones", "targets", "hours", "seed")
            if key in summary
        )
        faults = "".join(f" --fault {fault}" for fault in summary["faults"])
        return PageOf(
            outcome=summary["outcome"],
            good=not summary["exit_code"],
            why=summary["detail"] or self.why(summary),
            command=f"path-handoff {self.name} {asked}{faults}",
            figures=self.rows(summary),
            notes=summary["notes"],
            pictures=[folder / f"{self.name}.png"],
        )


def leave(
    summary: Values, record: Values, folder: Path, showing: Showing, picture_too: bool
) -> int:
    """Write what came of a run and show it; return the exit code, that of a full disk where it
    cannot be written.
    """
    exit_code = int(summary["exit_code"])
    record_file = folder / f"{showing.name}.json"
    picture = folder / f"{showing.name}.png"
    try:
        record_file.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        write_json(folder / SUMMARY, summary)
        if picture_too:
            # matplotlib takes a second
            import_factory(showing.draw, "the picture")(record, summary, picture)
        logs = {name: by_topic(*parts(folder, name)) for name in drone_names(folder)}
        write_page(folder / PAGE, showing.page(summary, folder), logs)
        show(showing.table(summary), sys.stdout)
        names = (SUMMARY, record_file.name, picture.name, PAGE)
        sys.stdout.write(
            f"\n{folder}: {', '.join(name for name in names if (folder / name).exists())}\n"
        )
        sys.stdout.flush()
    except (OSError, RunFolderError) as error:
        say_unwritten(error if isinstance(error, OSError) else FolderGone.of(folder))
        return (
            Outcome.LOG_FAILED.exit_code if exit_code == Outcome.COMMITTED.exit_code else exit_code
        )
    return exit_code
