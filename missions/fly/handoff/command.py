"""``path-handoff handoff``: both roles and their world from one terminal, once or many times by
seed.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.check import check_ready, check_rig
from drivers.rig.parts import Rig
from missions.fly.handoff.flight import HANDOFF, fly_once, harness_of, reported, rig_as_asked
from missions.fly.handoff.served import check_served, tell_commands
from missions.ground.ground_station import name_ground_station
from missions.ground.options.flights import FlyOptions, HandoffOptions
from missions.ground.options.proofs import ConformanceOptions
from missions.ground.run_folder import unless_refused
from missions.look.live.start import both, live
from missions.look.report.command import make_report
from missions.look.report.progress import open_console


def run(options: HandoffOptions) -> int:
    """``path-handoff handoff``; returns the run's exit code. Raises PartError for what was asked
    wrongly.
    """
    name_simulators(options)
    name_model(options.model)
    rig = rig_as_asked(options.rig, options.errors, options.scene, options.slow)
    if options.slow is not None or options.scene is not None:
        check_rig(rig)
    harness_of(rig)
    name_ground_station(rig, options.gcs)
    if options.serve_world:
        check_served(rig, options)
    check_ready(rig)
    refuse_too_slow(rig)
    with unless_refused(options.out) as folder:
        if options.seeds > 1:
            if options.live is not None:
                raise PartError(
                    "--live shows one flight, and --seeds flies many", "leave one of them out"
                )
            from missions.fly.handoff.many import fly_many  # noqa: PLC0415 (one flight needs no pool of processes)

            return fly_many(rig, options, folder)
        with live(options.live, folder, both(rig)), open_console(sys.stdout) as console:
            programs = HANDOFF
            if options.serve_world:
                tell_commands(rig, folder)
                programs = replace(HANDOFF, elsewhere=True)
            facts = fly_once(rig, options.seed, options.fault, folder, console.show, programs)
        return reported(facts, folder, lambda: make_report(folder, options.picture, sys.stdout))


def refuse_too_slow(rig: Rig) -> None:
    """Raise PartError where the rig's share of this core flies nothing; one without a share is not
    measured.
    """
    if rig.world.get("slow") is not None:
        from missions.ground.computer import refuse_share  # noqa: PLC0415  a flight does without the doctor

        refuse_share(rig, rig.world["slow"])


def name_model(file: Path | None) -> None:
    """Names the model of detectors whose rig names none, for the harness and its processes. Raises
    PartError.
    """
    if file is not None:
        if not file.is_file():
            raise PartError(
                f"{file}: no such file", "name a YOLOX model in ONNX, or leave the option out"
            )
        from drivers.detectors.yolox import MODEL_VARIABLE  # noqa: PLC0415  it loads onnxruntime

        os.environ[MODEL_VARIABLE] = str(file.resolve())


def name_simulators(options: HandoffOptions | FlyOptions | ConformanceOptions) -> None:
    """Names the programs of real autopilots for the harness and its processes. Raises PartError."""
    for variable, binary in (("PATH_PX4", options.px4), ("PATH_ARDUPILOT", options.ardupilot)):
        if binary is not None:
            if not binary.is_file():
                raise PartError(
                    f"{binary}: no such file",
                    "name the simulator's binary, or leave the option out",
                )
            os.environ[variable] = str(binary.resolve())
