"""``path-handoff team``: many targets kept observed by many drones for hours, and what came of
it.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig, with_errors
from flight.harness.fleet import TeamConfig
from flight.harness.flights import ProgramContext
from missions.fly.relay.ending import Showing, Values
from missions.fly.relay.flying import carry_out, fly_on_field, hours_of, judge
from missions.fly.relay.ground import Tell
from missions.fly.team.base import OwnGround, TeamBase
from missions.fly.team.flight import TeamFlight
from missions.fly.team.process import processes_of
from missions.fly.team.report import record_of, summarize_team, team_rows, team_table
from missions.ground import rig_library
from missions.ground.ground_station import name_ground_station
from missions.ground.options.flights import TeamOptions
from missions.ground.team_config import fenced, team_of


def run(options: TeamOptions) -> int:
    """``path-handoff team``; returns the exit code. Raises PartError for what was asked wrongly."""
    rig = with_errors(rig_library.load(options.rig), options.errors)
    name_ground_station(rig, options.gcs)
    config = team_of(rig, options.drones, options.targets)
    rig = fenced(rig, config)
    hours = hours_of(config, options)
    size = f"{len(config.drones)} drones, {len(config.targets)} targets, {hours:g} h"
    showing = Showing("team", "missions.fly.team.picture:draw_team", _why, team_rows, team_table)
    return carry_out(options, showing, size, partial(fly_team, rig, config, options))


def _why(summary: Values) -> str:
    return f"{summary['observed_percent']['all']:.2f} % of the time observed"


def fly_team(
    rig: Rig, config: TeamConfig, options: TeamOptions, out: Path, say: Tell
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A team's flights to their end; the logs are in ``out``. Returns summary and record."""
    base = TeamBase(config, say, hours_of(config, options))

    def flight(name: str, given: ProgramContext) -> TeamFlight:
        return TeamFlight(rig, config, OwnGround(base, name), name, given)

    processes = processes_of(rig, config, out, base, options.logs)
    report = fly_on_field("team", rig, base, options, out, flight, processes, config.targets)
    outcome, detail = judge(base, report)
    summary = summarize_team(rig, config, options, base, report, outcome, detail)
    return summary, {"outcome": outcome.label, **record_of(config, base, report)}
