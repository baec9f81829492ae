"""``path-handoff fly``: a mission of a person's own, both drones and their world, or one drone as
in the field.
"""

from __future__ import annotations

import sys
from pathlib import Path

from drivers.rig.check import check_ready
from drivers.rig.parts import Rig, with_errors
from flight.harness.flights import Emit
from flight.outcome import Outcome
from missions.fly.handoff.command import name_model, name_simulators
from missions.fly.handoff.flight import FlightPrograms, fly_once, reported
from missions.fly.leg.command import fly_from_drone
from missions.fly.own.load import load_mission
from missions.fly.own.program import OwnMission
from missions.ground import rig_library
from missions.ground.ground_station import name_ground_station
from missions.ground.options.field import RoleOptions
from missions.ground.options.flights import FlyOptions
from missions.ground.run_folder import unless_refused
from missions.look.live.start import both, live
from missions.look.report.command import make_report
from missions.look.report.progress import open_console
from missions.look.report.records import RunFacts
from path.messages import Role


def run(options: FlyOptions) -> int:
    """``path-handoff fly``; returns the run's exit code. Raises PartError for what was asked
    wrongly.
    """
    if options.drone != "both":
        asked = RoleOptions(
            options.rig,
            options.out,
            options.console,
            options.state,
            options.guard,
            options.live,
        )
        return fly_from_drone(asked, Role(options.drone), OwnMission(load_mission(options.mission)))
    name_simulators(options)
    name_model(options.model)
    rig = with_errors(rig_library.load(options.rig), options.errors)
    check_ready(rig)
    name_ground_station(rig, options.gcs)
    programs = programs_of(options.mission)
    with unless_refused(options.out) as folder:
        with live(options.live, folder, both(rig)), open_console(sys.stdout) as console:
            facts = fly_once(rig, options.seed, options.fault, folder, console.show, programs)
        return reported(facts, folder, lambda: make_report(folder, True, sys.stdout))


def fly_mission(
    mission: Path,
    rig: Rig,
    seed: int,
    faults: tuple[str, ...],
    out: Path,
    emit: Emit,
) -> RunFacts:
    """One run of a mission's file to its end, as ``path-handoff fly``. Raises PartError."""
    return fly_once(rig, seed, faults, out, emit, programs_of(mission))


def programs_of(mission: Path) -> FlightPrograms:
    """Return how both drones fly a mission, in a harness's process or in processes of their own.
    Raises PartError.
    """
    own = OwnMission(load_mission(mission))
    file = str(mission.resolve())
    return FlightPrograms(
        own,
        lambda role: ("fly", file, "--drone", role.value),
        Outcome.FLOWN,
        mission=str(mission),
    )
