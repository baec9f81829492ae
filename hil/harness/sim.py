"""The ``sim`` and ``sim-rendered`` harness: both roles and the world in one process, in virtual
time.

One seed gives one history: wake-ups are ordered by the loop's own clock, and every noise has its
own generator.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Sequence
from contextlib import ExitStack
from typing import Any

from drivers.collector import collector_off
from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, new_part, virtual_log
from drivers.rig.parts import Rig, RoleRig
from drivers.rig.tables import decode_table
from drivers.stop_signals import stop_on_signals
from flight.config import MissionConfig
from flight.harness.flights import (
    FlightReport,
    FlightRequest,
    RoleResult,
    with_log,
)
from hil.harness.inject import inject_in_world
from hil.harness.preparation import prepare, starting
from hil.harness.programs import Started
from hil.harness.stalls import StallingLoop
from hil.harness.virtual import VirtualDrones
from hil.harness.virtual_time import VirtualTimeLoop, run_virtual
from hil.link.faulty import MemoryHub
from hil.monitors.monitors import Monitors
from hil.monitors.scripts import vehicles_of
from hil.monitors.truth_log import TruthLog
from hil.world.check import check_world
from hil.world.config import WorldConfig, drawn_imaging, scene_of
from hil.world.distances import clearance, obstacles_m
from hil.world.errors import as_built
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


class _Flight(VirtualDrones):
    """One run in virtual time: a leg of two drones, which are called by their roles."""

    def __init__(self, request: FlightRequest, faults: list[Fault]) -> None:
        rig = request.rig
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        mission = mission_config(rig)
        monitors = Monitors.of_pair(rig.method, mission)
        monitors.stalls = any(fault.stalls for fault in faults)
        self._world = world = World(config, request.seed)
        super().__init__(world, monitors, mission, {LEG: faults}, request.emit, request.seed)
        self._request = request
        self._rig = rig
        self._logs: list[McapLog] = []
        self._built = as_built(rig, request.seed)
        hub = self.hubs[LEG] = MemoryHub(request.seed)
        for role in Role:
            self.add(role, rig, role, world, request.seed, self._built, hub)

    async def run(self) -> dict[str, Any]:
        """The fields of the FlightReport, without the wall's."""
        out = self._request.out
        stop_on_signals(self.programs.interrupt)
        with ExitStack() as stack:
            log = stack.enter_context(virtual_log(out / "world.mcap", "world"))
            for name, drone in self.drones.items():
                if drone.own.guard is not None:
                    file = out / f"{name}.guard.mcap"
                    own = stack.enter_context(virtual_log(file, name, drone.offset_ns))
                    self.start_guard(drone, own)
            truth = self._truth = TruthLog(log)
            truth.scene(
                self._built.rig,
                self.monitors.min_separation_m,
                {role: self.drones[role].offset_ns for role in Role},
                self.world.config.target,
                self.world.obstacles,
            )
            self.legs.open_leg(LEG, *Role)
            watching = asyncio.create_task(self._watch_truth(truth))
            results = await self._fly_roles()
            await self.until_down(LANDING_LIMIT_S)
            beside = [watching, *(drone.guard for drone in self.drones.values() if drone.guard)]
            for task in beside:
                task.cancel()
            await asyncio.gather(*beside, return_exceptions=True)
            return self._findings(truth, results)

    # --- programs ---

    async def _fly_roles(self) -> dict[Role, RoleResult | None]:
        ends = {role: asyncio.ensure_future(self._begin(role)) for role in Role}
        try:
            _, flying = await asyncio.wait(ends.values(), timeout=RUN_LIMIT_S)
            if flying:
                self.programs.interrupt()
                await asyncio.wait(flying)
            for log in self._logs:
                log.close()  # what waits in its buffer may still fail
            for end in ends.values():
                end.exception()  # one is raised below; asyncio complains of what nobody looked at
            return {role: self._result(role, end) for role, end in ends.items()}
        finally:
            self.legs.close()
            self.programs.close()
            for log in self._logs:
                log.close()

    def _begin(self, role: Role) -> Awaitable[RoleResult | None]:
        return self.programs.begin(role, lambda: self._start(role))

    def _start(self, role: Role) -> Started:
        """A program with a log of its own, a further one after a restart."""
        request = self._request
        drone = self.drones[role]
        log = virtual_log(new_part(request.out, role), role, drone.offset_ns)
        self._logs.append(log)
        watched, given = self.given(drone, log)
        return Started(watched, _with_log(request.role_main(self._rig, role, given), log))

    def _result(self, role: Role, end: asyncio.Future[RoleResult | None]) -> RoleResult | None:
        """None for a program that died, or could not begin once more. Raises what ended it
        otherwise.
        """
        error = end.exception()
        if isinstance(error, PartError) and self.programs.began_again(role):
            self.monitors.details.append(f"the {role}'s program could not begin again: {error}")
            return None
        return end.result()

    def inject_in_world(self, fault: Fault, name: str | None, ends: Sequence[str]) -> None:
        self._truth.fault(fault.name, round(self.world.time_s * 1e9))
        inject_in_world(fault.name, name, self.world, fault.value, ends)

    # --- what is seen ---

    async def _watch_truth(self, truth: TruthLog) -> None:
        loop = asyncio.get_running_loop()
        world = self._world
        monitors = self.monitors
        own: dict[str, RoleRig] = {role: self._built.rig.role(role) for role in Role}
        ticks = 0
        while True:
            world.advance(loop.time())
            truth.truth(world)
            truth.modes(world)
            monitors.on_near(world.time_s, world.closest(monitors.min_separation_m))
            monitors.on_target(world.time_s, clearance(world))
            monitors.on_obstacles(world.time_s, obstacles_m(world))
            ticks += 1
            if ticks % VEHICLES_EVERY == 0:
                monitors.scripts.on_truth(world.time_s, vehicles_of(world, own))
            together = len(world.airborne) == len(Role)
            await asyncio.sleep(TRUTH_PERIOD_S if together else GROUND_PERIOD_S)

    def _findings(self, truth: TruthLog, results: dict[Role, RoleResult | None]) -> dict[str, Any]:
        monitors = self.monitors
        for role in Role:
            truth.setpoint_gap(role, self._world)
            sessions = self.world.drone(role).autopilot.offboard_sessions
            monitors.on_offboard(role, sessions, self.drones[role].harness.cut_off_s)
        for detail in monitors.details:
            truth.violation(self.world.time_s, detail.partition(" ")[0], detail)
        return {
            "results": results,
            "landed": {role: self.world.landed(role) for role in Role},
            "violations": dict(monitors.violations),
            "simulated_s": self.world.time_s,
            "interrupted": self.programs.interrupted,
            "notes": (
                *monitors.details,
                *(f"beyond what is promised then: {told}" for told in monitors.beyond),
            ),
            "beyond": tuple(monitors.beyond),
            "broken": monitors.broken,
            "figures": monitors.legs[0].leases.figures,
            "errors": reported(self._rig) | drawn_imaging(self._rig),
            "scene": "" if (scene := scene_of(self._rig)) == "plain" else scene,
        }


async def _with_log(program: Awaitable[RoleResult], log: McapLog) -> RoleResult:
    """A program's result, which is LOG_FAILED when what it did is not in its log."""
    result = await program
    log.close()  # what waits in its buffer may still fail
    return with_log(result, log.failed)


def mission_config(rig: Rig) -> MissionConfig:
    """Return the mission, with the limits that the monitors hold it to."""
    return decode_table(rig.mission, MissionConfig, rig.where("[mission]"))
