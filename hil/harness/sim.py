"""The ``sim`` and ``sim-rendered`` harness: both roles and the world in one process, in virtual time.

One seed gives one history: wake-ups are ordered by the loop's own clock, and every noise has its own generator.
"""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass
from typing import Any

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, new_part, virtual_log
from drivers.log.state_file import MemoryStore
from drivers.mavlink.guard_interfaces import GuardLine, Watched
from drivers.rig.parts import Rig, create, part_context
from drivers.rig.tables import decode_table
from drivers.stop_signals import stop_on_signals
from flight.config import MissionConfig
from flight.guard_watch import GuardWatch, watch
from flight.harness.flights import FlightReport, FlightRequest, Progress, RoleResult, with_log
from hil.camera.capture import Freeze
from hil.harness.guard import TICK_S, MemoryBeatLine
from hil.harness.inject import inject_in_world, inject_on_link
from hil.harness.preparation import prepare, starting
from hil.harness.virtual_time import run_virtual
from hil.link.faulty import MemoryHub
from hil.monitors.monitors import Monitors, WatchedLog
from hil.monitors.scripts import vehicles_of
from hil.monitors.truth_log import TruthLog
from hil.world.check import check_world
from hil.world.errors import Built, as_built, reported
from hil.world.faults import Fault, FaultError, FaultTrigger, parse_fault
from hil.world.world import World, WorldConfig
from path.messages import Role
from path.protocol.values import ReceiverRecord, SenderRecord

TRUTH_PERIOD_S = 0.04
GROUND_PERIOD_S = 0.05  # while not both are in the air
VEHICLES_EVERY = 5  # looks at the truth
RUN_LIMIT_S = 400.0
LANDING_LIMIT_S = 45.0


class SimWorld:
    """``PartContext.harness`` of the sim levels: what the parts of both roles are connected to."""

    def __init__(self, world: World, hub: MemoryHub, seed: int, built: Built) -> None:
        self._world = world
        self.built = built
        self.hub = hub
        self.seed = seed
        self.frozen_cameras: dict[Role, Freeze] = {}
        self.silent_vehicles: set[Role] = set()
        self.lost_vehicles: set[Role] = set()  # of these, those whose own link is cut
        self.beat_lines: dict[Role, MemoryBeatLine] = {}  # of the roles that have a guard

    def guard_line(self, role: Role) -> GuardLine:
        """A program's way to its role's guard."""
        return self.beat_lines[role].role_end()

    @property
    def world(self) -> World:
        """The world, at the loop's present."""
        now_s = asyncio.get_running_loop().time()
        if now_s != self._world.time_s:
            self._world.advance(now_s)
        return self._world


class SimHarness:
    """Flies a rig of level ``sim`` or ``sim-rendered``."""

    check_rig = staticmethod(check_world)

    def fly(self, request: FlightRequest) -> FlightReport:
        faults = [parse_fault(text) for text in request.faults]
        if any(fault.name == "attack" for fault in faults):
            raise FaultError("fault attack needs real sockets", "fly it with --rig sitl, or a rig like it")
        for fault in faults:
            if fault.kind.own:
                raise FaultError(f"fault {fault.name} needs programs of their own", "use a rig of level sitl")
        prepare(request.rig, lambda what: show_start(request, what))
        start_s = time.perf_counter()
        gc.disable()  # nothing here lives in cycles, and collecting takes a tenth of the time
        try:
            findings = run_virtual(_Flight(request, faults).run())
        finally:
            gc.enable()
        return FlightReport(**findings, wall_s=time.perf_counter() - start_s)


def show_start(request: FlightRequest, what: str) -> None:
    for role in Role:
        request.emit(starting(role, what))


class Disk(MemoryStore):
    """Of one role, or one drone: it outlives their programs. ``saved`` is told each duty that was written."""

    def __init__(self, saved: Callable[[str], None]) -> None:
        super().__init__()
        self._saved = saved
        self.writable = True  # not by a program that was killed

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        if self.writable:
            super().save(record)
            self._saved(record.duty)


@dataclass(slots=True)
class _Program:
    """One role's program, from its start to its end."""

    log: McapLog
    watched: WatchedLog
    task: asyncio.Future[RoleResult]


