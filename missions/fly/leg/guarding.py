"""A role's words with the guard beside it: a beat for everything it does with the vehicle, and its
consent.
"""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING

from drivers.mavlink.guard.interfaces import NOWHERE, Beat, Script
from flight.guard.under_guard import UnderGuard
from flight.outcome import MissionEnd

if TYPE_CHECKING:
    from missions.fly.leg.session import RoleSession

_BEAT_PERIOD_S = 0.05
_PEER_PLACE_S = 1.0  # where the other drone was longer ago is not where it is


class Guarding:
    """The guard as one session tells it and asks it.

    Attributes:
        guard: the process beside this program; None where there is none.
        script: what the script does with the vehicle while it does not fly it by setpoints.
    """

    def __init__(self, session: RoleSession, guard: UnderGuard | None) -> None:
        self._session = session
        self.guard = guard
        self.script = Script.IDLE
        self._measured_m = math.nan

    def note_separation(self, distance_m: float) -> None:
        """Between the two bodies, as it was just measured; it is told with the next beat."""
        self._measured_m = distance_m

    def set_script(self, script: Script) -> None:
        """Set what the script is about to do with the vehicle; the guard knows it before the
        vehicle does.
        """
        self.script = script
        if self.guard is not None:
            self.guard.beat(self.beat())

    def beat(self) -> Beat:
        """Return what the guard is told; a measured distance once."""
        session = self._session
        script = self.script
        if session.pilot.override:
            script = Script.LET_GO
        elif session.pilot.in_control:
            script = Script.CONTROL
        measured_m = self._measured_m
        self._measured_m = math.nan
        near = session.peer is not None and session.peer_silence_s() < _PEER_PLACE_S
        place = NOWHERE
        if session.peer is not None and near:
            # The guard knows this drone's place from the autopilot alone, with all that its
            # estimator stepped by.
            place = session.vehicle.as_reported(session.here(session.peer).position_n_m)
        return Beat(script, session.pilot.setpoints, measured_m, place)

    async def confirm(self) -> None:
        """Ask the guard before a command that moves the vehicle.

        Raises MissionEnd when the guard has it, or there is none.
        """
        if self.guard is not None:
            await self.guard.confirm(self.beat())

    async def keep(self) -> None:
        """Beat for ever. The course ends when the guard took the flying vehicle from the script, or
        is gone.
        """
        alarm = ""
        while self.guard is not None:
            beat = self.beat()
            self.guard.beat(beat)
            answer = self.guard.look()
            if answer is not None and answer.alarm not in ("", alarm):
                alarm = answer.alarm
                self._session.say(f"ALARM: the guard ignores {alarm}")
            try:
                if beat.script in (Script.CLIMB, Script.CONTROL):
                    self.guard.check()
            except MissionEnd as end:
                if not self._session.ended.done():
                    self._session.ended.set_result(end)
            await asyncio.sleep(_BEAT_PERIOD_S)
