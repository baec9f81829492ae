"""One drone's flight in a relay: it takes the target over, has it, hands it over and comes home, all in one program.

A relief is the receiver of a handoff; once it holds, it changes its role in the air. Vehicle, perception and pilot
stay. The session and the protocol's machine begin anew on the other side. What it holds is written down as its own
before the receiver's machine is let go of, so that at any instant one record says that this drone is responsible.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from functools import partial

from drivers.interfaces import (
    Clock,
    Link,
    Log,
    PartError,
    Perception,
    RecordStore,
    Vehicle,
    VehicleState,
    VelocitySetpoint,
)
from drivers.rig.parts import PartContext, Rig, create, part_context
from flight.config import MissionConfig
from flight.guidance import Anchor, Vec3
from flight.harness.flights import Emit, InProcess, RoleResult
from flight.harness.relay import DroneProgram, NamedDrone, RelayConfig, pair_of
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.pilot import Pilot
from flight.target_track import TargetTrack
from flight.under_guard import UnderGuard
from missions.leg.course import close_session, conclude, run_course, run_recovery
from missions.leg.session import RoleSession, as_end, entropy_of, guard_line_of
from missions.leg.steps import bring_down, may_manoeuvre
from missions.relay.base import Ground, Leg, TakeOffOrder
from missions.relay.battery import Gauge
from missions.relay.guidance import keep_clear, way_home
from missions.relay.records import as_first, as_holder, as_relief, write
from missions.relay.stages import Holder, Nobody, Relief
from missions.rig_library import mission_of
from path.marker.warm_up import warm_up
from path.messages import Role
from path.protocol.values import SenderRecord

_POLL_S = 0.25
_THERE_M = 0.5
_THE_RELIEFS = frozenset(
    {Outcome.NO_AGREEMENT, Outcome.PEER_LOST, Outcome.PEER_ABORTED, Outcome.CLOCK_FAULT, Outcome.TOO_CLOSE}
)
"""Ends of a leg after which the target is still this drone's, and followed on."""


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts that stay open while the role changes."""

    clock: Clock
    vehicle: Vehicle
    perception: Perception
    guard: UnderGuard | None


class DroneFlight:
    """A drone's program. ``run`` is the whole of it.

    Args:
        base: knows what this drone was called for, and who relieves it.
    """

    def __init__(
        self, rig: Rig, relay: RelayConfig, base: Ground, name: str, log: Log, emit: Emit, stop: asyncio.Event,
        harness: InProcess | None, store: RecordStore,
    ) -> None:  # fmt: skip
        self._rig, self._relay, self._base, self._name = rig, relay, base, name
        self._log, self._emit, self._stop, self._harness, self._store = log, emit, stop, harness, store
        self._me: NamedDrone = next(drone for drone in relay.drones if drone.name == name)
        self._mission = mission_of(rig)
        deadlines = self._mission.deadlines
        self._leg_s = deadlines.peer_s + deadlines.receiver_ready_s + deadlines.verify_s
        self._gauge = Gauge(relay.endurance_s, relay.reserve)
        self._called = asyncio.Event()
        self._failed_at: tuple[Vec3, float] | None = None  # where a relief was heard last that failed, and until when

    async def run(self) -> RoleResult:
        """Raises PartError when a part cannot be opened."""
        async with AsyncExitStack() as stack:
            self._parts = await self._open(stack)
            if self._parts.vehicle.state.armed:
                return await self._begun_in_the_air()
            if self._base.order_of(self._name) is TakeOffOrder.FIND:
                return await self._find()
            return await self._relieve()

    # --- what a drone takes off for ---

    async def _find(self) -> RoleResult:
        await write(self._store, as_first(self._store.load()))
        session = self._session(Role.SENDER, None, Nobody())
        holder = Holder(session, self._store, self, None)
        end = await run_course(session, holder.find)
        if end is not None:
            return await self._end(session, holder, end)
        return await self._change_role(session, holder)

    async def _relieve(self) -> RoleResult:
        leg = self._base.leg_of(self._name)
        if leg is None:  # started again on the ground, too late
            what = "the leg it was called for is over"
            return RoleResult(Role.RECEIVER, Outcome.PEER_ABORTED, what, responsible=False, landed=True)
        await write(self._store, as_relief(self._store.load()))
        async with AsyncExitStack() as stack:
            session = self._session(Role.RECEIVER, leg, await self._link(stack, Role.RECEIVER))
            relief = Relief(session, self._store, self)
            end = await run_course(session, relief.course)
            if end is not None:
                return await self._end(session, relief, end)
            await relief.leave_role()
            return await self._change_role(session, relief, stack)

    async def _change_role(
        self, session: RoleSession, flown: Holder | Relief, link: AsyncExitStack | None = None
    ) -> RoleResult:
        """Flies on as a sender: from here on this drone is responsible by its own record, follows and hands over."""
        try:
            await write(self._store, as_holder(self._store.load()))
            self._base.holds(self._name)
            session, flown = await self._go_on(session, None, Nobody(), flown.track)
            if link is not None:
                await link.aclose()
            while True:
                self._called.clear()
                end = await run_course(session, partial(flown.keep, self._called))
                leg = self._base.leg_of(self._name)
                if end is not None or leg is None:
                    return await self._end(session, flown, end)
                async with AsyncExitStack() as stack:
                    session, flown = await self._go_on(session, leg, await self._link(stack, Role.SENDER), flown.track)
                    end = await run_course(session, partial(flown.pass_on, leg))
                    if end is None or end.outcome not in _THE_RELIEFS or flown.decided:
                        return await self._end(session, flown, end)
                    await self._leg_failed(session, flown, end)
                    session, flown = await self._go_on(session, None, Nobody(), flown.track)
        except PartError as error:  # the session that flies still does
            return await self._end(session, flown, as_end(error))

    async def _leg_failed(self, session: RoleSession, holder: Holder, end: MissionEnd) -> None:
        peer = session.peer
        if peer is not None:
            until_s = asyncio.get_running_loop().time() + self._relay.clear_s
            self._failed_at = peer.position_n_m, until_s
        await holder.give_up_leg(end)
        self._base.leg_failed(self._name, end)

    async def _begun_in_the_air(self) -> RoleResult:
        """Started again: what was under way is settled by what the disk says, and the drone lands."""
        kept = self._store.load()
        sender = kept is not None and isinstance(kept.record, SenderRecord)
        role, leg = (Role.SENDER if sender else Role.RECEIVER), self._base.leg_of(self._name)
        async with AsyncExitStack() as stack:
            in_leg = leg is not None and self._name == (leg.sender if sender else leg.receiver)
            link = await self._link(stack, role) if in_leg else Nobody()
            session = self._session(role, leg if in_leg else None, link)
            flown = Holder(session, self._store, self, None) if sender else Relief(session, self._store, self)
            end = await run_course(session, flown.resume)
            return await self._end(session, flown, end)

    # --- sessions ---

    async def _open(self, stack: AsyncExitStack) -> Parts:
        """Opens the parts once for the whole flight. To them a drone is always the one that sees the other's marker."""
        warm_up()
        context = self._context(Role.RECEIVER)
        own = self._alone.receiver
        perception: Perception = await stack.enter_async_context(create(own.perception, context))
        vehicle: Vehicle = await stack.enter_async_context(create(own.vehicle, context))
        self._entropy = entropy_of(self._name, context.clock, self._harness)
        guard: UnderGuard | None = None
        if own.guard is not None:
            line = guard_line_of(own.guard, Role.RECEIVER, context.clock, self._harness)
            guard = UnderGuard(await stack.enter_async_context(line), context.clock, self._mission.guard_process)
        return Parts(context.clock, vehicle, perception, guard)

    @property
    def _alone(self) -> Rig:
        return pair_of(self._rig, self._me, self._me)

    def _context(self, role: Role) -> PartContext:
        return part_context(self._alone, role, self._harness)

    async def _link(self, stack: AsyncExitStack, role: Role) -> Link:
        return await stack.enter_async_context(create(self._alone.role(role).link, self._context(role)))

    def _session(self, role: Role, leg: Leg | None, link: Link) -> RoleSession:
        drones = {drone.name: drone for drone in self._relay.drones}
        rig = self._alone if leg is None else pair_of(self._rig, drones[leg.sender], drones[leg.receiver])
        number = 1 if leg is None else 1 + (leg.number - 1) % 65535
        config: MissionConfig = replace(self._mission, handoff_id=number, follow_after_s=self._relay.follow_s)
        parts = self._parts
        made = (parts.clock, parts.vehicle, parts.perception, link)
        return RoleSession(rig, role, config, self._log, self._emit, self._stop, made, self._entropy, parts.guard)

    async def _go_on(
        self, before: RoleSession, leg: Leg | None, link: Link, track: TargetTrack | None
    ) -> tuple[RoleSession, Holder]:
        """The next session of a drone that stays in the air: the same pilot flies it, and misses no setpoint.

        Raises StateError; then the one before goes on.
        """
        assert track is not None, "what is held is tracked"
        session = self._session(Role.SENDER, leg, link)
        pilot: Pilot = before.pilot
        script = before.script
        holder = Holder(session, self._store, self, track)  # responsible by its record, or nothing has changed
        await before.cancel_spawned()
        session.pilot, session.script = pilot, script
        pilot.in_control = True
        session.spawn(pilot.run())
        return session, holder

    async def _end(self, session: RoleSession, flown: Holder | Relief, end: MissionEnd | None) -> RoleResult:
        landed = False
        try:
            if end is not None:
                await self._give_up(session, flown, end)
            landed = await run_recovery(session, flown.recover, end)
        finally:
            await close_session(session)
        return conclude(session, end, landed)

    # --- what holds in every session ---

    async def watch_battery(self, holder: Holder, *, ask: bool) -> None:
        """Ask for a relief in time, and go home in time without one. Raises MissionEnd(NO_RELIEF)."""
        vehicle, relay, base = self._parts.vehicle, self._relay, self._base
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
                if base.over or base.leg_of(self._name) is not None:
                    self._called.set()
            await asyncio.sleep(_POLL_S)

    # --- what a team's drones do otherwise ---

    entry_m = 0.0

    async def go_out(self, session: RoleSession, place: Callable[[], Vec3]) -> None:
        """The targets of a relay are near: the rendezvous, or the way to the designated place, begins at home."""

    def designated(self) -> Vec3 | None:
        return None

    def _tell_place(self, holder: Holder) -> None:
        """The base of a relay need not know where the target is."""

    async def _give_up(self, session: RoleSession, flown: Holder | Relief, end: MissionEnd) -> None:
        """Does nothing at a relay's end: its last drone stays responsible until a person says where the target is."""

    # --- what holds in every session ---

    def clear_of_the_failed(self, state: VehicleState, wanted: VelocitySetpoint) -> VelocitySetpoint:
        """A relief that failed hangs or sinks where it was: the target may lead there."""
        if self._failed_at is None:
            return wanted
        place_n_m, until_s = self._failed_at
        if asyncio.get_running_loop().time() > until_s:
            self._failed_at = None
            return wanted
        velocity = keep_clear(wanted.velocity_n_mps, state.position_n_m, place_n_m, self._relay.clear_m)
        return replace(wanted, velocity_n_mps=velocity)

    async def come_home(self, session: RoleSession, end: MissionEnd | None, aside: Anchor) -> bool:
        """Out of the others' way, up, home, and down; where that cannot be flown, down."""
        east, north = self._me.home_m
        *way, above = way_home(aside, (north, east, -self._relay.return_height_m))
        if may_manoeuvre(session, end):
            session.enter(Phase.DEPART, "on its way home")
        for anchor in way:
            if not may_manoeuvre(session, end):
                break
            await self._fly_to(session, anchor)
        return await bring_down(session, end, above)

    async def _fly_to(self, session: RoleSession, anchor: Anchor, speed_mps: float = 1.2) -> None:
        session.pilot.guidance = lambda state: anchor.hold(state, max_speed_mps=speed_mps)
        loop = asyncio.get_running_loop()
        end_s = loop.time() + session.config.deadlines.depart_s
        while session.pilot.in_control and loop.time() < end_s:
            north, east, down = session.vehicle.state.position_n_m
            n, e, d = anchor.position_n_m
            if max(abs(north - n), abs(east - e), abs(down - d)) < _THERE_M:
                return
            await asyncio.sleep(0.1)


def program_of(rig: Rig, relay: RelayConfig, base: Ground) -> DroneProgram:
    """The program of every drone of a relay (``flight.harness.relay.DroneProgram``)."""

    async def fly(
        name: str, log: Log, emit: Emit, stop: asyncio.Event, harness: InProcess, store: RecordStore
    ) -> RoleResult:
        return await DroneFlight(rig, relay, base, name, log, emit, stop, harness, store).run()

    return fly