class _Flight:
    """One run in virtual time."""

    def __init__(self, request: FlightRequest, faults: list[Fault]) -> None:
        self._request = request
        self._rig = request.rig
        self._trigger = FaultTrigger(faults)
        self._stores = {role: Disk(lambda duty, role=role: self._on_duty(role, duty)) for role in Role}
        self._programs: dict[Role, _Program] = {}
        self._restarts: set[Role] = set()  # whose program is started again
        self._coming: set[asyncio.Task[None]] = set()  # what is to happen later: faults, programs started again
        self._cut_off: dict[Role, list[float]] = {role: [] for role in Role}
        self._stop = {role: asyncio.Event() for role in Role}
        self._interrupted = False
        self._killed: set[Role] = set()
        self._started_again: set[Role] = set()

    async def run(self) -> dict[str, Any]:
        """The fields of the FlightReport, without the wall's."""
        request, rig = self._request, self._rig
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._world = World(config, request.seed)
        built = as_built(rig, request.seed)
        self._true_rig = built.rig
        self._parts = SimWorld(self._world, MemoryHub(request.seed), request.seed, built)
        mission = mission_config(rig)
        self._monitors = Monitors(rig.method, mission.separation.minimum_m, mission.guard)
        stop_on_signals(self._interrupt)
        with virtual_log(request.out / "world.mcap", "world") as log:
            guarding = [asyncio.create_task(guard) for guard in self._guards()]
            truth = self._truth = TruthLog(log)
            truth.scene(self._true_rig, self._monitors.min_separation_m, clock_offsets(rig))
            self._begin(self._trigger.from_the_start())
            watching = asyncio.create_task(self._watch_truth(truth))
            results = await self._fly_roles()
            await self._until_landed()
            for task in (watching, *guarding):
                task.cancel()
            await asyncio.gather(watching, *guarding, return_exceptions=True)
            return self._findings(truth, results)

    def _guards(self) -> Iterator[Coroutine[Any, Any, None]]:
        """The guards of the roles that have one; they outlive the roles' programs."""
        config = mission_config(self._rig)
        for role in Role:
            spec = self._rig.role(role).guard
            if spec is not None:
                context = part_context(self._rig, role, self._parts)
                line = self._parts.beat_lines[role] = MemoryBeatLine(context.clock)
                file = self._request.out / f"{role.value}.guard.mcap"
                log = virtual_log(file, role.value, clock_offsets(self._rig)[role])
                vehicle: Watched = create(spec, context)
                yield _keep_watch(vehicle, GuardWatch(vehicle, line, context.clock, config, log), log)

    async def _fly_roles(self) -> dict[Role, RoleResult | None]:
        end_s = asyncio.get_running_loop().time() + RUN_LIMIT_S
        for role in Role:
            self._start(role)
        try:
            while self._restarts or any(not program.task.done() for program in self._programs.values()):
                flying = {program.task for program in self._programs.values() if not program.task.done()}
                await self._until_one_ends(flying, end_s)
            for program in self._programs.values():
                program.log.close()  # what waits in its buffer may still fail
            return {role: self._result(role, program) for role, program in self._programs.items()}
        finally:
            for coming in self._coming:
                coming.cancel()
            for program in self._programs.values():
                program.log.close()

    def _result(self, role: Role, program: _Program) -> RoleResult | None:
        """None for a program that died, or could not begin once more. Raises what ended it otherwise."""
        if role in self._killed:
            return None
        if role in self._started_again and isinstance(program.task.exception(), PartError):
            self._monitors.details.append(
                f"the {role.value}'s program could not begin again: {program.task.exception()}"
            )
            return None
        return with_log(program.task.result(), program.log.failed)

    async def _until_one_ends(self, flying: set[asyncio.Future[RoleResult]], end_s: float) -> None:
        """One program, or the wait for one that is started again; after the run's limit they are told to land."""
        left_s = end_s - asyncio.get_running_loop().time()
        if left_s <= 0.0:
            self._interrupt()
            await asyncio.wait({*flying, *self._coming})
        else:
            await asyncio.wait({*flying, *self._coming}, timeout=left_s, return_when=asyncio.FIRST_COMPLETED)

    def _start(self, role: Role) -> None:
        request = self._request
        offset_ns = clock_offsets(self._rig)[role]
        log = virtual_log(new_part(request.out, role.value), role.value, offset_ns)
        watched = WatchedLog(log, role, self._monitors, offset_ns)
        store = self._stores[role]
        program = request.role_main(self._rig, role, watched, self._emit, self._stop[role], self._parts, store)
        self._programs[role] = _Program(log, watched, asyncio.ensure_future(program))

    def _interrupt(self) -> None:
        self._interrupted = True
        for stop in self._stop.values():
            stop.set()

    def _emit(self, progress: Progress) -> None:
        if progress.role not in self._killed:
            self._request.emit(progress)
            self._begin(self._trigger.on_progress(progress))

    def _on_duty(self, role: Role, duty: str) -> None:
        self._begin(self._trigger.on_duty(role, duty))

    def _begin(self, faults: list[Fault]) -> None:
        for fault in faults:
            if fault.after_s:
                self._later(self._inject_later(fault))
            else:
                self._inject(fault)

    def _later(self, what: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(what)
        self._coming.add(task)
        task.add_done_callback(self._coming.discard)

    async def _inject_later(self, fault: Fault) -> None:
        await asyncio.sleep(fault.after_s)
        self._inject(fault)

    def _inject(self, fault: Fault) -> None:
        parts, role = self._parts, fault.kind.role
        self._truth.fault(fault.name, round(self._world.time_s * 1e9))
        inject_in_world(fault.name, role, self._world, fault.value)
        inject_on_link(fault.name, fault.value or 0.0, parts.hub)
        if role is None:
            return
        if fault.name == "camera_freeze":
            parts.frozen_cameras[role] = Freeze.SILENT
        if fault.name == "fc_link_loss":
            parts.lost_vehicles.add(role)
            parts.silent_vehicles.add(role)
        if fault.cuts_off is not None:
            self._cut_off[role].append(asyncio.get_running_loop().time())
        if fault.kills is not None:
            self._kill(role, fault.value)

    def _kill(self, role: Role, restart_s: float | None) -> None:
        """The program ends without a word: nothing of what it does on the way out reaches anything.

        It may be in the middle of writing its record down: that is on the disk, and nothing that follows is done.
        """
        program = self._programs[role]
        if program.task.done() or role in self._killed:
            return
        self._killed.add(role)
        self._parts.silent_vehicles.add(role)
        self._parts.hub.cut(role)
        if role in self._parts.beat_lines:
            self._parts.beat_lines[role].cut()
        self._stores[role].writable = False
        program.watched.ended = True
        self._monitors.on_death(role)
        program.task.cancel()
        if restart_s is not None and not self._interrupted:
            self._restarts.add(role)
            self._later(self._start_again(role, program, restart_s))

    async def _start_again(self, role: Role, dead: _Program, after_s: float) -> None:
        """With the old one's disk; its vehicle and the world have gone on."""
        await asyncio.sleep(after_s)
        await asyncio.wait([dead.task])
        dead.log.close()
        self._started_again.add(role)
        self._restarts.discard(role)
        self._killed.discard(role)
        if role not in self._parts.lost_vehicles:
            self._parts.silent_vehicles.discard(role)
        self._parts.hub.mend(role)
        self._stores[role].writable = True
        self._start(role)

    async def _watch_truth(self, truth: TruthLog) -> None:
        loop, world, ticks = asyncio.get_running_loop(), self._world, 0
        while True:
            world.advance(loop.time())
            truth.truth(world)
            truth.modes(world)
            self._monitors.on_truth(world.time_s, world.separation_m, world.both_in_air)
            ticks += 1
            if ticks % VEHICLES_EVERY == 0:
                self._monitors.scripts.on_truth(world.time_s, vehicles_of(world, self._true_rig))
            await asyncio.sleep(TRUTH_PERIOD_S if world.both_in_air else GROUND_PERIOD_S)

    async def _until_landed(self) -> None:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + LANDING_LIMIT_S
        while loop.time() < end_s:
            if all(down(self._world, role) for role in Role):
                return
            await asyncio.sleep(0.1)

    def _findings(self, truth: TruthLog, results: dict[Role, RoleResult | None]) -> dict[str, Any]:
        for role in Role:
            truth.setpoint_gap(role, self._world)
            sessions = self._world.drone(role).autopilot.offboard_sessions
            self._monitors.on_offboard(role, sessions, self._cut_off[role])
        for detail in self._monitors.details:
            truth.violation(self._world.time_s, detail.partition(" ")[0], detail)
        return {
            "results": results,
            "landed": {role: down(self._world, role) for role in Role},
            "violations": dict(self._monitors.violations),
            "simulated_s": self._world.time_s,
            "interrupted": self._interrupted,
            "notes": tuple(self._monitors.details),
            "figures": self._monitors.leases.figures,
            "errors": reported(self._rig),
        }


async def _keep_watch(vehicle: Watched, guard: GuardWatch, log: McapLog) -> None:
    async with vehicle:
        with log:
            await watch((guard,), asyncio.Event(), TICK_S)


def down(world: World, role: Role) -> bool:
    """Whether a vehicle stands on the ground, disarmed."""
    drone = world.drone(role)
    return drone.on_ground and not drone.autopilot.armed


def mission_config(rig: Rig) -> MissionConfig:
    """Has the limits that the monitors hold the mission to."""
    return decode_table(rig.mission, MissionConfig, rig.where("[mission]"))


def clock_offsets(rig: Rig) -> dict[Role, int]:
    """Role clock minus world clock in ns, as the rig sets the clocks of its roles apart."""
    return {role: round(float(rig.role(role).clock.options.get("offset_s", 0.0)) * 1e9) for role in Role}
