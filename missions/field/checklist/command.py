"""``path-handoff checklist``: write the page, and tick first flights by hand."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TextIO

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from flight.plan.facts import facts_of
from flight.plan.flown import flown
from missions.field.checklist.page import checklist_page
from missions.ground import rig_library
from missions.ground.first_flights import STEPS, FirstFlights
from missions.ground.options.field import ChecklistOptions


def run(options: ChecklistOptions, out: TextIO | None = None) -> int:
    """Write the page, or tick a step; return 0. Raises PartError, RigError."""
    stream = out or sys.stdout
    rig = rig_library.load_unchecked(options.rig)
    record = FirstFlights(rig)
    if options.tick is not None:
        record.tick(options.tick, options.note or "by hand")
        stream.write(f"{record.file}: {STEPS[options.tick]}\n{record.left()}")
        return CommandEnd.DONE.exit_code
    mission = rig_library.mission_of(rig)
    file = options.out or Path(f"{rig.name}.checklist.html")
    of = flown(facts_of(rig, mission), mission)
    done = {STEPS[step]: when for step, when in record.done().items()}
    page = checklist_page(rig, of, rig_library.name_of(rig), done)
    try:
        file.write_text(page, "utf-8")
    except OSError as error:
        raise PartError(
            f"--out {file}: {error.strerror}", "name a file that can be written"
        ) from error
    stream.write(f"{file}: one page of A4, to be printed at 100 %\n{record.left()}")
    return CommandEnd.DONE.exit_code
