"""One drone's program in a mission of a person's own: preflight, the mission, and the way down
whatever happens.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AsyncExitStack

from drivers.rig.parts import Rig
from flight.harness.flights import ProgramContext, RoleResult
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.course import fly_course
from missions.fly.leg.opening import open_session
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import preflight
from missions.fly.own.drone import Drone
from missions.fly.own.load import Mission
from missions.ground.rig_library import mission_of
from path.messages import Role
from path.values import frozen


@frozen
class OwnMission:
    """The program of either drone (``flight.harness.flights.RoleMain``)."""

    missions: Mapping[Role, Mission]

    async def __call__(
        self,
        rig: Rig,
        role: Role,
        given: ProgramContext,
    ) -> RoleResult:
        """Fly the mission.

        Nothing is kept in the store: a program that is started again in the air lands. Raises
        PartError.
        """
        async with AsyncExitStack() as stack:
            session = await open_session(stack, rig, role, mission_of(rig), given)
            drone = Drone(session, given.store)
            return await fly_course(
                session,
                lambda: _course(session, self.missions[role], drone),
                drone.recover,
                good=Outcome.FLOWN,
            )


async def _course(
    session: RoleSession,
    mission: Mission,
    drone: Drone,
) -> None:
    if session.vehicle.state.armed:
        raise MissionEnd(Outcome.RESTARTED, "started again in the air")
    await preflight(session)
    session.enter(Phase.MISSION)
    try:
        await mission(drone)
    except KeyboardInterrupt as error:  # would end the program with its drone in the air
        raise MissionEnd(Outcome.CRASHED, f"the mission raised {type(error).__name__}") from error
