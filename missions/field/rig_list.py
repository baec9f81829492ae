"""``path-handoff rigs``: the rigs that come with PATH."""

from __future__ import annotations

import sys
import tomllib
from typing import TextIO

from flight.command_end import CommandEnd
from missions.ground.options.field import RigsOptions
from missions.ground.rigs import FOLDER

LEVELS = ("sim", "sim-rendered", "sitl", "hitl", "field")


def run(options: RigsOptions, out: TextIO | None = None) -> int:
    """List them by level, with what each is for; or check one: 0, or NOT_FIT with what is wrong; or
    write one.
    """
    if options.new is not None:
        from missions.field.new_rig import write_rig  # noqa: PLC0415 (a list needs none of what it imports)

        write_rig(options.new, options.autopilot, options.camera, out or sys.stdout)
        return CommandEnd.DONE.exit_code
    if options.check is not None:
        return check(options.check, out or sys.stdout)
    tables = [(file.stem, tomllib.loads(file.read_text("utf-8"))) for file in FOLDER.glob("*.toml")]
    width = max((len(name) for name, _ in tables), default=0)
    for name, table in sorted(tables, key=lambda rig: (LEVELS.index(rig[1]["level"]), rig[0])):
        level = "" if table["level"] == name else f"level {table['level']}: "
        (out or sys.stdout).write(f"{name:<{width}}  {level}{table.get('description', '')}\n")
    return 0


def check(name: str, stream: TextIO) -> int:
    """Say what is wrong with a rig; returns NOT_FIT when something is. Raises PartError when there
    is no such rig.
    """
    from drivers.rig.file import find_rig  # noqa: PLC0415 (a list needs none of what it imports)
    from drivers.rig.tables import RigError  # noqa: PLC0415
    from missions.ground import rig_library  # noqa: PLC0415

    file = find_rig(name, [FOLDER])
    try:
        rig = rig_library.load(name)
    except RigError as error:
        stream.write("".join(f"{problem}\n" for problem in error.problems))
        count = len(error.problems)
        stream.write(f"{file}: {count} fault{'s' if count > 1 else ''}\n")
        return CommandEnd.NOT_FIT.exit_code
    stream.write(f"{file}: level {rig.level}, nothing wrong with it\n")
    return CommandEnd.DONE.exit_code
