"""A drone's parts that stay open while its role changes, its sessions, its battery and its ways."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import replace

from drivers.interfaces import Clock, Link, Perception, Vehicle, VehicleState, VelocitySetpoint
from drivers.rig.parts import PartContext, Rig, create, part_context
from flight.config import MissionConfig
from flight.guard.under_guard import UnderGuard
from flight.guidance import Anchor, Vec3, add
from flight.harness.fleet import NamedDrone, RelayConfig, pair_of
from flight.harness.flights import ProgramContext
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.pilot import Pilot
from flight.steady_vehicle import SteadyVehicle
from flight.tracking.target_track import TargetTrack
from missions.fly.leg.opening import entropy_of, guard_line_of, leave_opening, warm_up_for
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, may_manoeuvre
from missions.fly.relay.drone.battery import Gauge
from missions.fly.relay.drone.guidance import keep_clear, way_home
from missions.fly.relay.drone.records import for_leg, write
from missions.fly.relay.drone.stages import Holder, Relief
from missions.fly.relay.ground import Ground, Leg
from missions.ground.rig_library import mission_of
from path.messages import Role
from path.values import frozen

_POLL_S = 0.25
_THERE_M = 0.5


@frozen
class Parts:
    """The parts that stay open while the role changes."""

    clock: Clock
    vehicle: Vehicle
    perception: Perception
    guard: UnderGuard | None


class Aboard:
    """Everything of a drone but the order in which it does things
    (``missions.fly.relay.drone.life.DroneFlight``).

    Args:
        base: knows what this drone was called for, and who relieves it.
    """

    _parts: Parts  # once they are open

    def __init__(
        self, rig: Rig, relay: RelayConfig, base: Ground, name: str, given: ProgramContext
    ) -> None:
        self._rig = rig
        self._relay = relay
        self._base = base
        self._name = name
        self._given = given
        self._harness = given.harness
        self._store = given.store
        self._me: NamedDrone = next(drone for drone in relay.drones if drone.name == name)
        self._mission = from_home(mission_of(rig), self._me)
        self._flying: RoleSession | None = None
        deadlines = self._mission.deadlines
        self._leg_s = deadlines.peer_s + deadlines.receiver_ready_s + deadlines.verify_s
        self._gauge = Gauge(relay.endurance_s, relay.reserve)
        self._called = asyncio.Event()
        # where a relief was heard last that failed, and until when
        self._failed_at: tuple[Vec3, float] | None = None

    # --- sessions ---

    async def _open(self, stack: AsyncExitStack) -> Parts:
        """Open the parts once for the whole flight. To them a drone is always the one that sees
        the other's marker.
        """
        context = self._context(Role.RECEIVER)
        own = self._alone.receiver
        warm_up_for(own, self._harness)
        perception: Perception = await stack.enter_async_context(create(own.perception, context))
        vehicle: Vehicle = await stack.enter_async_context(create(own.vehicle, context))
        self._entropy = entropy_of(self._name, context.clock, self._harness)
        guard: UnderGuard | None = None
        if own.guard is not None:
            line = guard_line_of(own.guard, Role.RECEIVER, context.clock, self._harness)
            guard = UnderGuard(
                await stack.enter_async_context(line), context.clock, self._mission.guard_process
            )
        leave_opening(self._harness)
        # one for all sessions: a step is taken out once
        steady = SteadyVehicle.of(vehicle, self._mission)
        return Parts(context.clock, steady, perception, guard)

    @property
    def off_n_m(self) -> Vec3:
        """The error of this drone's own position, as it was at its home."""
        return (0.0, 0.0, 0.0) if self._flying is None else self._flying.off_n_m

    @property
    def _alone(self) -> Rig:
        return pair_of(self._rig, self._me, self._me)

    def _context(self, role: Role) -> PartContext:
        return part_context(self._alone, role, self._harness)

    async def _link(self, stack: AsyncExitStack, role: Role) -> Link:
        return await stack.enter_async_context(
            create(self._alone.role(role).link, self._context(role))
        )

    def _session(self, role: Role, leg: Leg | None, link: Link) -> RoleSession:
        drones = {drone.name: drone for drone in self._relay.drones}
        rig = (
            self._alone
            if leg is None
            else pair_of(self._rig, drones[leg.sender], drones[leg.receiver])
        )
        number = 1 if leg is None else 1 + (leg.number - 1) % 65535
        config: MissionConfig = replace(
            self._mission, handoff_id=number, follow_after_s=self._relay.follow_s
        )
        parts = self._parts
        given = self._given
        made = (parts.clock, parts.vehicle, parts.perception, link)
        session = RoleSession(
            rig, role, config, given.log, given.emit, given.stop, made, self._entropy, parts.guard
        )
        self._flying = session
        return session

    async def _go_on(
        self, before: RoleSession, leg: Leg | None, link: Link, track: TargetTrack | None
    ) -> tuple[RoleSession, Holder]:
        """The next session of a drone that stays in the air: the same pilot flies it, and misses no
        setpoint.

        Raises StateError; then the one before goes on.
        """
        if leg is not None:
            await write(self._store, for_leg(self._store.load(), leg.number))
        session = self._session(Role.SENDER, leg, link)
        pilot: Pilot = before.pilot
        script = before.guarding.script
        session.off_n_m = before.off_n_m
        # responsible by its record, or nothing has changed
        holder = Holder(session, self._store, self, track)
        await before.cancel_spawned()
        session.pilot = pilot
        session.guarding.script = script
        pilot.in_control = True
        session.spawn(pilot.run())
        return session, holder

    # --- what holds in every session ---

    async def watch_battery(self, holder: Holder, *, ask: bool) -> None:
        """Ask for a relief in time, and go home in time without one. Raises
        MissionEnd(NO_RELIEF).
        """
        vehicle = self._parts.vehicle
        relay = self._relay
        base = self._base
        loop = asyncio.get_running_loop()
        while True:
            battery = vehicle.state.battery
            self._gauge.note(loop.time(), battery)
            self._tell_place(holder)
            wait_s = self._gauge.left_s - relay.home_s
            if wait_s <= 0.0 and not holder.decided:
                what = f"battery at {100 * battery:.0f} %: {relay.home_s:.0f} s to come home above the reserve"
                raise MissionEnd(Outcome.NO_RELIEF, what)
            if ask:
                if wait_s <= relay.attempts * self._leg_s:
                    base.ask(self._name, battery, wait_s)
                if base.called_home(self._name) or base.leg_of(self._name) is not None:
                    self._called.set()
            await asyncio.sleep(_POLL_S)

    # --- what a team's drones do otherwise ---

    entry_m = 0.0  # behind the other one, where it goes down to it
    turning_back = False  # to find the target again, instead of coming home

    async def go_out(self, session: RoleSession, place: Callable[[], Vec3]) -> None:
        """Fly from above its home to a place that may move, and down to it. The targets of a relay
        are near: the rendezvous, or the way to the designated place, begins at home.
        """

    def designated(self) -> Vec3 | None:
        """Return the place at which the target is pointed; None: the mission's."""
        return None

    def _tell_place(self, holder: Holder) -> None:
        """The base of a relay need not know where the target is."""

    async def _give_up(self, session: RoleSession, flown: Holder | Relief, end: MissionEnd) -> None:
        """Does nothing at a relay's end: its last drone stays responsible until a person says where
        the target is.
        """

    # --- what holds in every session ---

    def clear_of_the_failed(
        self, state: VehicleState, wanted: VelocitySetpoint
    ) -> VelocitySetpoint:
        """A relief that failed hangs or sinks where it was: the target may lead there."""
        if self._failed_at is None:
            return wanted
        place_n_m, until_s = self._failed_at
        if asyncio.get_running_loop().time() > until_s:
            self._failed_at = None
            return wanted
        velocity = keep_clear(
            wanted.velocity_n_mps, state.position_n_m, place_n_m, self._relay.clear_m
        )
        return replace(wanted, velocity_n_mps=velocity)

    async def come_home(self, session: RoleSession, end: MissionEnd | None, aside: Anchor) -> bool:
        """Fly out of the others' way, up, home, and down; where that cannot be flown, down. Returns
        whether the script landed the vehicle.
        """
        *way, above = way_home(aside, self.above_home(self._relay.return_height_m))
        if may_manoeuvre(session, end):
            session.enter(Phase.DEPART, "on its way home")
        for anchor in way:
            if not may_manoeuvre(session, end):
                break
            await self._fly_to(session, anchor)
        return await bring_down(session, end, above)

    def above_home(self, height_m: float) -> Vec3:
        """Its home, in its own coordinates."""
        east, north = self._me.home_m
        return add((north, east, -height_m), self.off_n_m)

    async def _fly_to(
        self,
        session: RoleSession,
        anchor: Anchor,
        speed_mps: float = 1.2,
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        session.pilot.guidance = lambda state: anchor.hold(
            state, max_speed_mps=speed_mps, towards=session.fence.towards
        )
        loop = asyncio.get_running_loop()
        end_s = loop.time() + session.config.deadlines.depart_s
        while session.pilot.in_control and loop.time() < end_s and not until():
            north, east, down = session.vehicle.state.position_n_m
            n, e, d = anchor.position_n_m
            if max(abs(north - n), abs(east - e), abs(down - d)) < _THERE_M:
                return
            await asyncio.sleep(0.1)


def from_home(mission: MissionConfig, drone: NamedDrone) -> MissionConfig:
    """The mission of a pair, by a drone that is put down at a home of its own."""
    east, north = drone.home_m
    target = mission.target
    rendezvous = mission.rendezvous
    return replace(
        mission,
        target=replace(target, home_m=(north, east)),
        rendezvous=replace(rendezvous, home_m=(north, east)),
    )
