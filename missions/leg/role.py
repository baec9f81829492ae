"""The whole program of either role of a leg."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack

from drivers.interfaces import Log, RecordStore
from drivers.rig.parts import Rig
from flight.harness.flights import Emit, InProcess, RoleResult
from missions.leg.course import fly_course
from missions.leg.opening import open_session
from missions.leg.receiver import Receiver
from missions.leg.sender import Sender
from missions.rig_library import mission_of
from path.messages import Role


async def fly(
    rig: Rig, role: Role, log: Log, emit: Emit, stop: asyncio.Event, harness: InProcess | None, store: RecordStore
) -> RoleResult:
    """Flies a role from the opening of its parts to the vehicle on the ground. Raises PartError.

    Args:
        store: keeps what it has to know after a restart.
    """
    async with AsyncExitStack() as stack:
        session = await open_session(stack, rig, role, mission_of(rig), log, emit, stop, harness)
        flown = Sender(session, store) if role is Role.SENDER else Receiver(session, store)
        return await fly_course(session, flown.course, flown.recover)
