"""The guard of a role: begun beside it, begun elsewhere, or done without."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Literal

from drivers.interfaces import PartError
from drivers.mavlink.guard.line import is_taken
from drivers.rig.parts import Rig
from missions.ground import rig_library
from path.messages import Role

_begun: list[subprocess.Popen[bytes]] = []  # held: they may go on longer than this program

How = Literal["start", "expect", "none"]


def with_guard(
    rig: Rig,
    role: Role,
    how: How,
    folder: Path,
) -> Rig:
    """The rig as the role is to fly it, its guard begun when it is to be and none is there yet.

    The guard is no child to be ended with the role: it is in a session of its own, which neither
    Ctrl-C nor Ctrl-Z nor the end of the terminal reaches, and ends by itself when the role is gone
    and the vehicle is down.
    """
    own = rig.role(role)
    if own.guard is None:
        return rig
    if how == "none":
        bare = replace(own, guard=None)
        return replace(rig, sender=bare) if role is Role.SENDER else replace(rig, receiver=bare)
    if how == "start" and "bind" not in own.guard.options:
        raise PartError(
            f"{own.guard.where}: rig {rig.name} has a guard that needs the simulated world",
            f"start `path-handoff handoff --rig {rig_library.name_of(rig)}`, or name the rig of a real drone",
        )
    if how == "start" and not is_taken(str(own.guard.options["bind"])):
        command = [
            sys.executable, "-m", "missions.cli", "guard", "--rig", str(rig.file), "--role", role.value,
            "--out", str(folder), "--while-flown",
        ]  # fmt: skip
        with (folder / f"{role.value}.guard.txt").open("ab") as said:
            _begun.append(
                subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=said,
                    stderr=said,
                    start_new_session=True,
                )
            )
    return rig
