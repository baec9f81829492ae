"""The roles of a drone in a relay, one after the other: the relief that takes the target over, the
holder that has it.

Both are a handoff's roles. They differ from them in what comes before and after: a relief does not
land, a holder has its track of the target from the start, and both fly home instead of landing
where they are.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivers.interfaces import LinkCounters, Received, RecordStore, VehicleState, VelocitySetpoint
from drivers.operator.interfaces import PlaceTold
from flight.guidance import Anchor, Vec3, add, from_heading, subtract
from flight.outcome import MissionEnd
from flight.phases import Phase
from flight.tracking.target_track import TargetTrack
from missions.fly.leg.receiver import Receiver
from missions.fly.leg.sender import Sender
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import check_own, hear_peer, take_off
from missions.fly.relay.ground import Leg
from path.messages import Message

if TYPE_CHECKING:
    from missions.fly.relay.drone.aboard import Aboard  # which makes these stages


class Nobody:
    """The link of a drone that has no other one to talk to yet (``drivers.interfaces.Link``)."""

    def __init__(self) -> None:
        self.counters = LinkCounters()

    async def __aenter__(self) -> Nobody:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def send(self, message: Message) -> None:
        """Drop the message: there is nobody to hear it."""

    async def receive(self) -> Received:
        return await asyncio.get_running_loop().create_future()


class Holder(Sender):
    """The responsible drone: alone with the target, or handing it over."""

    def __init__(
        self, session: RoleSession, store: RecordStore, aboard: Aboard, track: TargetTrack | None
    ) -> None:
        super().__init__(session, store)
        self._track = track
        self._aboard = aboard

    @property
    def track(self) -> TargetTrack | None:
        return self._track

    @property
    def decided(self) -> bool:
        """Committed, or given away already: what the battery says comes too late."""
        return self._handover.released

    @property
    def has_given_away(self) -> bool:
        return self.decided

    async def find(self) -> None:
        """Fly from the ground until the target is tracked."""
        session = self._session
        await self._handover.resume()
        await check_own(session)
        session.note_home(self._config.target.home_m)
        await take_off(session, self._config.take_off_height_m)
        await self.find_again()

    async def find_again(self) -> None:
        """Fly from wherever it is until the target is tracked."""
        session = self._session
        await self._aboard.go_out(
            session, lambda: self._view_of(*self._place_to_look_at(session.now_ns()))
        )
        await self.acquire()

    async def resume(self) -> None:
        await self._handover.resume()

    async def keep(self, called: asyncio.Event) -> None:
        """Follow the target alone, for as long as no relief is on its way."""
        self._go_on("responsible, alone")
        self._session.spawn(self._aboard.watch_battery(self, ask=True))
        await called.wait()

    async def pass_on(self, leg: Leg) -> None:
        """The whole hand-over to a relief that is called."""
        session = self._session
        self._go_on(f"{leg.receiver} is called")
        session.spawn(self._aboard.watch_battery(self, ask=False))
        await hear_peer(session)
        await self.hand_over()

    async def give_up_leg(self, end: MissionEnd) -> None:
        """The relief will not take it: say so, and keep the target."""
        self._handover.end(end)
        await self._handover.finish()

    def _place_to_look_at(self, now_ns: int) -> tuple[Vec3, float]:
        place = self._aboard.designated()
        return super()._place_to_look_at(now_ns) if place is None else (place, 1.0)

    def _pointed_at(self) -> PlaceTold | None:
        place = self._aboard.designated()  # by somebody who goes on pointing at it
        if place is None:
            return None
        north, east, down = subtract(place, self._session.off_n_m)
        return PlaceTold(self._session.now_ns(), (north, east, down), self._config.target.error_m)

    def _go_on(self, note: str) -> None:
        session = self._session
        session.enter(Phase.FOLLOW, note)
        session.observing = True
        session.pilot.guidance = self._follow_target
        session.spawn(self._watch())

    def _follow_target(self, state: VehicleState) -> VelocitySetpoint:
        wanted = super()._follow_target(state)
        return self._aboard.clear_of_the_failed(state, wanted)

    async def _come_down(self, end: MissionEnd | None, way_out: Anchor) -> bool:
        return await self._aboard.come_home(self._session, end, way_out)


class Relief(Receiver):
    """The drone that is called: the receiver of a handoff, which does not land after it."""

    def __init__(self, session: RoleSession, store: RecordStore, aboard: Aboard) -> None:
        super().__init__(session, store)
        self._aboard = aboard

    @property
    def track(self) -> TargetTrack | None:
        return self._track

    @property
    def has_given_away(self) -> bool:
        """Within a lease it is the lease that decides."""
        return not self._handover.holds_for_good

    async def resume(self) -> None:
        await self._handover.resume()

    async def _rise(self) -> None:
        await super()._rise()
        await self._aboard.go_out(self._session, self._entry)

    def _entry(self) -> Vec3:
        """Behind the other drone, at the height from which the rendezvous begins."""
        peer = self._peer()
        north, east, _ = add(
            peer.position_n_m, from_heading((-self._aboard.entry_m, 0.0, 0.0), peer.yaw_rad)
        )
        return north, east, -self._config.receiver_take_off_height_m

    async def leave_role(self) -> None:
        """Hear nothing more as a receiver, and have everything written down. Raises StateError."""
        self._session.on_message = self._session.on_status = _ignore
        await self._handover.finish()

    async def _come_down(self, end: MissionEnd | None, way_out: Anchor) -> bool:
        return await self._aboard.come_home(self._session, end, way_out)


def _ignore(_: object) -> None:
    pass
