"""``path-handoff conformance``: how the vehicles behave, in one table."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from missions.fly.handoff.command import name_simulators
from missions.ground import rig_library
from missions.ground.options.proofs import ConformanceOptions
from missions.ground.rig_library import trial_part
from missions.ground.run_folder import claim_result, unless_refused
from missions.look.report.command import show
from missions.proofs.conformance.flights import FLIGHTS, SuiteFlight
from missions.proofs.conformance.measure import FlightSuite, chosen
from missions.proofs.conformance.page import WRITTEN_BY, page, terminal_table
from missions.proofs.conformance.record import VEHICLES, Record, joined, read_all, write

RIGS = {"embedded": "sitl", "px4": "sitl-px4", "ardupilot": "sitl-ardupilot"}
BINARY = {"px4": "PATH_PX4", "ardupilot": "PATH_ARDUPILOT"}
EXIT_FAILED = CommandEnd.FAILED.exit_code


def run(options: ConformanceOptions) -> int:
    """``path-handoff conformance``; 0 when every flight came to its end, whatever it showed. Raises
    PartError.
    """
    name_simulators(options)
    flights = chosen(options.only)
    with unless_refused(
        options.out or Path("conformance") / f"{datetime.now():%Y%m%d-%H%M%S}"
    ) as folder:
        for vehicle in VEHICLES:
            claim_result(folder / f"{vehicle}.json", '"vehicle"')
        if options.page is not None:
            claim_result(options.page, WRITTEN_BY)
        return _run(options, flights, folder)


def _run(
    options: ConformanceOptions,
    flights: Sequence[SuiteFlight],
    folder: Path,
) -> int:
    failed = False
    for vehicle in _wanted(options):
        try:
            record = fly(vehicle, flights, folder)
        except PartError as error:
            _say(f"{vehicle}: {error}" + (f"\n  fix: {error.remedy}" if error.remedy else ""))
            failed = True
            continue
        failed = failed or bool(record.failed)
        write(folder, joined(read_all(folder).get(vehicle) if options.only else None, record))
    records = read_all(folder)
    if not records:
        _say(f"{folder}: nothing was measured")
        return EXIT_FAILED
    show(terminal_table(records), sys.stdout)
    if options.page is not None:
        options.page.write_text(page(records, len(FLIGHTS)), "utf-8")
    _say(
        f"\n{folder}: {', '.join(f'{name}.json' for name in records)}"
        + (f"; {options.page}" if options.page else "")
    )
    return EXIT_FAILED if failed else 0


def _wanted(options: ConformanceOptions) -> list[str]:
    """Return the vehicles to fly: those asked for whose simulator is named."""
    wanted: list[str] = []
    for vehicle in options.vehicle or VEHICLES if options.fly else ():
        variable = BINARY.get(vehicle)
        if variable is not None and not os.environ.get(variable):
            _say(f"{vehicle}: skipped, no simulator is named (--{vehicle} PATH, or {variable})")
        else:
            wanted.append(vehicle)
    return wanted


def fly(
    vehicle: str,
    flights: Sequence[SuiteFlight],
    folder: Path,
) -> Record:
    """One vehicle through these flights. Raises PartError when it never becomes ready."""
    rig = rig_library.load(RIGS[vehicle])
    made = f"{datetime.now():%Y-%m-%d %H:%M}"
    load_before = os.getloadavg()[0]
    bench = trial_part(rig, "bench")
    suite = FlightSuite(
        lambda: bench(rig, folder / vehicle), lambda text: _say(f"{vehicle}: {text}")
    )
    # a cable that is cut is no news here
    logging.getLogger("drivers.mavsdk").setLevel(logging.ERROR)
    measured = asyncio.run(suite.run(flights))
    return Record(
        vehicle=vehicle,
        rig=rig.name,
        made=made,
        cores=os.cpu_count() or 1,
        load_before=round(load_before, 2),
        load_after=round(os.getloadavg()[0], 2),
        restarts=measured.restarts,
        values=measured.values,
        failed=measured.failed,
        flown=tuple(flight.name for flight in flights),
    )


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
