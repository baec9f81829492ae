"""A relay or a team on the harness of its rig: what was asked for, its flights to their end, and
their outcome.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, import_factory
from flight.harness.fleet import NamedTarget, RelayConfig
from flight.harness.flights import Emit
from flight.harness.relay import (
    DroneProcesses,
    DroneProgram,
    RelayField,
    RelayHarness,
    RelayReport,
    RelayRequest,
)
from flight.outcome import Outcome
from missions.fly.relay.crew import Crew
from missions.fly.relay.ending import PAGE, SUMMARY, Showing, Values, cause_of, leave
from missions.fly.relay.ground import Event, Tell
from missions.ground.lateness import for_lateness
from missions.ground.options.flights import HoursOptions
from missions.ground.run_folder import RunKind, claimed, unless_refused
from missions.ground.shown import tell_line
from missions.look.live.start import EVERY, live


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


def carry_out(
    options: HoursOptions,
    showing: Showing,
    size: str,
    fly: Callable[[Path, Tell], tuple[Values, Values]],
) -> int:
    """A relay or a team from the first take-off to the last page; returns the exit code.

    Args:
        size: how much of what is flown, for a line to the crew.
        fly: flies it; its logs are in the folder. Returns summary and record.
    """
    with unless_refused(options.out) as folder:
        tell_line(f"{size}: {folder}")
        with live(options.live, folder, EVERY):
            summary, record = fly(folder, tell)
        return leave(summary, record, folder, showing, options.picture)


def fly_on_field(
    name: str, rig: Rig, base: Crew[Any, Any, Any], options: HoursOptions, out: Path,
    program: DroneProgram, processes: DroneProcesses, targets: Sequence[NamedTarget] = (),
) -> RelayReport:  # fmt: skip
    """Fly a relay or a team, by ``name``, to its end on the rig's harness."""
    harness: RelayHarness = import_factory(base.config.harness, rig.where(f"[{name}] harness"))()
    logs = ("world", *(drone.name for drone in base.config.drones))

    async def main(ground: RelayField, stop: asyncio.Event, emit: Emit) -> None:
        del emit
        await base.run(ground, stop, program)

    request = RelayRequest(
        rig, base.config, out, options.seed, faults_of(options.fault), main, lambda _: None, processes, base.hours,
        options.logs, targets,
    )  # fmt: skip
    with claimed(out, RunKind(f"{name}.json", (SUMMARY, f"{name}.png", PAGE), logs)):
        return harness.fly(request)


def judge(base: Crew[Any, Any, Any], report: RelayReport) -> tuple[Outcome, str]:
    """The outcome of the whole: what a computer that was too slow explains is blamed on nobody
    else.
    """
    return for_lateness(report, *cause_of(report, base.outcome, base.detail))


def tell(event: Event) -> None:
    """A line for the crew, as it comes."""
    tell_line(f"{event.time_s / 60.0:8.1f} min  {event.drone:<5} {event.what:<11} {event.text}")
