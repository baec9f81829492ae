"""The role's side of its guard, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, field
from typing import Any, Self

import pytest

from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Hand, Script
from flight.guard.rules import GuardRules
from flight.guard.under_guard import UnderGuard
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from tests.doubles import LoopClock

RULES = GuardRules()
BEAT = Beat(Script.CLIMB, 0)
WATCHED = GuardAnswer(True, Hand.SCRIPT)


@dataclass
class FakeLine:
    name: str = "127.0.0.1:1"
    newest: tuple[int, GuardAnswer] | None = None
    beats: list[Beat] = field(default_factory=list[Beat])
    reply: GuardAnswer | None = None

    def beat(self, beat: Beat) -> None:
        self.beats.append(beat)
        if self.reply is not None:
            asyncio.get_running_loop().call_later(0.02, self.say, self.reply)

    def say(self, answer: GuardAnswer) -> None:
        self.newest = LoopClock(1000.0).now_ns(), answer

    def answer(self) -> tuple[int, GuardAnswer] | None:
        return self.newest

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def ended(check: Any) -> MissionEnd:
    with pytest.raises(MissionEnd) as caught:
        check()
    return caught.value


def test_who_is_watched_flies() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        assert not guard.watching
        assert ended(guard.check).outcome is Outcome.GUARD_LOST
        line.say(GuardAnswer(False, Hand.FREE))
        assert not guard.watching
        assert "does not see" in ended(guard.check).detail
        line.say(WATCHED)
        assert guard.watching
        guard.check()

    virtual(main())


def test_a_guard_that_falls_silent_is_missed_in_time() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        for _ in range(round(RULES.answer_age_s / 0.05)):
            guard.check()
            await asyncio.sleep(0.05)
        await asyncio.sleep(0.05)
        end = ended(guard.check)
        assert end.outcome is Outcome.GUARD_LOST
        assert line.name in end.detail
        guard.check_hand()  # which the control loop asks: it flies on until the course ends

    virtual(main())


def test_what_was_not_heard_while_this_program_slept_is_not_held_against_the_guard() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        guard.check()
        await asyncio.sleep(30.0)
        guard.check()

    virtual(main())


def test_a_program_that_looks_rarely_but_did_not_sleep_misses_a_silent_guard_too() -> None:
    """What excuses a guard's silence is a sleep of half as long as it may be silent, not less."""

    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        for _ in range(3):
            guard.check()
            await asyncio.sleep(0.4 * RULES.answer_age_s)
        assert ended(guard.check).outcome is Outcome.GUARD_LOST

    virtual(main())


def test_what_the_guard_took_stays_taken() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(GuardAnswer(True, Hand.GUARD, "no setpoint for 0.5 s"))
        for answer in (None, GuardAnswer(True, Hand.FREE), WATCHED):
            end = ended(guard.check_hand)
            assert end.outcome is Outcome.GUARD
            assert "no setpoint" in end.detail
            if answer:
                line.say(answer)
        assert guard.taken == "no setpoint for 0.5 s"

    virtual(main())


def test_a_pilot_s_hand_is_told_too() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(GuardAnswer(True, Hand.OTHER, "a pilot changed the mode"))
        assert ended(guard.check_hand).outcome is Outcome.PILOT_OVERRIDE
        assert not guard.taken

    virtual(main())


def test_before_anything_moves_the_guard_is_asked_anew() -> None:
    async def main() -> None:
        line, loop = FakeLine(), asyncio.get_running_loop()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        await asyncio.sleep(20.0)  # the answer that is there says nothing any more
        line.reply = GuardAnswer(True, Hand.GUARD, "no sign of life")
        begun_s = loop.time()
        with pytest.raises(MissionEnd, match="no sign of life"):
            await guard.confirm(BEAT)
        assert 0.015 < loop.time() - begun_s < 0.1
        assert line.beats == [BEAT]

    virtual(main())


def test_a_guard_that_does_not_answer_keeps_everything_on_the_ground() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        await asyncio.sleep(0.1)
        with pytest.raises(MissionEnd) as caught:
            await guard.confirm(BEAT)
        assert caught.value.outcome is Outcome.GUARD_LOST

    virtual(main())


def test_an_answer_of_the_very_moment_of_the_question_is_none_to_it() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        line.say(WATCHED)
        with pytest.raises(MissionEnd, match="does not answer"):
            await guard.confirm(BEAT)

    virtual(main())


def test_a_vehicle_that_refuses_because_the_guard_has_it_is_the_guard_s_doing() -> None:
    async def main() -> None:
        line = FakeLine()
        guard = UnderGuard(line, LoopClock(1000.0), RULES)
        refused, lost = (
            MissionEnd(Outcome.VEHICLE_REFUSED, "denied"),
            MissionEnd(Outcome.PEER_LOST, "silent"),
        )
        assert guard.behind(refused) is refused
        line.say(GuardAnswer(True, Hand.GUARD, "no sign of life"))
        assert guard.behind(refused).outcome is Outcome.GUARD
        assert guard.behind(lost) is lost

    virtual(main())
