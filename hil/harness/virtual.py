"""Drones of one process in virtual time, by name: their parts, programs and guards, and where faults
take effect.

A pair's are flown by ``hil.harness.sim``, those of a relay or a team by ``hil.harness.relay_field``.
In real time ``hil.harness.realtime.programs`` does the same with processes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from drivers.interfaces import Log
from drivers.log.mcap_log import McapLog
from drivers.rig.parts import Rig, RoleRig, part_context
from flight.config import MissionConfig
from flight.harness.flights import Emit, ProgramContext, Progress
from hil.harness.drone import Disk, DroneHarness, until
from hil.harness.guard import MemoryBeatLine, keep_watch
from hil.harness.inject import inject_at_drone, inject_on_link
from hil.harness.leg_faults import LegFaults
from hil.harness.programs import Programs
from hil.link.faulty import MemoryHub
from hil.monitors.monitors import Monitors
from hil.monitors.watched_log import WatchedLog
from hil.world.errors import Built
from hil.world.faults import Fault
from hil.world.seam import PartWorld
from hil.world.world import Fleet
from path.messages import Role


@dataclass(slots=True)
class VirtualDrone:
    """One drone: what its parts are connected to, and its guard while it has one.

    Attributes:
        rig, role: as its own parts know it.
    """

    name: str
    rig: Rig
    role: Role
    harness: DroneHarness
    guard: asyncio.Task[None] | None = None

    @property
    def own(self) -> RoleRig:
        return self.rig.role(self.role)

    @property
    def offset_ns(self) -> int:
        """Its clock minus the world's, as the rig sets the drones' clocks apart."""
        return round(float(self.own.clock.options.get("offset_s", 0.0)) * 1e9)


@dataclass
class VirtualDrones:
    """
    Args:
        faults: by the number of their leg; of 0 those of all legs.
        emit: shown the progress of every program.
        whole_log: also what is logged often.
    """

    world: Fleet
    monitors: Monitors
    mission: MissionConfig
    faults: Mapping[int, Sequence[Fault]]
    emit: Emit
    seed: int
    whole_log: bool = True
    drones: dict[str, VirtualDrone] = field(default_factory=dict[str, VirtualDrone])
    hubs: dict[int, MemoryHub] = field(default_factory=dict[int, MemoryHub])
    programs: Programs = field(init=False)
    legs: LegFaults = field(init=False)

    def __post_init__(self) -> None:
        self.programs = Programs(self._died, self._forgot)
        self.legs = LegFaults(self.faults, self._inject)

    def add(
        self,
        name: str,
        rig: Rig,
        role: Role,
        view: PartWorld,
        seed: int,
        built: Built,
        hub: MemoryHub,
    ) -> None:
        """Add a drone, which may have a program from now on.

        Args:
            view: the world as its parts know it; ``seed``: of their noise.
        """
        harness = DroneHarness(view, self.world.advance, seed, built, role, hub)
        self.drones[name] = VirtualDrone(name, rig, role, harness)
        self.programs.add(name, harness, Disk(lambda duty: self.legs.on_duty(name, duty)))

    def start_guard(self, drone: VirtualDrone, log: Log) -> None:
        """Start the guard of a drone whose rig has one; it outlives the drone's programs."""
        if drone.own.guard is not None and drone.guard is None:
            context = part_context(drone.rig, drone.role, drone.harness)
            beats = drone.harness.beats = MemoryBeatLine(context.clock)
            watching = keep_watch(drone.own.guard, context, beats, self.mission, log)
            drone.guard = asyncio.create_task(watching)

    def given(self, drone: VirtualDrone, log: McapLog) -> tuple[WatchedLog, ProgramContext]:
        """Return what a program of a drone is given when it starts, and its log alone."""
        watched = WatchedLog(
            log, drone.name, self.monitors.on_record, drone.offset_ns, self.whole_log
        )
        disk = self.programs.disk(drone.name)
        emit = self._emit_of(drone.name)
        return watched, ProgramContext(watched, emit, self.programs.stop, drone.harness, disk)

    async def until_down(self, limit_s: float) -> None:
        """Wait until all have landed, so long at most."""
        await until(lambda: all(map(self.world.landed, self.world.on)), limit_s)

    def _died(self, name: str) -> None:
        self.monitors.on_death(name)

    def _forgot(self, name: str) -> None:
        self.monitors.on_forgotten(self.world.time_s, name)

    def _emit_of(self, name: str) -> Emit:
        def emit(progress: Progress) -> None:
            if not self.programs.killed(name):
                self.emit(progress)
                self.legs.on_progress(name, progress)

        return emit

    def _inject(self, leg: int, fault: Fault) -> None:
        """Inject a fault at the drone that has, or had, its role in the leg."""
        ends = [self.legs.end_of(leg, role) for role in Role]
        role = fault.kind.role
        name = None if role is None else self.legs.end_of(leg, role)
        inject_on_link(fault.name, fault.value or 0.0, self.hubs[leg])
        self.inject_in_world(fault, name, ends)
        if name is not None:
            inject_at_drone(fault, name, self.drones[name].harness, self.programs)

    def inject_in_world(self, fault: Fault, name: str | None, ends: Sequence[str]) -> None:
        """A fault of the world, at a drone or between the two ends of a leg."""
        raise NotImplementedError
