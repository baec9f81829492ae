"""``path-handoff relay``: one target, handed from drone to drone as batteries run down, and what came of it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, import_factory, with_errors
from flight.harness.flights import Emit, Progress
from flight.harness.relay import RelayConfig, RelayField, RelayHarness, RelayReport, RelayRequest
from flight.outcome import Outcome
from missions import rig_library
from missions.ground_station import name_ground_station
from missions.lateness import for_lateness
from missions.live.start import live
from missions.options.flights import HoursOptions, RelayOptions
from missions.relay.base import Base, Event, Tell
from missions.relay.config import relay_of
from missions.relay.drone import DroneFlight, program_of
from missions.relay.ending import PAGE, SUMMARY, Showing, Values, cause_of, leave
from missions.relay.process import processes_of
from missions.relay.report import flown_record, leg_record, relay_rows, relay_table, summarize_relay
from missions.report.page import PageOf
from missions.run_folder import RunKind, claimed, unless_refused
from missions.shown import tell_line

RELAY, PICTURE = "relay.json", "relay.png"


def run(options: RelayOptions) -> int:
    """``path-handoff relay``; returns the relay's exit code. Raises PartError for what was asked wrongly."""
    rig = with_errors(rig_library.load(options.rig), options.errors)
    name_ground_station(rig, options.gcs)
    config = relay_of(rig, options.drones)
    hours = hours_of(config, options)
    with unless_refused(options.out) as folder:
        tell_line(f"{options.drones} drones, {hours:g} h: {folder}")
        with live(options.live, folder):
            summary, record = fly_relay(rig, config, options, folder, _Teller().tell)
    draw = _draw if options.picture else None
    return leave(summary, record, folder, Showing(RELAY, PICTURE, draw, _page_of, relay_table))


def _draw(record: Values, summary: Values, path: Path) -> None:
    from missions.relay.picture import draw_relay  # noqa: PLC0415 (matplotlib takes a second to import)

    draw_relay(record, summary, path)


def _page_of(summary: dict[str, Any], folder: Path) -> PageOf:
    faults = "".join(f" --fault {fault}" for fault in summary["faults"])
    asked = f"--rig {summary['rig']} --drones {summary['drones']} --hours {summary['hours']:g} --seed {summary['seed']}"
    return PageOf(
        outcome=summary["outcome"],
        why=summary["detail"] or f"{summary['legs_handed_over']} of {summary['legs']} legs handed over",
        command=f"path-handoff relay {asked}{faults}",
        figures=relay_rows(summary),
        notes=summary["notes"],
        pictures=[folder / PICTURE],
    )


def hours_of(config: RelayConfig, options: HoursOptions) -> float:
    """Returns how long it is to last. Raises PartError."""
    hours = config.hours if options.hours is None else options.hours
    if not hours > 0.0:
        raise PartError(f"--hours {hours:g} is not above 0", "give the hours that it is to last, such as 8")
    return hours


def faults_of(texts: Sequence[str]) -> dict[int, list[str]]:
    """Faults by the number of their leg, 0 for all. Raises PartError."""
    faults: dict[int, list[str]] = {}
    for text in texts:
        leg, colon, fault = text.partition(":")
        if colon and not (leg.isdecimal() and int(leg) >= 1):
            raise PartError(f"--fault {text}: {leg!r} is no number of a leg", "write it as 3:kill_receiver@approach")
        faults.setdefault(int(leg) if colon else 0, []).append(fault if colon else text)
    return faults


def fly_relay(
    rig: Rig, config: RelayConfig, options: RelayOptions, out: Path, tell: Tell
) -> tuple[dict[str, Any], dict[str, Any]]:
    """One relay to its end; its logs are in ``out``. Returns summary and record."""
    harness: RelayHarness = import_factory(config.harness, rig.where("[relay] harness"))()
    kind = RunKind(RELAY, (SUMMARY, PICTURE, PAGE), ("world", *(drone.name for drone in config.drones)))
    base = Base(config, tell, hours_of(config, options))

    async def main(ground: RelayField, stop: asyncio.Event, emit: Emit) -> None:
        del emit
        await base.run(ground, stop, program_of(partial(DroneFlight, rig, config, base)))

    faults, processes = faults_of(options.fault), processes_of(rig, config, out, base, options.logs)
    request = RelayRequest(
        rig, config, out, options.seed, faults, main, _quiet, processes, base.hours, options.logs
    )  # fmt: skip
    with claimed(out, kind):
        report = harness.fly(request)
    outcome, detail = judge(base, report)
    record = {"outcome": outcome.label, **record_of(config, base, report)}
    summary = summarize_relay(rig, config, options, base, report, outcome, detail)
    return summary, record


def judge(base: Base, report: RelayReport) -> tuple[Outcome, str]:
    """The outcome of the whole relay: what a computer that was too slow explains is blamed on nobody else."""
    return for_lateness(report.overload, report.violations, *cause_of(report, base.outcome, base.detail))


def record_of(config: RelayConfig, base: Base, report: RelayReport) -> dict[str, Any]:
    """``relay.json``: every leg, every flight, every word to the crew, and the batteries now and then."""
    return {
        "drones": [drone.name for drone in config.drones],
        "reserve": config.reserve,
        "legs": [leg_record(leg, report) for leg in base.legs],
        **flown_record(base.events, report),
    }


def _quiet(_: Progress) -> None:
    pass


class _Teller:
    """The crew's lines, as they come."""

    def tell(self, event: Event) -> None:
        minutes = event.time_s / 60.0
        tell_line(f"{minutes:8.1f} min  {event.drone:<4} {event.what:<11} {event.text}")
