"""The field of a relay or a team in virtual time: drones switched on by name, their programs, the
links of their legs.

It is what the ground of a mission acts on (``flight.harness.relay.RelayField``), and where faults
take effect.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.log.mcap_log import McapLog, virtual_log
from drivers.rig.parts import RoleRig, part_context
from flight.config import MissionConfig
from flight.harness.flights import ProgramContext, Progress, RoleResult
from flight.harness.relay import DroneProgram, Pointed, RelayRequest
from hil.harness.drone import Disk, DroneHarness, PairView, present_s
from hil.harness.field import make_field, pointed, pointing
from hil.harness.guard import MemoryBeatLine, keep_watch
from hil.harness.inject import inject_at_drone, inject_in_leg, inject_on_link
from hil.harness.leg_faults import LegFaults
from hil.harness.programs import Programs, Started
from hil.link.faulty import MemoryHub
from hil.monitors.watched_log import WatchedLog
from hil.world.errors import Built
from hil.world.faults import Fault
from hil.world.world import OWN
from path.messages import Role


@dataclass(slots=True)
class VirtualDrone:
    """One drone: what its parts are connected to, its log, and its guard while it is on."""

    name: str
    own: RoleRig
    view: PairView
    harness: DroneHarness
    log: McapLog
    offset_ns: int
    guard: asyncio.Task[None] | None = None


class VirtualField:
    """
    Args:
        faults: by the number of their leg; of 0 those of all legs.
    """

    def __init__(
        self, request: RelayRequest, mission: MissionConfig, faults: Mapping[int, Sequence[Fault]]
    ) -> None:
        self._request = request
        self._mission = mission
        self.programs = Programs(self._died)
        self.legs = LegFaults(faults, self._inject)
        self._hubs: dict[int, MemoryHub] = {}
        self._pointing = pointing(request.seed)
        field = make_field(
            request.rig, request.config, request.targets, request.seed, request.hours
        )
        self._field = field
        self.world = field.world
        self.monitors = field.monitors
        self.drones = {
            name: self._new(name, pair.receiver, field.built[name])
            for name, pair in field.pairs.items()
        }

    def close(self) -> None:
        """Ends guards and logs, and tells the monitors of the last flights."""
        self.legs.close()
        for drone in self.drones.values():
            self._close_flight(drone)
            drone.log.close()

    def _new(self, name: str, own: RoleRig, built: Built) -> VirtualDrone:
        """Make a drone.

        To its own parts it is always the receiver, with a link to nobody until it is called to a
        leg.
        """
        view = PairView(self.world, name)
        seed = self._request.seed * 64 + self.world.names.index(name)
        harness = DroneHarness(view, self.world.advance, seed, built, OWN, MemoryHub(seed))
        self.programs.add(name, harness, Disk(lambda duty: self.legs.on_duty(name, duty)))
        offset_ns = round(float(own.clock.options.get("offset_s", 0.0)) * 1e9)
        log = virtual_log(self._request.out / f"{name}.mcap", name, offset_ns)
        return VirtualDrone(name, own, view, harness, log, offset_ns)

    def begin(self, name: str, program: DroneProgram) -> Awaitable[RoleResult | None]:
        drone = self.drones[name]
        self._switch_on(drone)
        return self._until_over(
            name, self.programs.begin(name, lambda: self._start(drone, program))
        )

    async def _until_over(
        self, name: str, program: Awaitable[RoleResult | None]
    ) -> RoleResult | None:
        try:
            return await program
        finally:
            self.monitors.on_over(name)

    def assign(self, name: str, target: int) -> None:
        self.monitors.on_assigned(name, target)

    def given_up(self, target: int) -> None:
        self.monitors.on_given_up(target)

    def point_at(self, target: int) -> Pointed:
        """A person points: off by some centimetres, and knows how it drives."""
        now_s = present_s()
        world = self.world
        if now_s != world.time_s:
            world.advance(now_s)
        thing = world.target(target)
        place_m = thing.position_w_m[:2]
        return pointed(place_m, thing.yaw_rad, thing.speed_mps, now_s, self._pointing)

    def open_leg(self, number: int, sender: str, receiver: str) -> None:
        hub = self._hubs[number] = MemoryHub(self._request.seed * 4096 + number)
        for role, name, other in (
            (Role.SENDER, sender, receiver),
            (Role.RECEIVER, receiver, sender),
        ):
            drone = self.drones[name]
            drone.harness.role = role
            drone.harness.hub = hub
            drone.view.other = other
        self.monitors.on_leg(number, sender, receiver)
        self.legs.open_leg(number, sender, receiver)

    def close_leg(self, number: int) -> None:
        self.world.uncover(*self._ends_of(number))

    def _ends_of(self, leg: int) -> tuple[str, str]:
        return self.legs.end_of(leg, Role.SENDER), self.legs.end_of(leg, Role.RECEIVER)

    def landed(self, name: str) -> bool:
        return self.world.landed(name)

    def battery(self, name: str) -> float:
        return self.world.drone(name).autopilot.battery

    def swap(self, name: str, battery: float) -> None:
        drone = self.drones[name]
        self._close_flight(drone)
        self.world.swap(name, battery)
        drone.harness.silent = drone.harness.lost = drone.harness.frozen = False
        drone.view.other = None

    def _switch_on(self, drone: VirtualDrone) -> None:
        if drone.name not in self.world.on:
            self.world.switch_on(drone.name)
            self.monitors.on_switched_on(drone.name, present_s())
            if drone.own.guard is not None and drone.guard is None:
                context = part_context(self._field.pairs[drone.name], OWN, drone.harness)
                beats = drone.harness.beats = MemoryBeatLine(context.clock)
                drone.guard = asyncio.create_task(
                    keep_watch(drone.own.guard, context, beats, self._mission, _NoLog())
                )

    def _start(self, drone: VirtualDrone, program: DroneProgram) -> Started:
        log = WatchedLog(
            drone.log, drone.name, self.monitors.on_record, drone.offset_ns, self._request.whole_log
        )
        disk = self.programs.disk(drone.name)
        given = ProgramContext(log, self._emit_of(drone), self.programs.stop, drone.harness, disk)
        return Started(log, program(drone.name, given).run())

    def _died(self, name: str) -> None:
        self.monitors.on_death(name)

    def _emit_of(self, drone: VirtualDrone) -> Callable[[Progress], None]:
        def emit(progress: Progress) -> None:
            if not self.programs.killed(drone.name):
                self._request.emit(progress)
                self.legs.on_progress(drone.name, progress)

        return emit

    def _inject(self, leg: int, fault: Fault) -> None:
        """Inject a fault at the drone that has, or had, its role in the leg."""
        role = fault.kind.role
        name = None if role is None else self.legs.end_of(leg, role)
        inject_on_link(fault.name, fault.value or 0.0, self._hubs[leg])
        ends = self._ends_of(leg)
        target = self.monitors.target_of(ends[0])
        inject_in_leg(fault.name, name, self.world, fault.value, ends, target)
        if name is not None:
            inject_at_drone(fault, name, self.drones[name].harness, self.programs)

    def _close_flight(self, drone: VirtualDrone) -> None:
        self._field.end_flight(drone.name, drone.harness.cut_off_s, present_s())
        if drone.guard is not None:
            drone.guard.cancel()
            drone.guard = None


class _NoLog:
    """A log that nobody reads."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...
