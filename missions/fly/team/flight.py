"""One drone's flight in a team: that of a relay, on the target it was sent to, over the ways of the
team.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

from drivers.interfaces import VehicleState, VelocitySetpoint
from drivers.rig.parts import Rig
from flight.config import MissionConfig
from flight.guidance import Anchor, Vec3, add, bearing, close_in, subtract
from flight.harness.fleet import TeamConfig
from flight.harness.flights import ProgramContext
from flight.harness.relay import Pointed
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, may_manoeuvre
from missions.fly.relay.drone.guidance import way_home
from missions.fly.relay.drone.life import DroneFlight
from missions.fly.relay.drone.records import write
from missions.fly.relay.drone.stages import Holder, Relief
from missions.fly.relay.ground import Ground, SentTo
from path.protocol.values import SenderRecord

_GAIN_PER_S = 0.8
_THERE_M = 0.6
_TOLD_S = 1.0
_POLL_S = 0.1
_SLACK_S = 30.0
_WAITS_S = 60.0  # for the way back to a target: a pilot may be landing there


class TeamFlight(DroneFlight):
    """A drone's program. ``run`` is the whole of it."""

    def __init__(
        self,
        rig: Rig,
        team: TeamConfig,
        ground: Ground,
        name: str,
        given: ProgramContext,
    ) -> None:
        super().__init__(rig, team, ground, name, given)
        self._team = team
        sent = ground.sent_to(name)
        assert sent is not None, f"{name} was sent to no target"
        self._mission = mission_on(self._mission, sent)
        self._pointed: Pointed | None = None
        self._told_s = self._asked_s = -_TOLD_S
        self._has_turned = False
        self.entry_m = team.entry_m

    # --- where the target is ---

    def designated(self) -> Vec3:
        """A person goes on pointing at it until this drone has it."""
        now_s = asyncio.get_running_loop().time()
        if self._pointed is None or now_s - self._pointed.time_s > _TOLD_S:
            self._pointed = self._base.pointed_at(self._name)
            assert self._pointed is not None, "nobody points in a relay"
        north, east, _ = add(self._pointed.at(now_s), self.off_n_m)
        return north, east, self.off_n_m[2] - self._mission.target.height_m

    def _tell_place(self, holder: Holder) -> None:
        now_s = asyncio.get_running_loop().time()
        if holder.track is not None and now_s - self._told_s >= _TOLD_S:
            self._told_s = now_s
            self._base.follows(self._name, subtract(holder.track.position_n_m, self.off_n_m))

    async def _give_up(
        self,
        session: RoleSession,
        flown: Holder | Relief,
        end: MissionEnd,
    ) -> None:
        """Give up what this drone was responsible for, by its record too: the target will be found
        anew.
        """
        if flown.has_given_away or not session.responsible:
            return
        kept = self._store.load()
        await write(self._store, SenderRecord(0 if kept is None else kept.record.epoch))
        session.set_claim(None)
        session.say("gives the target up: it is to be pointed at again")
        self._base.gave_up(self._name, str(end))

    # --- over the ways of the team ---

    async def go_out(self, session: RoleSession, place: Callable[[], Vec3]) -> None:
        """Up above its home, across at the height of those that go out, and down."""
        pilot = session.pilot
        vehicle = session.vehicle
        team = self._team
        north, east, _ = vehicle.state.position_n_m
        up = Anchor(
            (north, east, -team.out_height_m),
            bearing(subtract(place(), vehicle.state.position_n_m)),
        )
        await self._within(session, _SLACK_S, lambda: up.position_n_m, team.transit_mps)

        def above() -> Vec3:
            n, e, _ = place()
            return n, e, -team.out_height_m

        away_m = math.dist(above(), vehicle.state.position_n_m)
        await self._within(
            session,
            _SLACK_S + 2.0 * away_m / team.transit_mps,
            above,
            team.transit_mps,
        )
        await self._within(session, _SLACK_S, place, team.transit_mps)
        pilot.hold_here()

    async def _within(
        self,
        session: RoleSession,
        within_s: float,
        place: Callable[[], Vec3],
        speed_mps: float,
    ) -> None:
        """To a place that may move. Raises MissionEnd(APPROACH_FAILED) when it was not reached in
        time.
        """
        yaw_rad = bearing(subtract(place(), session.vehicle.state.position_n_m))

        def guidance(state: VehicleState) -> VelocitySetpoint:
            error = session.fence.towards(place(), state.position_n_m)
            return VelocitySetpoint(
                close_in(error, (0.0, 0.0, 0.0), _GAIN_PER_S, speed_mps), yaw_rad
            )

        session.pilot.guidance = guidance
        loop = asyncio.get_running_loop()
        end_s = loop.time() + within_s
        while math.dist(place(), session.vehicle.state.position_n_m) > _THERE_M:
            if loop.time() > end_s:
                raise MissionEnd(
                    Outcome.APPROACH_FAILED,
                    f"a place on its way was not reached in {within_s:.0f} s",
                )
            await asyncio.sleep(_POLL_S)

    async def come_home(
        self,
        session: RoleSession,
        end: MissionEnd | None,
        aside: Anchor,
    ) -> bool:
        """Out of the others' way, up, home above everything, and down; where that cannot be flown,
        down.
        """
        *climb, home = way_home(aside, self.above_home(self._team.return_height_m))
        if may_manoeuvre(session, end):
            session.enter(Phase.DEPART, "on its way home")
        for anchor in climb:
            if may_manoeuvre(session, end):
                await self._fly_to(session, anchor, self._team.transit_mps)
        while may_manoeuvre(session, end):
            await self._fly_to(
                session,
                home,
                self._team.transit_mps,
                until=lambda: self._is_wanted(session),
            )
            if not self._is_wanted(session):
                break
            if await self._may_turn_back(session):
                self.turning_back = True
                return False
        return await bring_down(session, end, home)

    def _is_wanted(self, session: RoleSession) -> bool:
        """Return whether it is to find its target again, on its way home; once in a flight."""
        if self._has_turned or session.responsible:
            return False
        now_s = asyncio.get_running_loop().time()
        if now_s - self._asked_s >= _TOLD_S:
            self._asked_s = now_s
            self._gauge.note(now_s, session.vehicle.state.battery)
            self._base.may_find(self._name, self._gauge.left_s - self._team.home_s)
        return self._base.turned_back(self._name) != "no"

    async def _may_turn_back(self, session: RoleSession) -> bool:
        """Waits, high above, until its way is free; False when that took too long."""
        self._has_turned = True
        session.say("turns back: nobody has its target")
        session.pilot.hold_here()
        loop = asyncio.get_running_loop()
        end_s = loop.time() + _WAITS_S
        while (answer := self._base.turned_back(self._name)) == "wait":
            if not session.pilot.in_control or loop.time() > end_s:
                break
            await asyncio.sleep(_POLL_S)
        if answer == "go" and session.pilot.in_control:
            return True
        self._base.may_find(self._name, 0.0)
        return False


def mission_on(mission: MissionConfig, sent: SentTo) -> MissionConfig:
    """The rig's mission on one of the targets."""
    north, east, _ = sent.place_n_m
    designation = replace(mission.target, north_m=north, east_m=east)
    return replace(
        mission,
        target=designation,
        target_id=sent.target + 1,
        heading_deg=sent.heading_deg,
    )
