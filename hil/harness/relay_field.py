"""The field of a relay or a team in virtual time: drones switched on by name, their programs, the
links of their legs.

It is what the ground of a mission acts on (``flight.harness.relay.RelayField``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Mapping, Sequence
from typing import Any

from drivers.log.mcap_log import McapLog, virtual_log
from drivers.stop_signals import stop_on_signals
from flight.harness.flights import RoleResult
from flight.harness.relay import DroneProgram, Pointed, RelayRequest
from hil.harness.drone import PairView, present_s
from hil.harness.field import make_field, pointed, pointing
from hil.harness.inject import inject_in_leg
from hil.harness.programs import Started
from hil.harness.sim import mission_config
from hil.harness.virtual import VirtualDrone, VirtualDrones
from hil.link.faulty import MemoryHub
from hil.world.estimator import reported
from hil.world.faults import Fault
from hil.world.world import OWN
from path.messages import Role

NEAR_PERIOD_S = 0.04  # looks at the truth while two are in the air
PERIOD_S = 0.2
VEHICLES_S = 1.0
SAMPLE_S = 10.0
LANDING_LIMIT_S = 90.0


class VirtualField(VirtualDrones):
    """One relay or team, from the first moment until everybody is down.

    Args:
        faults: by the number of their leg; of 0 those of all legs.
    """

    def __init__(self, request: RelayRequest, faults: Mapping[int, Sequence[Fault]]) -> None:
        field = make_field(
            request.rig, request.config, request.targets, request.seed, request.hours
        )
        mission = mission_config(request.rig)
        super().__init__(
            field.world,
            field.monitors,
            mission,
            faults,
            request.emit,
            request.seed,
            request.whole_log,
        )
        self._request = request
        self._field = field
        self._pointing = pointing(request.seed)
        self._views: dict[str, PairView] = {}
        self._logs: dict[str, McapLog] = {}
        # to its own parts a drone is always the receiver, with a link to nobody until it is called
        for k, (name, pair) in enumerate(field.pairs.items()):
            view = self._views[name] = PairView(field.world, name)
            seed = request.seed * 64 + k
            self.add(name, pair, OWN, view, seed, field.built[name], MemoryHub(seed))
            offset_ns = self.drones[name].offset_ns
            self._logs[name] = virtual_log(request.out / f"{name}.mcap", name, offset_ns)

    async def run(self) -> dict[str, Any]:
        """The fields of the RelayReport, without the wall's."""
        stop_on_signals(self.programs.interrupt)
        watching = asyncio.create_task(self._watch())
        try:
            await self._request.main(self, self.programs.stop, self._request.emit)
        finally:
            await self.until_down(LANDING_LIMIT_S)
            watching.cancel()
            self.legs.close()
            for name, drone in self.drones.items():
                self._close_flight(drone)
                self._logs[name].close()
        aloft = [name for name in self.world.names if not self.landed(name)]
        return {
            **self._field.monitors.findings(),
            "simulated_s": present_s(),
            "interrupted": self.programs.interrupted,
            "failure": f"not landed at the end: {', '.join(aloft)}" if aloft else "",
            "log_failure": next(filter(None, (log.failed for log in self._logs.values())), ""),
            "errors": reported(self._request.rig),
        }

    async def _watch(self) -> None:
        world = self.world
        monitors = self._field.monitors
        vehicles_s = 0.0
        sample_s = 0.0
        while True:
            now_s = present_s()
            if now_s != world.time_s:
                world.advance(now_s)
            monitors.on_truth(now_s)
            monitors.on_watched(now_s)
            if now_s >= vehicles_s:
                vehicles_s = now_s + VEHICLES_S
                monitors.on_vehicles(now_s, monitors.vehicles())
            if now_s >= sample_s:
                sample_s = now_s + SAMPLE_S
                monitors.sample(now_s, world.batteries, world.airborne)
            await asyncio.sleep(NEAR_PERIOD_S if len(world.airborne) > 1 else PERIOD_S)

    # --- what those on the ground do ---

    def begin(self, name: str, program: DroneProgram) -> Awaitable[RoleResult | None]:
        drone = self.drones[name]
        if name not in self.world.on:
            self.world.switch_on(name)
            self._field.monitors.on_switched_on(name, present_s())
            self.start_guard(drone, _NoLog())

        def start() -> Started:
            watched, given = self.given(drone, self._logs[name])
            return Started(watched, program(name, given).run())

        return self._until_over(name, self.programs.begin(name, start))

    async def _until_over(
        self, name: str, program: Awaitable[RoleResult | None]
    ) -> RoleResult | None:
        try:
            return await program
        finally:
            self._field.monitors.on_over(name)

    def assign(self, name: str, target: int) -> None:
        self._field.monitors.on_assigned(name, target)

    def given_up(self, target: int) -> None:
        self._field.monitors.on_given_up(target)

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
        hub = self.hubs[number] = MemoryHub(self._request.seed * 4096 + number)
        for role, name, other in (
            (Role.SENDER, sender, receiver),
            (Role.RECEIVER, receiver, sender),
        ):
            harness = self.drones[name].harness
            harness.role = role
            harness.hub = hub
            self._views[name].other = other
        self._field.monitors.on_leg(number, sender, receiver)
        self.legs.open_leg(number, sender, receiver)

    def close_leg(self, number: int) -> None:
        self.world.uncover(*(self.legs.end_of(number, role) for role in Role))

    def landed(self, name: str) -> bool:
        return self.world.landed(name)

    def battery(self, name: str) -> float:
        return self.world.drone(name).autopilot.battery

    def swap(self, name: str, battery: float) -> None:
        drone = self.drones[name]
        self._close_flight(drone)
        self.world.swap(name, battery)
        harness = drone.harness
        harness.silent = harness.lost = harness.frozen = False
        self._views[name].other = None

    def inject_in_world(self, fault: Fault, name: str | None, ends: Sequence[str]) -> None:
        target = self._field.monitors.target_of(ends[0])
        inject_in_leg(fault.name, name, self.world, fault.value, ends, target)

    def _close_flight(self, drone: VirtualDrone) -> None:
        self._field.end_flight(drone.name, drone.harness.cut_off_s, present_s())
        if drone.guard is not None:
            drone.guard.cancel()
            drone.guard = None


class _NoLog:
    """A log that nobody reads."""

    def write(self, topic: str, stamp_ns: int, record: Any) -> None: ...

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...
