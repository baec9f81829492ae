"""``path-handoff guard``: watches one vehicle or both, and takes it from a script that does not fly
it well.

It needs nothing of the mission: not its program, not its camera, not its radio.
"""

from __future__ import annotations

import asyncio
import gc
import sys
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

from drivers.interfaces import Log, PartError
from drivers.log.mcap_log import McapLog, new_part
from drivers.mavlink.guard.interfaces import Watched
from drivers.mavlink.guard.line import UdpBeatLine
from drivers.rig.parts import SHARED_WITH_THE_VEHICLE, PartSpec, Rig, create, part_context
from drivers.stop_signals import stop_at_end_of_input, stop_on_signals
from flight.command_end import CommandEnd
from flight.config import MissionConfig
from flight.guard.rules import Act, GuardStage, GuardState
from flight.guard.watch import GuardWatch, watch
from missions.ground import rig_library
from missions.ground.options.field import GuardOptions
from missions.ground.run_folder import unless_refused
from missions.ground.shown import Said
from missions.look.live.start import live
from path.messages import Role
from path.values import frozen

EXIT_GAVE_UP = CommandEnd.GAVE_UP.exit_code
ALONE_S = 3.0  # without a beat and without anything to guard: the role's program has ended
NEVER_HEARD_S = 120.0
_POLL_S = 0.5


@frozen
class Teller:
    """The guard's decisions on the screen."""

    role: Role
    say: Callable[[str], None]

    def __call__(self, state: GuardState, act: Act) -> None:
        sent = "" if act is Act.NOTHING else f", told it to {act.value}"
        reason = f": {state.reason}" if state.reason else ""
        self.say(f"guard of the {self.role.value}: {state.stage.value}{sent}{reason}")

    def warn(self, what: str) -> None:
        self.say(f"guard of the {self.role.value}: ALARM: ignored {what}")


def run(options: GuardOptions) -> int:
    """Watch until told to end; 0, or EXIT_GAVE_UP when a vehicle did not land. Raises PartError."""
    if options.measure:
        from missions.fly.guard.measure import measure  # noqa: PLC0415 (what it needs is far larger than a guard)

        return measure(options)
    rig = rig_library.load_unchecked(options.rig)
    config = rig_library.mission_of(rig)
    roles = tuple(Role) if options.role == "both" else (Role(options.role),)
    specs = {role: guard_of(rig, role) for role in roles}
    until_input_ends = options.console == "events"
    with unless_refused(options.out, beside=True) as folder, live(options.live, folder):
        logs = {role: folder / f"{role.value}.guard.mcap" for role in roles}
        return asyncio.run(
            watch_vehicles(
                rig, config, specs, logs, until_input_ends=until_input_ends, while_flown=options.while_flown,
            )
        )  # fmt: skip


def guard_of(rig: Rig, role: Role) -> PartSpec:
    """The rig's ``[*.guard]`` table. Raises PartError when there is none."""
    spec = rig.role(role).guard
    if spec is None:
        remedy = "give it one: factory, url of a second MAVLink endpoint, vehicle_sysid, bind (docs/guard.md)"
        raise PartError(f"rig {rig.name} has no [{role.value}.guard] table", remedy)
    return spec


def as_flown(
    rig: Rig,
    role: Role,
    spec: PartSpec,
) -> PartSpec:
    """Return the guard with what its vehicle's table says of heights and of the battery that flies.

    Two sources of heights would be two fences, and two batteries two limits.
    """
    flown = rig.role(role).vehicle.options
    shared = {name: flown[name] for name in SHARED_WITH_THE_VEHICLE if name in flown}
    return replace(spec, options={**spec.options, **shared}) if shared else spec


async def watch_vehicles(
    rig: Rig, config: MissionConfig, specs: Mapping[Role, PartSpec], logs: Mapping[Role, Path], *,
    until_input_ends: bool, while_flown: bool,
) -> int:  # fmt: skip
    """Watch until told to end; 0, or EXIT_GAVE_UP when a vehicle did not land. Raises PartError."""
    stop = asyncio.Event()
    stop_on_signals(stop.set)
    async with AsyncExitStack() as stack:
        say = stack.enter_context(Said(sys.stdout))
        guards: list[GuardWatch] = []
        vehicles: list[Watched] = []
        for role, spec in specs.items():
            context = part_context(rig, role)
            vehicle: Watched = await stack.enter_async_context(
                create(as_flown(rig, role, spec), context)
            )
            line = await stack.enter_async_context(
                UdpBeatLine(str(spec.options["bind"]), context.clock)
            )
            part = new_part(logs[role].parent, logs[role].stem)  # an earlier guard's log stays
            log: Log = stack.enter_context(McapLog(part, role.value))
            tell = Teller(role, say)
            guards.append(GuardWatch(vehicle, line, context.clock, config, log, tell, tell.warn))
            vehicles.append(vehicle)
            say(f"guard of the {role.value}: watching {vehicle.name}")
        if len(guards) == 2:
            guards[0].peer = vehicles[1]
            guards[1].peer = vehicles[0]
        if until_input_ends:
            stop_at_end_of_input(stop.set)
        ending = asyncio.create_task(_stop_when_alone(stop, guards)) if while_flown else None
        gc.freeze()  # what is loaded by now stays: a collection in flight need not walk it
        await watch(tuple(guards), stop)
        if ending is not None:
            await ending
        return (
            EXIT_GAVE_UP if any(guard.state.stage is GuardStage.GAVE_UP for guard in guards) else 0
        )


async def _stop_when_alone(stop: asyncio.Event, guards: list[GuardWatch]) -> None:
    """Stop once the role's program is gone and the vehicle is down, whoever flew it.

    Or when the program never came.
    """
    loop = asyncio.get_running_loop()
    end_s = loop.time() + NEVER_HEARD_S
    while not stop.is_set():
        if any(guard.flown or guard.hears for guard in guards):
            end_s = loop.time() + ALONE_S
        if loop.time() > end_s:
            stop.set()
        await asyncio.sleep(_POLL_S)
