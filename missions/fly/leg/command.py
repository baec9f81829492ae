"""``path-handoff sender`` and ``receiver``: one drone's side of a handoff, in a process of its
own.
"""

from __future__ import annotations

import sys

from drivers.log.mcap_log import parts
from flight.harness.flights import RoleMain
from missions.fly.guard.start import with_guard
from missions.fly.leg.process import fly_role, run_role
from missions.ground import rig_library
from missions.ground.first_flights import FirstFlights
from missions.ground.options.field import ReceiverOptions, RoleOptions
from missions.ground.run_folder import unless_refused
from missions.look.live.start import live, one
from missions.look.report.progress import open_console
from path.messages import Role


def run(options: RoleOptions) -> int:
    """Fly one role to its end; returns its outcome's exit code. Raises PartError when the rig or a
    part is refused.
    """
    return fly_from_drone(
        options,
        Role.RECEIVER if isinstance(options, ReceiverOptions) else Role.SENDER,
        fly_role,
    )


def fly_from_drone(
    options: RoleOptions,
    role: Role,
    main: RoleMain,
) -> int:
    """The same with any program of a role."""
    rig = rig_library.load(options.rig, world=False)
    record = FirstFlights(rig)
    with unless_refused(options.out, beside=True) as folder:
        rig = with_guard(rig, role, options.guard, folder)
        state = options.state or (options.out or folder.parent) / f"{role.value}.state.json"
        if options.console == "events":
            result = run_role(rig, role, folder, state, lambda _: None, parent=True, main=main)
            record.flight(role, result.outcome)
            return result.outcome.exit_code
        sys.stdout.write(record.left())
        with live(options.live, folder, one(rig, role)), open_console(sys.stdout) as console:
            result = run_role(rig, role, folder, state, console.show, parent=False, main=main)
    record.flight(role, result.outcome)
    sys.stdout.write(
        f"{role.value}: {result.outcome.label}: {result.detail or result.outcome.meaning}\n"
    )
    for log in parts(folder, role.value)[-1:]:
        sys.stdout.write(f"log: {log}\n")
    return result.outcome.exit_code
