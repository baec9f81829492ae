"""``path-handoff team``: many targets kept observed by many drones for hours, and what came of it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

from drivers.rig.parts import Rig, import_factory, with_errors
from flight.harness.flights import Emit
from flight.harness.relay import RelayField, RelayHarness, RelayRequest, TeamField
from flight.harness.team import TeamConfig
from missions import rig_library
from missions.ground_station import name_ground_station
from missions.lateness import for_lateness
from missions.live.start import live
from missions.options.flights import TeamOptions
from missions.relay.base import Event, Tell
from missions.relay.command import faults_of, hours_of
from missions.relay.drone import program_of
from missions.relay.ending import PAGE, SUMMARY, Showing, Values, cause_of, leave
from missions.report.page import PageOf
from missions.run_folder import RunKind, claimed, unless_refused
from missions.shown import tell_line
from missions.team.base import OwnGround, TeamBase
from missions.team.config import fenced, team_of
from missions.team.flight import TeamFlight
from missions.team.process import processes_of
from missions.team.report import record_of, summarize_team, team_rows, team_table

TEAM, PICTURE = "team.json", "team.png"


def run(options: TeamOptions) -> int:
    """``path-handoff team``; returns the exit code. Raises PartError for what was asked wrongly."""
    rig = with_errors(rig_library.load(options.rig), options.errors)
    name_ground_station(rig, options.gcs)
    config = team_of(rig, options.drones, options.targets)
    rig, hours = fenced(rig, config), hours_of(config, options)
    with unless_refused(options.out) as folder:
        tell_line(f"{len(config.drones)} drones, {len(config.targets)} targets, {hours:g} h: {folder}")
        with live(options.live, folder):
            summary, record = fly_team(rig, config, options, folder, tell)
    draw = _draw if options.picture else None
    return leave(summary, record, folder, Showing(TEAM, PICTURE, draw, _page_of, team_table))


def _draw(record: Values, summary: Values, path: Path) -> None:
    from missions.team.picture import draw_team  # noqa: PLC0415 (matplotlib takes a second to import)

    draw_team(record, summary, path)


def _page_of(summary: dict[str, Any], folder: Path) -> PageOf:
    faults = "".join(f" --fault {fault}" for fault in summary["faults"])
    size = f"--drones {summary['drones']} --targets {summary['targets']}"
    asked = f"--rig {summary['rig']} {size} --hours {summary['hours']:g} --seed {summary['seed']}"
    return PageOf(
        outcome=summary["outcome"],
        why=summary["detail"] or f"{summary['observed_percent']['all']:.2f} % of the time observed",
        command=f"path-handoff team {asked}{faults}",
        figures=team_rows(summary),
        notes=summary["notes"],
        pictures=[folder / PICTURE],
    )


def fly_team(
    rig: Rig, config: TeamConfig, options: TeamOptions, out: Path, say: Tell
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A team's flights to their end; the logs are in ``out``. Returns summary and record."""
    harness: RelayHarness = import_factory(config.harness, rig.where("[team] harness"))()
    kind = RunKind(TEAM, (SUMMARY, PICTURE, PAGE), ("world", *(drone.name for drone in config.drones)))
    base = TeamBase(config, say, hours_of(config, options))

    async def main(ground: RelayField, stop: asyncio.Event, emit: Emit) -> None:
        del emit
        await base.run(cast(TeamField, ground), stop, program_of(flight))

    def flight(name: str, *parts: Any) -> TeamFlight:
        return TeamFlight(rig, config, OwnGround(base, name), name, *parts)

    request = RelayRequest(
        rig, config, out, options.seed, faults_of(options.fault), main, lambda _: None,
        processes_of(rig, config, out, base, options.logs), base.hours, options.logs, config.targets,
    )  # fmt: skip
    with claimed(out, kind):
        report = harness.fly(request)
    ending = cause_of(report, base.outcome, base.detail)
    outcome, detail = for_lateness(report.overload, report.violations, *ending)
    summary = summarize_team(rig, config, options, base, report, outcome, detail)
    return summary, {"outcome": outcome.label, **record_of(config, base, report)}


def tell(event: Event) -> None:
    """A line for the crew, as it comes."""
    tell_line(f"{event.time_s / 60.0:8.1f} min  {event.drone:<5} {event.what:<11} {event.text}")
