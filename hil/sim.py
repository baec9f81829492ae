"""The ``sim`` and ``sim-rendered`` harness: both roles and the world in one process, in virtual time.

One seed gives one history: wake-ups are ordered by the loop's own clock, and every noise has its own generator.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.interfaces import FlightMode
from drivers.log import McapLog
from drivers.rig import Rig
from drivers.tables import decode_table
from flight.config import MissionConfig
from flight.harness import FlightReport, FlightRequest, Progress, RoleResult, with_log
from hil.capture import Freeze
from hil.faults import Fault, FaultTrigger, parse_fault
from hil.faulty_link import MemoryHub
from hil.monitors import Monitors, WatchedLog
from hil.preparation import prepare, starting
from hil.truth_log import TruthLog
from hil.virtual_time import run_virtual
from hil.world import World, WorldConfig
from path.messages import Role

TRUTH_PERIOD_S = 0.04
GROUND_PERIOD_S = 0.05  # while not both are in the air
RUN_LIMIT_S = 400.0
LANDING_LIMIT_S = 45.0


class SimWorld:
    """``PartContext.harness`` of the sim levels: what the parts of both roles are connected to."""

    def __init__(self, world: World, hub: MemoryHub, seed: int) -> None:
        self._world = world
        self.hub = hub
        self.seed = seed
        self.frozen_cameras: dict[Role, Freeze] = {}
        self.silent_vehicles: set[Role] = set()

    @property
    def world(self) -> World:
        """The world, at the loop's present."""
        now_s = asyncio.get_running_loop().time()
        if now_s != self._world.time_s:
            self._world.advance(now_s)
        return self._world


class SimHarness:
    """Flies a rig of level ``sim`` or ``sim-rendered``."""

    def fly(self, request: FlightRequest) -> FlightReport:
        faults = [parse_fault(text) for text in request.faults]
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


