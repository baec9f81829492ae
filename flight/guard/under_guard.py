"""The role's side of its guard: it beats, hears who has the vehicle, and flies only while it is
watched.
"""

from __future__ import annotations

import asyncio

from drivers.interfaces import Clock
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, GuardLine, Hand
from flight.guard.rules import GuardRules
from flight.outcome import MissionEnd, Outcome

_POLL_S = 0.01
_BY_A_VEHICLE = (Outcome.VEHICLE_REFUSED, Outcome.VEHICLE_LOST)


class UnderGuard:
    """``taken``: the guard has the vehicle, until it is disarmed; nothing may be commanded any
    more.
    """

    def __init__(
        self,
        line: GuardLine,
        clock: Clock,
        rules: GuardRules,
    ) -> None:
        self._line = line
        self._clock = clock
        self._rules = rules
        self._checked_ns = clock.now_ns()
        # nothing can have been heard while this program did not run
        self._since_ns = self._checked_ns
        self.taken = ""  # why, once it is

    @property
    def watching(self) -> bool:
        """The guard answers, and sees the vehicle."""
        return not self._missing(self._newest())

    def beat(self, beat: Beat) -> None:
        self._line.beat(beat)

    def look(self) -> GuardAnswer | None:
        """Take what the guard said; the newest of it."""
        answer = self._newest()
        if answer is not None and answer.hand is Hand.GUARD and not self.taken:
            self.taken = answer.reason
        return answer

    def behind(self, end: MissionEnd) -> MissionEnd:
        """Return the cause behind a mission's end.

        A vehicle that the guard took refuses, or is not heard by who stood still.
        """
        self.look()
        if self.taken and end.outcome in _BY_A_VEHICLE:
            return MissionEnd(Outcome.GUARD, f"the guard took the vehicle: {self.taken}")
        return end

    def check_hand(self) -> None:
        """Raise MissionEnd when the vehicle is not the script's any more."""
        answer = self.look()
        if self.taken:
            raise MissionEnd(Outcome.GUARD, f"the guard took the vehicle: {self.taken}")
        if answer is not None and answer.hand is Hand.OTHER:
            raise MissionEnd(Outcome.PILOT_OVERRIDE, answer.reason)

    def check(self) -> None:
        """Raise MissionEnd when the vehicle is not the script's any more, or nobody watches it."""
        self.check_hand()
        missing = self._missing(self._newest())
        if missing:
            raise MissionEnd(Outcome.GUARD_LOST, missing)

    async def confirm(self, beat: Beat) -> None:
        """Ask the guard before anything moves, and wait for an answer that is younger than the
        question.

        A program that slept does not go on where it was: what happened meanwhile is in that answer.
        Raises MissionEnd.
        """
        asked_ns = self._clock.now_ns()
        end_s = asyncio.get_running_loop().time() + self._rules.answer_age_s
        self._line.beat(beat)
        while (newest := self._line.answer()) is None or newest[0] <= asked_ns:
            if asyncio.get_running_loop().time() > end_s:
                raise MissionEnd(
                    Outcome.GUARD_LOST, f"the guard does not answer at {self._line.name}"
                )
            await asyncio.sleep(_POLL_S)
        self.check()

    def _newest(self) -> GuardAnswer | None:
        now_ns = self._clock.now_ns()
        if (now_ns - self._checked_ns) * 1e-9 > 0.5 * self._rules.answer_age_s:
            self._since_ns = now_ns
        self._checked_ns = now_ns
        newest = self._line.answer()
        if newest is None:
            return None
        self._since_ns = max(self._since_ns, newest[0])
        return newest[1]

    def _missing(self, answer: GuardAnswer | None) -> str:
        silent_s = (self._clock.now_ns() - self._since_ns) * 1e-9
        if answer is None or silent_s > self._rules.answer_age_s:
            return f"the guard does not answer at {self._line.name}"
        return "" if answer.sees else "the guard does not see the vehicle on its own link"
