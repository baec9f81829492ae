"""The ``sim`` and ``sim-rendered`` harness: both roles and the world in one process, in virtual
time.

One seed gives one history: wake-ups are ordered by the loop's own clock, and every noise has its
own generator.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Coroutine, Iterator
from typing import Any

from drivers.collector import collector_off
from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, new_part, virtual_log
from drivers.rig.parts import Rig, RoleRig, part_context
from drivers.rig.tables import decode_table
from drivers.stop_signals import stop_on_signals
from flight.config import MissionConfig
from flight.harness.flights import (
    FlightReport,
    FlightRequest,
    ProgramContext,
    Progress,
    RoleResult,
    with_log,
)
from hil.harness.drone import Disk, DroneHarness, until
from hil.harness.guard import MemoryBeatLine, keep_watch
from hil.harness.inject import inject_at_drone, inject_in_world, inject_on_link
from hil.harness.leg_faults import LegFaults
from hil.harness.preparation import prepare, starting
from hil.harness.programs import Programs, Started
from hil.harness.stalls import StallingLoop
from hil.harness.virtual_time import VirtualTimeLoop, run_virtual
from hil.link.faulty import MemoryHub
from hil.monitors.monitors import Monitors
from hil.monitors.scripts import vehicles_of
from hil.monitors.truth_log import TruthLog
from hil.monitors.watched_log import WatchedLog
from hil.world.check import check_world
from hil.world.config import WorldConfig, drawn_imaging, scene_of
from hil.world.distances import clearance
from hil.world.errors import Built, as_built
from hil.world.estimator import reported
from hil.world.faults import Fault, parse_faults
from hil.world.world import World
from path.messages import Role

TRUTH_PERIOD_S = 0.04
GROUND_PERIOD_S = 0.05  # while not both are in the air
VEHICLES_EVERY = 5  # looks at the truth
RUN_LIMIT_S = 400.0
LANDING_LIMIT_S = 45.0
LEG = 1  # the only one


class SimHarness:
    """Flies a rig of level ``sim`` or ``sim-rendered``."""

    check_rig = staticmethod(check_world)
    prepare = staticmethod(prepare)

    def fly(self, request: FlightRequest) -> FlightReport:
        faults = parse_faults(request.faults, request.rig.level)
        if any(fault.name == "attack" for fault in faults):
            raise PartError(
                "fault attack needs real sockets", "fly it with --rig sitl, or a rig like it"
            )
        for fault in faults:
            if fault.kind.own and not fault.stalls:
                raise PartError(
                    f"fault {fault.name} needs programs of their own", "use a rig of level sitl"
                )
        prepare(request.rig, lambda what: show_start(request, what))
        start_s = time.perf_counter()
        # nothing here lives in cycles, and collecting takes a tenth of the time
        with collector_off():
            loop = StallingLoop if any(fault.stalls for fault in faults) else VirtualTimeLoop
            findings = run_virtual(_Flight(request, faults).run(), loop)
        return FlightReport(**findings, wall_s=time.perf_counter() - start_s)


def show_start(request: FlightRequest, what: str) -> None:
    for role in Role:
        request.emit(starting(role, what))


class _Flight:
    """One run in virtual time: a leg of two drones, which are called by their roles."""

    def __init__(self, request: FlightRequest, faults: list[Fault]) -> None:
        self._request = request
        self._rig = request.rig
        self._faults = LegFaults({LEG: faults}, self._inject)
        self._programs = Programs(self._died, self._forgot)
        self._offsets_ns = clock_offsets(request.rig)
        self._logs: list[McapLog] = []

    async def run(self) -> dict[str, Any]:
        """The fields of the FlightReport, without the wall's."""
        request = self._request
        rig = self._rig
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._world = World(config, request.seed)
        built = as_built(rig, request.seed)
        self._own: dict[str, RoleRig] = {role: built.rig.role(role) for role in Role}
        mission = mission_config(rig)
        self._monitors = Monitors.of_pair(rig.method, mission)
        self._monitors.stalls = isinstance(asyncio.get_running_loop(), StallingLoop)
        self._hub = MemoryHub(request.seed)
        self._drones = {role: self._new(role, built) for role in Role}
        stop_on_signals(self._programs.interrupt)
        with virtual_log(request.out / "world.mcap", "world") as log:
            guarding = list(self._guards(mission))
            truth = self._truth = TruthLog(log)
            truth.scene(built.rig, self._monitors.min_separation_m, self._offsets_ns, config.target)
            self._faults.open_leg(LEG, Role.SENDER.value, Role.RECEIVER.value)
            watching = asyncio.create_task(self._watch_truth(truth))
            results = await self._fly_roles()
            await until(lambda: all(self._world.landed(role) for role in Role), LANDING_LIMIT_S)
            for task in (watching, *guarding):
                task.cancel()
            await asyncio.gather(watching, *guarding, return_exceptions=True)
            return self._findings(truth, results)

    def _new(self, role: Role, built: Built) -> DroneHarness:
        name = role.value
        drone = DroneHarness(
            self._world, self._world.advance, self._request.seed, built, role, self._hub
        )
        self._programs.add(name, drone, Disk(lambda duty: self._faults.on_duty(name, duty)))
        return drone

    def _guards(self, mission: MissionConfig) -> Iterator[asyncio.Task[None]]:
        """The guards of the roles that have one; they outlive the roles' programs."""
        for role, drone in self._drones.items():
            spec = self._rig.role(role).guard
            if spec is not None:
                context = part_context(self._rig, role, drone)
                drone.beats = MemoryBeatLine(context.clock)
                log = virtual_log(
                    self._request.out / f"{role.value}.guard.mcap",
                    role.value,
                    self._offsets_ns[role],
                )
                yield asyncio.create_task(
                    _logged(keep_watch(spec, context, drone.beats, mission, log), log)
                )

    # --- programs ---

    async def _fly_roles(self) -> dict[Role, RoleResult | None]:
        ends = {role: asyncio.ensure_future(self._begin(role)) for role in Role}
        try:
            _, flying = await asyncio.wait(ends.values(), timeout=RUN_LIMIT_S)
            if flying:
                self._programs.interrupt()
                await asyncio.wait(flying)
            for log in self._logs:
                log.close()  # what waits in its buffer may still fail
            for end in ends.values():
                end.exception()  # one is raised below; asyncio complains of what nobody looked at
            return {role: self._result(role, end) for role, end in ends.items()}
        finally:
            self._faults.close()
            self._programs.close()
            for log in self._logs:
                log.close()

    def _begin(self, role: Role) -> Awaitable[RoleResult | None]:
        return self._programs.begin(role.value, lambda: self._start(role))

    def _start(self, role: Role) -> Started:
        """A program with a log of its own, a further one after a restart."""
        request = self._request
        offset_ns = self._offsets_ns[role]
        log = virtual_log(new_part(request.out, role.value), role.value, offset_ns)
        self._logs.append(log)
        watched = WatchedLog(log, role, self._monitors.on_record, offset_ns)
        disk = self._programs.disk(role.value)
        given = ProgramContext(watched, self._emit, self._programs.stop, self._drones[role], disk)
        return Started(watched, _with_log(request.role_main(self._rig, role, given), log))

    def _died(self, name: str) -> None:
        self._monitors.on_death(name)

    def _forgot(self, name: str) -> None:
        self._monitors.on_forgotten(self._world.time_s, name)

    def _result(self, role: Role, end: asyncio.Future[RoleResult | None]) -> RoleResult | None:
        """None for a program that died, or could not begin once more. Raises what ended it
        otherwise.
        """
        error = end.exception()
        if isinstance(error, PartError) and self._programs.began_again(role.value):
            self._monitors.details.append(
                f"the {role.value}'s program could not begin again: {error}"
            )
            return None
        return end.result()

    def _emit(self, progress: Progress) -> None:
        name = progress.role.value
        if not self._programs.killed(name):
            self._request.emit(progress)
            self._faults.on_progress(name, progress)

    def _inject(self, leg: int, fault: Fault) -> None:
        del leg
        role = fault.kind.role
        self._truth.fault(fault.name, round(self._world.time_s * 1e9))
        inject_in_world(fault.name, role, self._world, fault.value)
        inject_on_link(fault.name, fault.value or 0.0, self._hub)
        if role is not None:
            inject_at_drone(fault, role.value, self._drones[role], self._programs)

    # --- what is seen ---

    async def _watch_truth(self, truth: TruthLog) -> None:
        loop = asyncio.get_running_loop()
        world = self._world
        ticks = 0
        while True:
            world.advance(loop.time())
            truth.truth(world)
            truth.modes(world)
            self._monitors.on_near(world.time_s, world.closest(self._monitors.min_separation_m))
            self._monitors.on_target(world.time_s, clearance(world))
            ticks += 1
            if ticks % VEHICLES_EVERY == 0:
                self._monitors.scripts.on_truth(world.time_s, vehicles_of(world, self._own))
            together = len(world.airborne) == len(Role)
            await asyncio.sleep(TRUTH_PERIOD_S if together else GROUND_PERIOD_S)

    def _findings(self, truth: TruthLog, results: dict[Role, RoleResult | None]) -> dict[str, Any]:
        for role in Role:
            truth.setpoint_gap(role, self._world)
            sessions = self._world.drone(role).autopilot.offboard_sessions
            self._monitors.on_offboard(role, sessions, self._drones[role].cut_off_s)
        for detail in self._monitors.details:
            truth.violation(self._world.time_s, detail.partition(" ")[0], detail)
        return {
            "results": results,
            "landed": {role: self._world.landed(role) for role in Role},
            "violations": dict(self._monitors.violations),
            "simulated_s": self._world.time_s,
            "interrupted": self._programs.interrupted,
            "notes": (
                *self._monitors.details,
                *(f"beyond what is promised then: {told}" for told in self._monitors.beyond),
            ),
            "beyond": tuple(self._monitors.beyond),
            "broken": tuple(self._monitors.broken),
            "figures": self._monitors.legs[0].leases.figures,
            "errors": reported(self._rig) | drawn_imaging(self._rig),
            "scene": "" if (scene := scene_of(self._rig)) == "plain" else scene,
        }


async def _logged(guard: Coroutine[Any, Any, None], log: McapLog) -> None:
    with log:
        await guard


async def _with_log(program: Awaitable[RoleResult], log: McapLog) -> RoleResult:
    """A program's result, which is LOG_FAILED when what it did is not in its log."""
    result = await program
    log.close()  # what waits in its buffer may still fail
    return with_log(result, log.failed)


def mission_config(rig: Rig) -> MissionConfig:
    """Return the mission, with the limits that the monitors hold it to."""
    return decode_table(rig.mission, MissionConfig, rig.where("[mission]"))


def clock_offsets(rig: Rig) -> dict[Role, int]:
    """Role clock minus world clock in ns, as the rig sets the clocks of its roles apart."""
    return {
        role: round(float(rig.role(role).clock.options.get("offset_s", 0.0)) * 1e9) for role in Role
    }
