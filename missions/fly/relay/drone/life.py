"""One drone's flight in a relay: it takes the target over, has it, hands it over and comes home,
all in one program.

A relief is the receiver of a handoff; once it holds, it changes its role in the air. Vehicle,
perception and pilot stay. The session and the protocol's machine begin anew on the other side. What
it holds is written down as its own before the receiver's machine is let go of, so that at any
instant one record says that this drone is responsible.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from functools import partial

from drivers.interfaces import PartError, StateError
from flight.harness.flights import RoleResult
from flight.outcome import MissionEnd, Outcome
from missions.fly.leg.course import Course, close_session, conclude, run_course, run_recovery
from missions.fly.leg.session import RoleSession, as_end
from missions.fly.relay.drone.aboard import Aboard
from missions.fly.relay.drone.records import as_first, as_holder, as_relief, write
from missions.fly.relay.drone.stages import Holder, Nobody, Relief
from missions.fly.relay.ground import TakeOffOrder
from path.messages import Role
from path.protocol.values import SenderRecord

_THE_RELIEFS = frozenset(
    {
        Outcome.NO_AGREEMENT,
        Outcome.PEER_LOST,
        Outcome.PEER_ABORTED,
        Outcome.CLOCK_FAULT,
        Outcome.TOO_CLOSE,
    }
)
"""Ends of a leg after which the target is still this drone's, and followed on."""


class DroneFlight(Aboard):
    """A drone's program, and its whole life: its order, a leg as receiver, holder, a leg as sender,
    home.
    """

    async def run(self) -> RoleResult:
        """Raise PartError when a part cannot be opened."""
        async with AsyncExitStack() as stack:
            self._parts = await self._open(stack)
            if self._parts.vehicle.state.armed:
                return await self._begun_in_the_air()
            try:
                if self._base.order_of(self._name) is TakeOffOrder.FIND:
                    return await self._find()
                return await self._relieve()
            except _TurnsBack as again:
                return await self._look_for(again.session, again.holder, again.holder.find_again)

    async def _find(self) -> RoleResult:
        await write(self._store, as_first(self._store.load()))
        session = self._session(Role.SENDER, None, Nobody())
        holder = Holder(session, self._store, self, None)
        return await self._look_for(session, holder, holder.find)

    async def _look_for(
        self,
        session: RoleSession,
        holder: Holder,
        course: Course,
    ) -> RoleResult:
        """Find its target: for the first time, or once more instead of coming home, when nobody
        has it any more.
        """
        end = await run_course(session, course)
        if end is not None:
            return await self._end(session, holder, end)
        return await self._change_role(session, holder)

    async def _relieve(self) -> RoleResult:
        leg = self._base.leg_of(self._name)
        if leg is None:  # started again on the ground, too late
            what = "the leg it was called for is over"
            return RoleResult(
                Role.RECEIVER,
                Outcome.PEER_ABORTED,
                what,
                responsible=False,
                landed=True,
            )
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
        self,
        session: RoleSession,
        flown: Holder | Relief,
        link: AsyncExitStack | None = None,
    ) -> RoleResult:
        """Fly on as a sender: from here on this drone is responsible by its own record, follows
        and hands over.
        """
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
                    session, flown = await self._go_on(
                        session,
                        leg,
                        await self._link(stack, Role.SENDER),
                        flown.track,
                    )
                    end = await run_course(session, partial(flown.pass_on, leg))
                    if end is None or end.outcome not in _THE_RELIEFS or flown.decided:
                        return await self._end(session, flown, end)
                    await self._leg_failed(session, flown, end)
                    session, flown = await self._go_on(session, None, Nobody(), flown.track)
        except PartError as error:  # the session that flies still does
            return await self._end(session, flown, as_end(error))

    async def _leg_failed(
        self,
        session: RoleSession,
        holder: Holder,
        end: MissionEnd,
    ) -> None:
        peer = session.peer
        if peer is not None:
            until_s = asyncio.get_running_loop().time() + self._relay.clear_s
            self._failed_at = session.here(peer).position_n_m, until_s
        await holder.give_up_leg(end)
        self._base.leg_failed(self._name, end)

    async def _begun_in_the_air(self) -> RoleResult:
        """Started again: what was under way is settled by what the disk says, and the drone
        lands.
        """
        kept = self._store.load()
        sender = kept is not None and isinstance(kept.record, SenderRecord)
        role = Role.SENDER if sender else Role.RECEIVER
        leg = self._base.leg_of(self._name)
        async with AsyncExitStack() as stack:
            in_leg = leg is not None and self._name == (leg.sender if sender else leg.receiver)
            link = await self._link(stack, role) if in_leg else Nobody()
            session = self._session(role, leg if in_leg else None, link)
            flown = (
                Holder(session, self._store, self, None)
                if sender
                else Relief(session, self._store, self)
            )
            end = await run_course(session, flown.resume)
            return await self._end(session, flown, end)

    async def _end(
        self,
        session: RoleSession,
        flown: Holder | Relief,
        end: MissionEnd | None,
    ) -> RoleResult:
        """Raise _TurnsBack for a drone that is not to come home."""
        landed = False
        flies_on = False
        try:
            if end is not None:
                await self._give_up(session, flown, end)
            landed = await run_recovery(session, flown.recover, end)
            if self.turning_back:
                self.turning_back = False
                await write(self._store, as_first(self._store.load()))
                again = _TurnsBack(*await self._go_on(session, None, Nobody(), None))
                flies_on = True
                raise again
        except StateError as error:  # the disk: it comes home after all
            landed = await run_recovery(session, flown.recover, as_end(error))
        finally:
            if not flies_on:
                await close_session(session)
        return conclude(session, end, landed)


class _TurnsBack(Exception):
    """A drone on its way home is to find its target again; whatever was open for its last leg is
    closed on the way.
    """

    def __init__(self, session: RoleSession, holder: Holder) -> None:
        super().__init__()
        self.session = session
        self.holder = holder
