"""One role as a process of its own: in the field on its own companion, in ``sitl`` as a child of
``handoff``.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from drivers.log.mcap_log import McapLog, new_part
from drivers.log.state_file import StateFile
from drivers.rig.parts import Rig
from drivers.stop_signals import stop_at_end_of_input, stop_on_signals
from flight.harness.flights import (
    Emit,
    ProgramContext,
    Progress,
    RoleMain,
    RoleResult,
    encode_event,
    with_log,
)
from missions.ground.held import held_file
from missions.ground.shown import Said
from path.messages import Role


async def fly_role(
    rig: Rig,
    role: Role,
    given: ProgramContext,
) -> RoleResult:
    """The program of either role in the world's own process
    (``flight.harness.flights.RoleMain``).
    """
    return await load_program()(rig, role, given)


def load_program() -> RoleMain:
    """Imports the roles' program, which takes a while: who only starts processes does without."""
    from missions.fly.leg.opening import fly  # noqa: PLC0415

    return fly


def run_role(
    rig: Rig,
    role: Role,
    out: Path,
    state: Path,
    emit: Emit,
    parent: bool,
    main: RoleMain = fly_role,
) -> RoleResult:
    """Fly one role to its end; ``stop_signals`` land the vehicle. Raises PartError when a part
    cannot be opened.

    Args:
        out: folder of the log; a new part of it when there is one already.
        state: file of what the role has to know when it is started again.
        parent: events go to stdout as lines of JSON, and a closed stdin means that the parent is
            gone: stop.
        main: the role's program.
    """
    load_program()
    with (
        held_file(state),
        McapLog(new_part(out, role.value), role.value) as log,
        Said(sys.stdout) as say,
    ):

        def to_parent(event: Progress | RoleResult) -> None:
            say(encode_event(event))

        given = ProgramContext(
            log,
            to_parent if parent else emit,
            asyncio.Event(),
            None,
            StateFile(state, role),
        )
        result = asyncio.run(_run(rig, role, given, parent, main))
        result = with_log(result, log.settled())
        if parent:
            to_parent(result)
        return result


async def _run(
    rig: Rig,
    role: Role,
    given: ProgramContext,
    parent: bool,
    main: RoleMain,
) -> RoleResult:
    stop_on_signals(given.stop.set)
    if parent:
        stop_at_end_of_input(given.stop.set)
    return await main(rig, role, given)
