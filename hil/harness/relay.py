"""The harness of a relay and of a team: one field of many drones and targets, their programs in one process.

It runs in virtual time, and knows nothing of missions: in a relay all drones are around one target.
"""

from __future__ import annotations

import asyncio
import gc
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.log.mcap_log import McapLog, virtual_log
from drivers.rig.parts import Rig, RoleRig, part_context
from drivers.rig.tables import decode_table
from drivers.stop_signals import stop_on_signals
from flight.harness.flights import Progress, RoleResult
from flight.harness.relay import (
    POINTING_M,
    DroneProgram,
    Pointed,
    RelayConfig,
    RelayReport,
    RelayRequest,
    pair_of,
)
from hil.harness.drone import Disk, DroneHarness, present_s
from hil.harness.guard import MemoryBeatLine, keep_watch
from hil.harness.inject import inject_at_drone, inject_on_link
from hil.harness.leg_faults import LegFaults
from hil.harness.preparation import prepare, starting
from hil.harness.programs import Programs, Started
from hil.harness.relay_world import OTHER, OWN, PairView, RelayWorld
from hil.harness.sim import mission_config
from hil.harness.virtual_time import run_virtual
from hil.link.faulty import MemoryHub
from hil.monitors.relay import RelayLog, RelayMonitors
from hil.world.check import refuse_slow
from hil.world.errors import Built, as_built, reported
from hil.world.faults import Fault, FaultError, parse_faults
from hil.world.world import WorldConfig
from path.messages import Role

NEAR_PERIOD_S = 0.04  # looks at the truth while two are in the air
PERIOD_S = 0.2
VEHICLES_S = 1.0
SAMPLE_S = 10.0
LANDING_LIMIT_S = 90.0


class RelaySim:
    """Flies a relay or a team of level ``sim``."""

    def fly(self, request: RelayRequest) -> RelayReport:
        refuse_slow(request.rig)
        faults = {leg: [_parse(text, request.rig.level) for text in texts] for leg, texts in request.faults.items()}
        prepare(request.rig, lambda what: request.emit(starting(Role.SENDER, what)))
        start_s, cpu_s = time.perf_counter(), time.process_time()
        gc.disable()  # nothing here lives in cycles, and collecting takes a tenth of the time
        try:
            findings = run_virtual(_VirtualRelay(request, faults).run())
        finally:
            gc.enable()
        cpu_s = time.process_time() - cpu_s
        return RelayReport(**findings, wall_s=time.perf_counter() - start_s, cpu_s=cpu_s)


def _parse(text: str, level: str) -> Fault:
    (fault,) = parse_faults([text], level)
    if fault.kind.virtual:
        raise FaultError(
            f"fault {fault.name} is one of a single hand-over", "fly it with handoff, on a rig of level sim"
        )
    if fault.name == "attack" or fault.kind.own:
        raise FaultError(
            f"fault {fault.name} needs programs of their own", "fly it with handoff, on a rig of level sitl"
        )
    return fault


@dataclass(slots=True)
class _VirtualDrone:
    """One drone: what its parts are connected to, its log, and its guard while it is on."""

    name: str
    own: RoleRig
    view: PairView
    harness: DroneHarness
    log: McapLog
    offset_ns: int
    guard: asyncio.Task[None] | None = None


