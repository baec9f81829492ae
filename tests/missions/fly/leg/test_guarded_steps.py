"""The steps of a role under guard: what it waits for, what it asks, and when it leaves the vehicle
to the guard.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import replace
from typing import Any

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Hand, Script
from flight.guard.under_guard import UnderGuard
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.steps import bring_down, preflight, take_off
from tests.doubles import LoopClock
from tests.flight.guard.test_under_guard import FakeLine
from tests.missions.fly.leg.test_steps import CONFIG, WAY_OUT, Bench

WATCHED, TAKEN = (
    GuardAnswer(True, Hand.SCRIPT),
    GuardAnswer(True, Hand.GUARD, "no setpoint for 0.5 s"),
)


class Line(FakeLine):
    """Stamps with the role's clock."""

    def say(self, answer: GuardAnswer) -> None:
        self.newest = LoopClock(1.0).now_ns(), answer


class Guarded(Bench):
    def __init__(self, rig: Any, reply: GuardAnswer | None = WATCHED) -> None:
        super().__init__(rig)
        self.line = Line(reply=reply)
        self.session.guarding.guard = UnderGuard(self.line, LoopClock(1.0), CONFIG.guard_process)
        self.session.pilot._guard = self.session.guarding.guard

    @property
    def scripts(self) -> list[Script]:
        """The scripts that the guard was told, each change once."""
        told = [beat.script for beat in self.line.beats]
        return [
            script
            for before, script in zip([None, *told], told, strict=False)
            if script is not before
        ]

    async def in_the_air(self) -> None:
        self.session.spawn(self.session.guarding.keep())
        await asyncio.sleep(0.1)  # the first answer is there, as after the preflight
        await super().in_the_air()


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def test_nothing_begins_before_the_guard_answers(rig: Any) -> None:
    async def main() -> None:
        bench, loop = Guarded(rig, None), asyncio.get_running_loop()
        bench.hear_the_peer()
        bench.align()
        with pytest.raises(MissionEnd) as caught:
            await preflight(bench.session)
        assert caught.value.outcome is Outcome.GUARD_LOST
        loop.call_later(4.0, bench.line.say, WATCHED)
        begun_s = loop.time()
        await preflight(bench.session)
        assert loop.time() - begun_s == pytest.approx(4.0, abs=0.2)

    virtual(main())


@pytest.mark.parametrize(("reply", "outcome"), [(None, Outcome.GUARD_LOST), (TAKEN, Outcome.GUARD)])
def test_nothing_is_armed_without_the_guards_word(
    rig: Any, reply: GuardAnswer | None, outcome: Outcome
) -> None:
    async def main() -> None:
        bench = Guarded(rig, reply)
        with pytest.raises(MissionEnd) as caught:
            await take_off(bench.session, 1.5)
        assert caught.value.outcome is outcome
        assert bench.vehicle.done == []

    virtual(main())


def test_a_program_that_slept_between_two_commands_does_not_send_the_second(rig: Any) -> None:
    async def main() -> None:
        bench = Guarded(rig)
        climb = asyncio.ensure_future(take_off(bench.session, 1.5))
        await asyncio.sleep(0.3)
        assert bench.vehicle.done == ["arm"]
        bench.line.reply = TAKEN  # while it armed, the program stood still
        with pytest.raises(MissionEnd) as caught:
            await climb
        assert caught.value.outcome is Outcome.GUARD
        assert bench.vehicle.done == ["arm"]

    virtual(main())


def test_the_guard_is_told_what_the_script_does(rig: Any) -> None:
    async def main() -> None:
        bench = Guarded(rig)
        await bench.in_the_air()
        assert bench.line.beats[-1].setpoints == pytest.approx(CONFIG.control_hz, abs=2)
        assert await bring_down(bench.session, None, WAY_OUT)
        await asyncio.sleep(0.2)
        await bench.session.cancel_spawned()
        assert bench.scripts == [
            Script.IDLE,
            Script.CLIMB,
            Script.CONTROL,
            Script.LANDING,
            Script.IDLE,
        ]

    virtual(main())


def test_what_the_guard_took_is_left_to_it_until_it_is_down(rig: Any) -> None:
    async def main() -> None:
        bench, loop = Guarded(rig), asyncio.get_running_loop()
        await bench.in_the_air()
        bench.line.reply = TAKEN
        end = await bench.session.ended
        assert (end.outcome, "no setpoint" in end.detail) == (Outcome.GUARD, True)
        done, flown = list(bench.vehicle.done), bench.vehicle.flown
        bench.vehicle.now = replace(bench.vehicle.now, mode=FlightMode.LAND)

        def down() -> None:
            bench.vehicle.now = replace(bench.vehicle.now, armed=False)

        loop.call_later(5.0, down)
        begun_s = loop.time()
        assert await bring_down(bench.session, end, WAY_OUT)
        assert loop.time() - begun_s == pytest.approx(5.0, abs=0.2)
        # nothing was commanded any more
        assert (bench.vehicle.done, bench.vehicle.flown) == (done, flown)
        await bench.session.cancel_spawned()

    virtual(main())


def test_without_its_guard_a_role_leaves_and_lands_by_itself(rig: Any) -> None:
    async def main() -> None:
        bench = Guarded(rig)
        await bench.in_the_air()
        bench.line.reply = None  # it died
        end = await bench.session.ended
        assert end.outcome is Outcome.GUARD_LOST
        assert bench.session.pilot.in_control
        assert await bring_down(bench.session, end, WAY_OUT)
        assert bench.log.phases[-2:] == ["depart", "land"]
        beats = len(bench.line.beats)
        await asyncio.sleep(0.5)
        assert len(bench.line.beats) > beats  # to a guard that may only be blind
        await bench.session.cancel_spawned()

    virtual(main())


def test_a_measured_distance_is_told_once(rig: Any) -> None:
    async def main() -> None:
        bench = Guarded(rig)
        bench.session.note_separation(1.2)
        first, second = bench.session.guarding.beat(), bench.session.guarding.beat()
        assert isinstance(first, Beat)
        assert first.separation_m == 1.2 and second.separation_m != second.separation_m

    virtual(main())
