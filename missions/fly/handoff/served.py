"""``path-handoff handoff --serve-world``: the world alone, for programs that a person starts in
other shells.
"""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from missions.ground import rig_library
from missions.ground.options.flights import HandoffOptions
from path.messages import Role

RUN_VARIABLE = "PATH_HANDOFF_RUN"
"""Names what a run in real time shares between its processes: the variable of
``hil.camera.shared``.
"""

WAIT_S = 120.0
"""For so long the world waits for each of the programs: who has read the lines has two shells to
open.
"""


def check_served(rig: Rig, options: HandoffOptions) -> None:
    """Raise PartError for what cannot be served to programs in other shells."""
    if rig.level != "sitl":
        raise PartError(
            f"--serve-world: rig {rig.name} has no world in real time", "take --rig sitl"
        )
    if options.seeds > 1 or any(
        fault.startswith(("kill_", "stop_", "stall_")) for fault in options.fault
    ):
        raise PartError(
            "--serve-world flies once, and programs in other shells are not its own to kill",
            "leave --seeds and such faults out; end a program in its own shell",
        )


def tell_commands(rig: Rig, folder: Path) -> None:
    """Say what to type in other shells; when, is said once the world is ready."""
    sys.stdout.write(
        f"once the world is ready, within {WAIT_S:g} s, in two other shells, from this folder:\n"
    )
    for role in Role:
        sys.stdout.write(f"  {typed(rig, role, folder)}\n")
    sys.stdout.flush()


def typed(
    rig: Rig,
    role: Role,
    folder: Path,
) -> str:
    """Return what a person types in another shell, for this world."""
    words = ["path-handoff", role.value, "--rig", rig_library.name_of(rig), "--out", str(folder)]
    return f"{RUN_VARIABLE}=run-{os.getpid()} {shlex.join(words)}"


def stand_in(
    rig: Rig,
    role: Role,
    folder: Path,
) -> list[str]:
    """Return the command of what stands in for a drone's program that is another shell's."""
    module = "missions.fly.handoff.elsewhere"
    return [
        sys.executable,
        "-m",
        module,
        role.value,
        str(folder),
        f"{WAIT_S:g}",
        typed(rig, role, folder),
    ]
