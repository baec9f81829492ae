"""``path-handoff handoff --serve-world``: the world alone, for programs that a person starts in other shells."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.harness.flights import Progress
from missions import rig_library
from missions.options.flights import HandoffOptions
from path.messages import Role

RUN_VARIABLE = "PATH_HANDOFF_RUN"
"""Names what a run in real time shares between its processes: the variable of ``hil.camera.shared``."""


def check_served(rig: Rig, options: HandoffOptions) -> None:
    """Raises PartError for what cannot be served to programs in other shells."""
    if rig.level != "sitl":
        raise PartError(f"--serve-world: rig {rig.name} has no world in real time", "take --rig sitl")
    if options.seeds > 1 or any(fault.startswith(("kill_", "stop_", "stall_")) for fault in options.fault):
        raise PartError(
            "--serve-world flies once, and programs in other shells are not its own to kill",
            "leave --seeds and such faults out; end a program in its own shell",
        )


def tell_commands(rig: Rig, folder: Path) -> None:
    """Says what to type in other shells; when, is said once the world is ready."""
    sys.stdout.write("once the world is ready, in two other shells, from this folder:\n")
    for role in Role:
        words = ["path-handoff", role.value, "--rig", rig_library.name_of(rig), "--out", str(folder)]
        sys.stdout.write(f"  {RUN_VARIABLE}=run-{os.getpid()} {shlex.join(words)}\n")
    sys.stdout.flush()


def waiting_for(role: Role, what: str) -> Progress:
    """The console's lines about a drone whose program is another shell's."""
    return Progress(role, 0, "waiting", 0, 0, None, None, None, 0.0, False, what)
