"""S12, the monitor of what is handed over: judged after a run, by its logs against the world's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from flight.harness.flights import FlightReport, FlightRequest, Harness
from flight.outcome import OBJECT_MONITOR
from missions.look.report.records import RunFolderError, last, load_run
from missions.look.report.truth import handed_over, truth_of
from path.messages import Role

NEEDED = ("/scene", "/truth", "/commit", "/agreement", "/candidate")
"""Topics by which the object that was handed over is known."""


def fly_watched(harness: Harness, request: FlightRequest) -> FlightReport:
    """A run, and what it handed over held against what was designated."""
    return watch_object(harness.fly(request), request.out)


def watch_object(report: FlightReport, out: Path) -> FlightReport:
    """The report, with S12 among its violations when another object was handed over than the one
    designated.
    """
    try:
        run = load_run(out, NEEDED)
    except RunFolderError:
        return report  # no logs, or damaged ones, which the outcome says
    truth = truth_of(run.world)
    handed = None if truth is None else handed_over(run, truth)
    commit = last(run.sender, "/commit")
    if truth is None or commit is None or handed in (None, truth.scene.target_id):
        return report
    at_s = (truth.to_world_ns(Role.SENDER, commit.stamp_ns) - int(truth.stamps_ns[0])) * 1e-9
    what = f"object {handed} was handed over, object {truth.scene.target_id} was designated"
    return replace(
        report,
        violations={**report.violations, OBJECT_MONITOR: 1},
        notes=(*report.notes, f"{OBJECT_MONITOR} at {at_s:.2f} s: {what}"),
    )