class _Flight:
    """One run in virtual time."""

    def __init__(self, request: FlightRequest, faults: list[Fault]) -> None:
        self._request = request
        self._rig = request.rig
        self._faults = faults
        self._trigger = FaultTrigger(faults)
        self._tasks: dict[Role, asyncio.Task[RoleResult]] = {}
        self._stop = {role: asyncio.Event() for role in Role}
        self._interrupted = False
        self._killed: set[Role] = set()

    async def run(self) -> dict[str, Any]:
        """The fields of the FlightReport, without the wall's."""
        request, rig = self._request, self._rig
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._world = World(config, request.seed)
        self._parts = SimWorld(self._world, MemoryHub(request.seed), request.seed)
        self._monitors = Monitors(rig.method, min_separation_m(rig))
        for fault in self._trigger.from_the_start():
            self._inject(fault)
        _stop_on_signals(self._interrupt)
        with McapLog(request.out / "world.mcap", buffered=True) as log:
            truth = TruthLog(log)
            truth.scene(rig, self._monitors.min_separation_m, clock_offsets(rig))
            watch = asyncio.create_task(self._watch_truth(truth))
            results = await self._fly_roles()
            await self._until_landed()
            watch.cancel()
            await asyncio.gather(watch, return_exceptions=True)
            return self._findings(truth, results)

    async def _fly_roles(self) -> dict[Role, RoleResult | None]:
        request, offsets = self._request, clock_offsets(self._rig)
        logs = {role: McapLog(request.out / f"{role.value}.mcap", role.value, buffered=True) for role in Role}
        for role, log in logs.items():
            watched = WatchedLog(log, role, self._monitors, offsets[role])
            program = request.role_main(self._rig, role, watched, self._emit, self._stop[role], self._parts)
            self._tasks[role] = asyncio.ensure_future(program)  # type: ignore[assignment]
        try:
            _, late = await asyncio.wait(self._tasks.values(), timeout=RUN_LIMIT_S)
            if late:
                self._interrupt()
                await asyncio.wait(late)
            for log in logs.values():
                log.close()  # what waits in its buffer may still fail
            return {
                role: None if role in self._killed else with_log(task.result(), logs[role].failed)
                for role, task in self._tasks.items()
            }
        finally:
            for log in logs.values():
                log.close()

    def _interrupt(self) -> None:
        self._interrupted = True
        for stop in self._stop.values():
            stop.set()

    def _emit(self, progress: Progress) -> None:
        self._request.emit(progress)
        for fault in self._trigger.on_progress(progress):
            self._inject(fault)

    def _inject(self, fault: Fault) -> None:
        inject(fault, self._world, self._parts)
        if fault.kills is not None:
            self._kill(fault.kills)

    def _kill(self, role: Role) -> None:
        """The program ends without a word: nothing of what it does on the way out reaches anything."""
        self._killed.add(role)
        self._parts.silent_vehicles.add(role)
        self._parts.hub.cut(role)
        self._tasks[role].cancel()

    async def _watch_truth(self, truth: TruthLog) -> None:
        loop, world = asyncio.get_running_loop(), self._world
        while True:
            world.advance(loop.time())
            truth.truth(world)
            self._monitors.on_truth(world.time_s, world.separation_m, world.both_in_air)
            await asyncio.sleep(TRUTH_PERIOD_S if world.both_in_air else GROUND_PERIOD_S)

    async def _until_landed(self) -> None:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + LANDING_LIMIT_S
        while loop.time() < end_s:
            if all(down(self._world, role) for role in Role):
                return
            await asyncio.sleep(0.1)

    def _findings(self, truth: TruthLog, results: dict[Role, RoleResult | None]) -> dict[str, Any]:
        cut_off = {fault.cuts_off for fault in self._faults}
        for role in Role:
            truth.setpoint_gap(role, self._world)
            self._monitors.on_offboard(role, self._world.drone(role).autopilot.offboard_sessions, role in cut_off)
        for detail in self._monitors.details:
            truth.violation(self._world.time_s, detail.partition(" ")[0], detail)
        return {
            "results": results,
            "landed": {role: down(self._world, role) for role in Role},
            "violations": dict(self._monitors.violations),
            "simulated_s": self._world.time_s,
            "interrupted": self._interrupted,
            "notes": tuple(self._monitors.details),
        }


def down(world: World, role: Role) -> bool:
    """Whether a vehicle stands on the ground, disarmed."""
    drone = world.drone(role)
    return drone.on_ground and not drone.autopilot.armed


def min_separation_m(rig: Rig) -> float:
    """The distance between the bodies that monitor S9 holds the mission to."""
    return decode_table(rig.mission, MissionConfig, rig.where("[mission]")).separation.minimum_m


def clock_offsets(rig: Rig) -> dict[Role, int]:
    """Role clock minus world clock in ns, as the rig sets the clocks of its roles apart."""
    return {role: round(float(rig.role(role).clock.options.get("offset_s", 0.0)) * 1e9) for role in Role}


def inject(fault: Fault, world: World, parts: SimWorld) -> None:
    """Switch a fault on. What ends a program is the harness's own business."""
    role = fault.kind.role
    match fault.name:
        case "lookalike":
            world.send_lookalike()
        case "marker_hidden":
            world.hide_marker(True)
        case "depth_holes":
            world.depth_holes(True)
        case "link_loss":
            parts.hub.faults = replace(parts.hub.faults, loss=fault.value)
        case "link_delay":
            parts.hub.faults = replace(parts.hub.faults, delay_s=fault.value, jitter_s=fault.value)
        case "camera_freeze" if role is not None:
            parts.frozen_cameras[role] = Freeze.SILENT
        case "fc_link_loss" if role is not None:
            parts.silent_vehicles.add(role)
        case "pilot_takeover" if role is not None:
            world.drone(role).autopilot.request_mode(world.time_s, FlightMode.OTHER, by_pilot=True)
        case "battery_sag" if role is not None:
            world.battery(role, 0.15)
        case _:
            pass


def _stop_on_signals(stop: Callable[[], None]) -> None:
    if threading.current_thread() is threading.main_thread():
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop)
