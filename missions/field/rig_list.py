"""``path-handoff rigs``: the rigs that come with PATH."""

from __future__ import annotations

import sys
from typing import TextIO

from drivers.rig.choice import shown
from flight.command_end import CommandEnd
from missions.ground.options.field import RigsOptions
from missions.ground.rigs import FOLDER, tables

HEAD = """--rig NAME, with --level, --autopilot and --light as the rig comes; the first of each is taken otherwise.

"""
FOOT = """
sim           observations straight from geometry with measured noise, in virtual time: thousands of runs
sim-rendered  rendered frames through the whole perception, in virtual time
sitl          real MAVSDK, real pyrealsense2, real sockets, rendered frames, in real time
light         a short agreement, small pictures: for many runs, also on a busy computer
px4, ardupilot, mixed    real autopilots in simulators of their own: give --px4 PATH, --ardupilot PATH, or both

All of it in one name, for `like` in a rig of your own: sitl is the car at level sitl, sitl-px4-field-light the rig
field, so flown. `path-handoff rigs --show NAME` writes a rig whole, `path-handoff rigs --new FILE` one for the field.
"""


def run(options: RigsOptions, out: TextIO | None = None) -> int:
    """List them, with what each is for and comes as; or check or show one: 0, or NOT_FIT with what
    is wrong; or write one.
    """
    stream = out or sys.stdout
    if options.new is not None:
        from missions.field.new_rig import write_rig  # noqa: PLC0415 (a list needs none of what it imports)

        write_rig(options.new, options.autopilot, options.camera, stream)
    elif options.check is not None:
        return check(options.check, stream)
    elif options.show is not None:
        from missions.ground import rig_library  # noqa: PLC0415

        stream.write(rig_library.whole(options.show))
    else:
        stream.write(HEAD)
        for name, table in tables().items():
            ways = "".join(f"    {line}\n" for line in shown(table["options"]))
            stream.write(f"{name:<13} {table['description']}\n{ways}")
        stream.write(FOOT)
    return CommandEnd.DONE.exit_code


def check(name: str, stream: TextIO) -> int:
    """Say what is wrong with a rig; returns NOT_FIT when something is. Raises PartError when there
    is no such rig.
    """
    from drivers.rig.read import find_rig  # noqa: PLC0415 (a list needs none of what it imports)
    from drivers.rig.tables import RigError  # noqa: PLC0415
    from missions.ground import rig_library  # noqa: PLC0415

    find_rig(name, [FOLDER])
    try:
        rig = rig_library.load(name)
    except RigError as error:
        stream.write("".join(f"{problem}\n" for problem in error.problems))
        count = len(error.problems)
        stream.write(f"{name}: {count} fault{'s' if count > 1 else ''}\n")
        return CommandEnd.NOT_FIT.exit_code
    stream.write(f"{name}: level {rig.level}, nothing wrong with it\n")
    return CommandEnd.DONE.exit_code
