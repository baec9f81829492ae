"""``path-handoff relay`` and ``team``: many drones keep one target, or many, observed for hours as
batteries run down, and what came of it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, import_factory, with_errors
from flight.harness.fleet import RelayConfig, TeamConfig
from flight.harness.flights import Emit
from flight.harness.relay import FlyRelay, RelayField, RelayRequest
from missions.fly.fleet.ending import PAGE, SUMMARY, judge, leave
from missions.fly.fleet.process import flight_of, processes_of
from missions.fly.fleet.report import name_of, record_of, summary_of
from missions.fly.relay.ground import Event, Tell
from missions.fly.relay.legs import Base
from missions.fly.team.base import TeamBase
from missions.ground import rig_library
from missions.ground.ground_station import name_ground_station
from missions.ground.options.flights import HoursOptions, RelayOptions, TeamOptions
from missions.ground.run_folder import RunKind, claimed, unless_refused
from missions.ground.shown import tell_line
from missions.ground.team_config import fenced, relay_of, team_of
from missions.look.live.start import EVERY, live


def run(options: RelayOptions | TeamOptions) -> int:
    """Fly from the first take-off to the last page; return the exit code. Raises PartError for
    what was asked wrongly.
    """
    rig = with_errors(rig_library.load(options.rig), options.errors)
    name_ground_station(rig, options.gcs)
    size = ""
    if isinstance(options, RelayOptions):
        config = relay_of(rig, options.drones)
    else:
        config = team_of(rig, options.drones, options.targets)
        rig = fenced(rig, config)
        size = f" {len(config.targets)} targets,"
    hours = hours_of(config, options)
    with unless_refused(options.out) as folder:
        tell_line(f"{len(config.drones)} drones,{size} {hours:g} h: {folder}")
        with live(options.live, folder, EVERY):
            summary, record = fly(rig, config, options, folder, tell)
        return leave(summary, record, folder, options.picture)


def fly(
    rig: Rig,
    config: RelayConfig,
    options: HoursOptions,
    out: Path,
    say: Tell,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fly a relay, or a team, to its end on the rig's harness; the logs are in ``out``. Returns
    summary and record.
    """
    hours = hours_of(config, options)
    base: Base | TeamBase
    base = (
        TeamBase(config, say, hours) if isinstance(config, TeamConfig) else Base(config, say, hours)
    )
    program = flight_of(rig, config, base)
    name = name_of(config)
    fly_it: FlyRelay = import_factory(config.harness, rig.where(f"[{name}] harness"))().fly

    async def main(
        ground: RelayField,
        stop: asyncio.Event,
        emit: Emit,
    ) -> None:
        del emit
        await base.run(ground, stop, program)

    request = RelayRequest(
        rig, config, out, options.seed, faults_of(options.fault), main, lambda _: None,
        processes_of(rig, base, out, options.logs), hours, options.logs,
        config.targets if isinstance(config, TeamConfig) else (),
    )  # fmt: skip
    logs = ("world", *(drone.name for drone in config.drones))
    with claimed(out, RunKind(f"{name}.json", (SUMMARY, f"{name}.png", PAGE), logs)):
        report = fly_it(request)
    outcome, detail = judge(base, report)
    summary = summary_of(rig, options, base, report, outcome, detail)
    return summary, record_of(base, report, outcome)


def hours_of(config: RelayConfig, options: HoursOptions) -> float:
    """Return how long it is to last. Raises PartError."""
    hours = config.hours if options.hours is None else options.hours
    if not hours > 0.0:
        raise PartError(
            f"--hours {hours:g} is not above 0", "give the hours that it is to last, such as 8"
        )
    return hours


def faults_of(texts: Sequence[str]) -> dict[int, list[str]]:
    """Faults by the number of their leg, 0 for all. Raises PartError."""
    faults: dict[int, list[str]] = {}
    for text in texts:
        leg, colon, fault = text.partition(":")
        if colon and not (leg.isdecimal() and int(leg) >= 1):
            raise PartError(
                f"--fault {text}: {leg!r} is no number of a leg",
                "write it as 3:kill_receiver@approach",
            )
        faults.setdefault(int(leg) if colon else 0, []).append(fault if colon else text)
    return faults


def tell(event: Event) -> None:
    """A line for the crew, as it comes."""
    tell_line(f"{event.time_s / 60.0:8.1f} min  {event.drone:<5} {event.what:<11} {event.text}")