class _VirtualRelay:
    """One relay or team in virtual time: the ``flight.harness.relay.TeamField``, and what watches it."""

    def __init__(self, request: RelayRequest, faults: dict[int, list[Fault]]) -> None:
        self._request = request
        self._rig: Rig = request.rig
        self._config: RelayConfig = request.config
        self._mission = mission_config(self._rig)
        self._programs = Programs(self._died)
        self._hubs: dict[int, MemoryHub] = {}
        self._legs = LegFaults(faults, self._inject)

    async def run(self) -> dict[str, Any]:
        """The fields of the RelayReport, without the wall's."""
        rig, request, config = self._rig, self._request, self._config
        world_config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._world = RelayWorld(world_config, request.seed, config.drones, request.targets)
        self._pointing = np.random.default_rng([request.seed, 0x706F696E74])
        self._pairs = {drone.name: pair_of(rig, drone, drone) for drone in config.drones}
        built = {
            name: as_built(pair, request.seed, {OTHER: 0, OWN: k}) for k, (name, pair) in enumerate(self._pairs.items())
        }
        owns = {name: each.rig.receiver for name, each in built.items()}
        targets = max(1, len(request.targets))
        self._monitors = RelayMonitors(rig, config, self._mission, self._world, owns, targets=targets)
        if request.targets:
            self._monitors.watched_until_s = 3600.0 * request.hours
        self._drones = {name: self._new(name, pair.receiver, built[name]) for name, pair in self._pairs.items()}
        stop_on_signals(self._programs.interrupt)
        watching = asyncio.create_task(self._watch())
        try:
            await request.main(self, self._programs.stop, request.emit)
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

    def _new(self, name: str, own: RoleRig, built: Built) -> _VirtualDrone:
        """Makes a drone.

        To its own parts it is always the receiver, with a link to nobody until it is called to a leg.
        """
        view = PairView(self._world, name)
        seed = self._request.seed * 64 + self._world.names.index(name)
        harness = DroneHarness(view, self._world.advance, seed, built, OWN, MemoryHub(seed))
        self._programs.add(name, harness, Disk(lambda duty: self._legs.on_duty(name, duty)))
        offset_ns = round(float(own.clock.options.get("offset_s", 0.0)) * 1e9)
        log = virtual_log(self._request.out / f"{name}.mcap", name, offset_ns)
        return _VirtualDrone(name, own, view, harness, log, offset_ns)

    # --- the field ---

    def begin(self, name: str, program: DroneProgram) -> Awaitable[RoleResult | None]:
        drone = self._drones[name]
        self._switch_on(drone)
        return self._until_over(name, self._programs.begin(name, lambda: self._start(drone, program)))

    async def _until_over(self, name: str, program: Awaitable[RoleResult | None]) -> RoleResult | None:
        try:
            return await program
        finally:
            self._monitors.on_over(name)

    def assign(self, name: str, target: int) -> None:
        self._monitors.on_assigned(name, target)

    def given_up(self, target: int) -> None:
        self._monitors.on_given_up(target)

    def point_at(self, target: int) -> Pointed:
        """A person points: off by some centimetres, and knows how it drives."""
        now_s, world = present_s(), self._world
        if now_s != world.time_s:
            world.advance(now_s)
        thing = world.target(target)
        east, north, _ = thing.position_w_m
        off_n_m, off_e_m = (POINTING_M * self._pointing.standard_normal(2)).tolist()
        velocity = thing.speed_mps * math.sin(thing.yaw_rad), thing.speed_mps * math.cos(thing.yaw_rad), 0.0
        return Pointed((north + off_n_m, east + off_e_m, 0.0), velocity, now_s)

    def open_leg(self, number: int, sender: str, receiver: str) -> None:
        hub = self._hubs[number] = MemoryHub(self._request.seed * 4096 + number)
        for role, name, other in ((Role.SENDER, sender, receiver), (Role.RECEIVER, receiver, sender)):
            drone = self._drones[name]
            drone.harness.role, drone.harness.hub, drone.view.other = role, hub, other
        self._monitors.on_leg(number, sender, receiver)
        self._legs.open_leg(number, sender, receiver)

    def close_leg(self, number: int) -> None:
        self._world.close_leg(*self._ends_of(number))

    def _ends_of(self, leg: int) -> tuple[str, str]:
        return self._legs.end_of(leg, Role.SENDER), self._legs.end_of(leg, Role.RECEIVER)

    def landed(self, name: str) -> bool:
        return self._world.landed(name)

    def swap(self, name: str) -> None:
        drone = self._drones[name]
        self._close_flight(drone)
        self._world.swap(name)
        drone.harness.silent = drone.harness.lost = drone.harness.frozen = False
        drone.view.other = None

    # --- programs ---

    def _switch_on(self, drone: _VirtualDrone) -> None:
        if drone.name not in self._world.on:
            self._world.switch_on(drone.name)
            self._monitors.on_switched_on(drone.name, present_s())
            if drone.own.guard is not None and drone.guard is None:
                context = part_context(self._pairs[drone.name], OWN, drone.harness)
                beats = drone.harness.beats = MemoryBeatLine(context.clock)
                drone.guard = asyncio.create_task(keep_watch(drone.own.guard, context, beats, self._mission, _NoLog()))

    def _start(self, drone: _VirtualDrone, program: DroneProgram) -> Started:
        log = RelayLog(drone.log, drone.name, self._monitors, drone.offset_ns, self._request.whole_log)
        emit, stop, disk = self._emit_of(drone), self._programs.stop, self._programs.disk(drone.name)
        return Started(log, program(drone.name, log, emit, stop, drone.harness, disk))

    def _died(self, name: str) -> None:
        self._monitors.on_death(name)

    def _emit_of(self, drone: _VirtualDrone) -> Callable[[Progress], None]:
        def emit(progress: Progress) -> None:
            if not self._programs.killed(drone.name):
                self._request.emit(progress)
                self._legs.on_progress(drone.name, progress)

        return emit

    def _inject(self, leg: int, fault: Fault) -> None:
        """Injects a fault at the drone that has, or had, its role in the leg."""
        role = fault.kind.role
        name = None if role is None else self._legs.end_of(leg, role)
        inject_on_link(fault.name, fault.value or 0.0, self._hubs[leg])
        ends = self._ends_of(leg)
        if fault.name == "lookalike":
            self._world.send_lookalike(self._monitors.on_target(ends[0]))
        else:
            self._world.inject(fault.name, name, fault.value, ends)
        if name is not None:
            inject_at_drone(fault, name, self._drones[name].harness, self._programs)

    # --- what is seen ---

    async def _watch(self) -> None:
        vehicles_s = sample_s = 0.0
        world = self._world
        while True:
            now_s = present_s()
            if now_s != world.time_s:
                world.advance(now_s)
            self._monitors.on_truth(now_s)
            self._monitors.on_watched(now_s)
            if now_s >= vehicles_s:
                vehicles_s = now_s + VEHICLES_S
                self._monitors.on_vehicles(now_s, self._monitors.vehicles())
            if now_s >= sample_s:
                sample_s = now_s + SAMPLE_S
                self._monitors.sample(now_s, world.batteries, world.airborne)
            await asyncio.sleep(NEAR_PERIOD_S if len(world.airborne) > 1 else PERIOD_S)

    def _close_flight(self, drone: _VirtualDrone) -> None:
        """Closes one flight: its autopilot's record goes to the monitors before it is started anew."""
        self._monitors.on_offboard(drone.name, drone.harness.cut_off_s)
        self._monitors.on_swap(drone.name, present_s())
        drone.harness.cut_off_s = []
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
            "interrupted": self._programs.interrupted,
            "failure": failure,
            "log_failure": failed[0] if failed else "",
            "errors": reported(self._rig),
        }


class _NoLog:
    """A log that nobody reads."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...
