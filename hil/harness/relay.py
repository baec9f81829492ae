"""The harness of a relay: one field with many drones and their programs in one process, in virtual time."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.log.mcap_log import McapLog, virtual_log
from drivers.mavlink.guard_interfaces import Watched
from drivers.rig.parts import PartContext, Rig, RoleRig, create, part_context
from drivers.rig.tables import decode_table
from drivers.stop_signals import stop_on_signals
from flight.guard_watch import GuardWatch
from flight.harness.flights import Progress, RoleResult
from flight.harness.relay import DroneProgram, RelayConfig, RelayReport, RelayRequest, pair_of
from hil.harness.guard import TICK_S, MemoryBeatLine
from hil.harness.inject import inject_in_world, inject_on_link
from hil.harness.preparation import prepare, starting
from hil.harness.relay_faults import LegFaults
from hil.harness.relay_world import OTHER, OWN, DroneHarness, RelayWorld, present_s
from hil.harness.sim import Disk, mission_config
from hil.harness.virtual_time import run_virtual
from hil.link.faulty import MemoryHub
from hil.monitors.relay import RelayLog, RelayMonitors
from hil.world.errors import Built, as_built, reported
from hil.world.faults import Fault, FaultError, parse_fault
from hil.world.world import WorldConfig
from path.messages import Role

NEAR_PERIOD_S = 0.04  # looks at the truth while two are in the air
PERIOD_S = 0.2
VEHICLES_S = 1.0
SAMPLE_S = 10.0
LANDING_LIMIT_S = 90.0


class RelaySim:
    """Flies a relay of level ``sim``."""

    def fly(self, request: RelayRequest) -> RelayReport:
        faults = {leg: [_parse(text) for text in texts] for leg, texts in request.faults.items()}
        prepare(request.rig, lambda what: request.emit(starting(Role.SENDER, what)))
        start_s = time.perf_counter()
        gc.disable()  # nothing here lives in cycles, and collecting takes a tenth of the time
        try:
            findings = run_virtual(_Relay(request, faults).run())
        finally:
            gc.enable()
        return RelayReport(**findings, wall_s=time.perf_counter() - start_s)


def _parse(text: str) -> Fault:
    fault = parse_fault(text)
    if fault.name == "attack" or fault.kind.own:
        raise FaultError(
            f"fault {fault.name} needs programs of their own", "fly it with handoff, on a rig of level sitl"
        )
    return fault


@dataclass(slots=True)
class _Drone:
    """One drone: its disk, its log, and its program while it has one."""

    name: str
    own: RoleRig
    harness: DroneHarness
    store: Disk
    log: McapLog
    offset_ns: int
    watched: RelayLog | None = None
    program: DroneProgram | None = None
    task: asyncio.Future[RoleResult] | None = None
    guard: asyncio.Task[None] | None = None
    killed: bool = False
    restart: asyncio.Task[None] | None = None
    cut_off_s: list[float] = field(default_factory=list[float])


class _Relay:
    """One relay in virtual time: the ``flight.harness.relay.RelayField``, and what watches it."""

    def __init__(self, request: RelayRequest, faults: dict[int, list[Fault]]) -> None:
        self._request = request
        self._rig: Rig = request.rig
        self._config: RelayConfig = request.config
        self._mission = mission_config(self._rig)
        self._stop = asyncio.Event()
        self._interrupted = False
        self._hubs: dict[int, MemoryHub] = {}
        self._legs = LegFaults(faults, self._inject)

    async def run(self) -> dict[str, Any]:
        """The fields of the RelayReport, without the wall's."""
        rig, request, config = self._rig, self._request, self._config
        world_config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._world = RelayWorld(world_config, request.seed, config.drones)
        pairs = {drone.name: pair_of(rig, drone, drone) for drone in config.drones}
        built = {name: as_built(pair, request.seed, {OTHER: 0, OWN: k}) for k, (name, pair) in enumerate(pairs.items())}
        owns = {name: each.rig.receiver for name, each in built.items()}
        self._monitors = RelayMonitors(rig, config, self._mission, self._world, owns)
        self._drones = {name: self._new(name, pair.receiver, built[name]) for name, pair in pairs.items()}
        stop_on_signals(self._interrupt)
        watching = asyncio.create_task(self._watch())
        try:
            await request.main(self, self._stop, request.emit)
        finally:
            await self._until_landed()
            self._legs.close()
            for task in (watching, *(drone.guard for drone in self._drones.values() if drone.guard)):
                task.cancel()
            for drone in self._drones.values():
                self._close_flight(drone)
                drone.log.close()
        self._monitors.close()
        return self._findings()

    def _new(self, name: str, own: RoleRig, built: Built) -> _Drone:
        harness = DroneHarness(self._world, name, self._request.seed, present_s, built)
        offset_ns = round(float(own.clock.options.get("offset_s", 0.0)) * 1e9)
        log = virtual_log(self._request.out / f"{name}.mcap", name, offset_ns)
        return _Drone(name, own, harness, Disk(lambda duty: self._legs.on_duty(name, duty)), log, offset_ns)

    # --- the field ---

    async def begin(self, name: str, program: DroneProgram) -> RoleResult | None:
        drone = self._drones[name]
        self._switch_on(drone)
        self._start(drone, program)
        while True:
            assert drone.task is not None
            await asyncio.wait([drone.task])
            if not drone.killed:
                return drone.task.result()
            if drone.restart is None:
                return None
            await asyncio.wait([drone.restart])
            if drone.killed:
                return None

    def open_leg(self, number: int, sender: str, receiver: str) -> None:
        hub = self._hubs[number] = MemoryHub(self._request.seed * 4096 + number)
        for role, name, other in ((Role.SENDER, sender, receiver), (Role.RECEIVER, receiver, sender)):
            self._drones[name].harness.join(role, other, hub)
        self._monitors.on_leg(number, sender, receiver)
        self._legs.open_leg(number, sender, receiver)

    def landed(self, name: str) -> bool:
        return self._world.landed(name)

    def swap(self, name: str) -> None:
        drone = self._drones[name]
        self._close_flight(drone)
        self._world.swap(name)
        drone.harness.silent = drone.harness.lost = drone.harness.frozen = False
        drone.harness.view.other = None

    # --- programs ---

    def _switch_on(self, drone: _Drone) -> None:
        if drone.name not in self._world.on:
            self._world.switch_on(drone.name)
            self._monitors.on_switched_on(drone.name, present_s())
            if drone.own.guard is not None and drone.guard is None:
                drone.harness.beats = MemoryBeatLine(self._context(drone).clock)
                drone.guard = asyncio.create_task(self._keep_watch(drone))

    def _context(self, drone: _Drone) -> PartContext:
        spec = next(spec for spec in self._config.drones if spec.name == drone.name)
        return part_context(pair_of(self._rig, spec, spec), Role.RECEIVER, drone.harness)

    async def _keep_watch(self, drone: _Drone) -> None:
        """The guard of a drone that is switched on; it outlives the drone's programs."""
        context = self._context(drone)
        assert drone.own.guard is not None and drone.harness.beats is not None
        vehicle: Watched = create(drone.own.guard, context)
        guard = GuardWatch(vehicle, drone.harness.beats, context.clock, self._mission, _NoLog())
        async with vehicle:
            while True:
                guard.tick()
                await asyncio.sleep(TICK_S)

    def _start(self, drone: _Drone, program: DroneProgram) -> None:
        drone.killed, drone.restart, drone.store.writable = False, None, True
        drone.harness.silent = drone.harness.lost
        drone.watched = RelayLog(drone.log, drone.name, self._monitors, drone.offset_ns, self._request.whole_log)
        run = program(drone.name, drone.watched, self._emit_of(drone), self._stop, drone.harness, drone.store)
        drone.task = asyncio.ensure_future(run)
        drone.program = program

    def _kill(self, drone: _Drone, restart_s: float | None) -> None:
        """The program ends without a word, as in ``hil.harness.sim``."""
        if drone.task is None or drone.task.done() or drone.killed or drone.watched is None:
            return
        drone.killed = drone.harness.silent = True
        drone.harness.hub.cut(drone.harness.role)
        if drone.harness.beats is not None:
            drone.harness.beats.cut()
        drone.store.writable = False
        drone.watched.ended = True
        self._monitors.on_death(drone.name)
        drone.task.cancel()
        if restart_s is not None and not self._interrupted:
            drone.restart = asyncio.ensure_future(self._start_again(drone, drone.task, restart_s))

    async def _start_again(self, drone: _Drone, dead: asyncio.Future[RoleResult], after_s: float) -> None:
        await asyncio.sleep(after_s)
        await asyncio.wait([dead])
        drone.harness.hub.mend(drone.harness.role)
        assert drone.program is not None
        self._start(drone, drone.program)

    def _emit_of(self, drone: _Drone) -> Callable[[Progress], None]:
        def emit(progress: Progress) -> None:
            if drone.killed:
                return
            self._request.emit(progress)
            self._legs.on_progress(drone.name, progress)

        return emit

    # --- faults ---

    def _inject(self, leg: int, fault: Fault) -> None:
        """To the drone that has, or had, the fault's role in the leg."""
        role = fault.kind.role
        inject_on_link(fault.name, fault.value or 0.0, self._hubs[leg])
        if role is None:
            inject_in_world(fault.name, None, self._world)
            return
        drone = self._drones[self._legs.end_of(leg, role)]
        now_s = present_s()
        if fault.name == "camera_freeze":
            drone.harness.frozen = True
        elif fault.name == "fc_link_loss":
            drone.harness.silent = drone.harness.lost = True
        elif fault.kills is None:
            inject_in_world(fault.name, drone.name, self._world, fault.value)
        if fault.cuts_off is not None:
            drone.cut_off_s.append(now_s)
        if fault.kills is not None:
            self._kill(drone, fault.value)

    def _interrupt(self) -> None:
        self._interrupted = True
        self._stop.set()

    # --- what is seen ---

    async def _watch(self) -> None:
        vehicles_s = sample_s = 0.0
        world = self._world
        while True:
            now_s = present_s()
            if now_s != world.time_s:
                world.advance(now_s)
            self._monitors.on_truth(now_s)
            if now_s >= vehicles_s:
                vehicles_s = now_s + VEHICLES_S
                self._monitors.on_vehicles(now_s, self._monitors.vehicles())
            if now_s >= sample_s:
                sample_s = now_s + SAMPLE_S
                self._monitors.sample(now_s, world.batteries, world.airborne)
            await asyncio.sleep(NEAR_PERIOD_S if len(world.airborne) > 1 else PERIOD_S)

    def _close_flight(self, drone: _Drone) -> None:
        """What one flight's autopilot leaves, before it is started anew."""
        self._monitors.on_offboard(drone.name, drone.cut_off_s)
        self._monitors.on_swap(drone.name, present_s())
        drone.cut_off_s = []
        if drone.guard is not None:
            drone.guard.cancel()
            drone.guard = None

    async def _until_landed(self) -> None:
        end_s = present_s() + LANDING_LIMIT_S
        while present_s() < end_s and not all(self.landed(name) for name in self._world.on):  # noqa: ASYNC110 (polls truth)
            await asyncio.sleep(0.1)

    def _findings(self) -> dict[str, Any]:
        aloft = [name for name in self._world.names if not self.landed(name)]
        failure = f"not landed at the end: {', '.join(aloft)}" if aloft else ""
        failed = [drone.log.failed for drone in self._drones.values() if drone.log.failed]
        return {
            **self._monitors.findings(),
            "simulated_s": present_s(),
            "interrupted": self._interrupted,
            "failure": failure,
            "log_failure": failed[0] if failed else "",
            "errors": reported(self._rig),
        }


class _NoLog:
    """For what nobody reads."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...
