"""A hand-over within a mission of a person's own: both sides of the flight's own, begun wherever
the drones are.
"""

from __future__ import annotations

from drivers.interfaces import RecordStore
from drivers.operator.interfaces import PlaceTold
from flight.guidance import Vec3, subtract
from missions.fly.leg.receiver import Receiver
from missions.fly.leg.sender import Sender
from missions.fly.leg.session import RoleSession


class Giving(Sender):
    """D1's side: it finds the object at a place, follows it, and hands it over."""

    def __init__(
        self,
        session: RoleSession,
        store: RecordStore,
        place_n_m: Vec3 | None,
        error_m: float,
    ) -> None:
        told = None
        if place_n_m is not None:
            # what is told is in the crew's frame, and this drone's own is off from it as it was at
            # home
            there = subtract(place_n_m, session.off_n_m)
            told = PlaceTold(session.now_ns(), there, error_m)
        super().__init__(session, store, told)

    async def give(self) -> None:
        """Return once the other drone holds the target. Raises MissionEnd when it does not come to
        that.
        """
        await self._handover.resume()
        await self._handover.until_free()
        await self.acquire()
        await self.hand_over()
        self._watching = False


class Taking(Receiver):
    """D2's side: it waits for an offer, flies to where it sees marker and target, and takes the
    target over.
    """

    async def take(self) -> None:
        """Return once this drone holds the target for good, and follows it. Raises MissionEnd
        otherwise.
        """
        await self._handover.resume()
        await self.take_over()

    def let_go(self) -> None:
        """Look at no more frames: the mission does."""
        self._watching = False

    async def _rise(self) -> None:
        if not self._session.pilot.in_control:
            await super()._rise()
