"""Two drones with the receiver's role and the pair's key on one broadcast channel: never do both
hold the target.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, cast

from drivers.log.state_file import MemoryStore
from flight.outcome import Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.handover import ReceiverHandover
from missions.fly.leg.session import RoleSession
from path.messages import Accept, Commit, Message, Role, Status
from path.protocol.receiver import Holding, Observing
from tests.missions.fly.leg.handover_pair import (
    CONFIG,
    FakeLink,
    FakeVehicle,
    OffsetClock,
    Pair,
    Recorder,
    kinds,
    until,
)


class Ether:
    """The ether in which the sender's words reach both receivers."""

    def __init__(self, *ends: FakeLink) -> None:
        self.ends = ends

    def arrive(self, message: Message) -> None:
        for end in self.ends:
            end.arrive(message)


class Trio(Pair):
    """A pair, and a second receiver on the same channel, whose clock agrees with the first
    one's.
    """

    def __init__(self, rig: Any) -> None:
        super().__init__(rig)
        first, sender = self.link[Role.RECEIVER], self.link[Role.SENDER]
        self.second_link = FakeLink(OffsetClock(first.clock.offset_s), other=sender)
        sender.other = cast(FakeLink, Ether(first, self.second_link))
        parts = cast(Any, (self.second_link.clock, FakeVehicle(), None, self.second_link))
        self.second_log = Recorder()
        session = RoleSession(
            rig,
            Role.RECEIVER,
            CONFIG,
            self.second_log,
            lambda _: None,
            asyncio.Event(),
            parts,
            random.Random("second"),
        )
        self.second_session = session
        self.second = ReceiverHandover(session, MemoryStore(), lambda: True)
        session.on_message, session.on_status = self.second.on_message, self.second.on_status

    def begin_second(self) -> None:
        session = self.second_session
        session.spawn(session.pump())
        session.spawn(session.report())
        self.second.start()

    def both_hold(self) -> bool:
        return self.receiver.holds and self.second.holds

    async def watch(self, until_s: float) -> None:
        loop = asyncio.get_running_loop()
        while loop.time() < until_s:
            assert not self.both_hold(), "two receivers hold the target"
            await asyncio.sleep(0.005)


def fly_trio(rig: Any, course: Callable[[Trio], Coroutine[Any, Any, None]]) -> Trio:
    async def main() -> Trio:
        trio = Trio(rig)
        await trio.begin()
        await course(trio)
        await trio.end()
        await trio.second_session.cancel_spawned()
        return trio

    return cast(Trio, run_virtual(main()))


def test_instances_differ_and_are_said(rig: Any) -> None:
    async def course(trio: Trio) -> None:
        trio.begin_second()
        await until(lambda: len(trio.sender.receivers) == 2)
        said = {
            cast(Status, kinds(link.sent, Status)[-1]).instance
            for link in (trio.link[Role.RECEIVER], trio.second_link)
        }
        assert said == set(trio.sender.receivers) == {trio.receiver.instance, trio.second.instance}
        assert 0 not in said and len(said) == 2

    fly_trio(rig, course)


def test_with_two_receivers_on_the_channel_there_is_no_commit_and_the_crew_is_told_why(
    rig: Any,
) -> None:
    async def course(trio: Trio) -> None:
        trio.begin_second()
        await until(lambda: len(trio.sender.receivers) == 2)
        for _ in range(3):
            trio.sender.agreed(1)
        assert not trio.sender.released
        told = trio.log[Role.SENDER]
        assert [record["why"] for record in told.of("/refused")][-1] == "not_one_receiver"
        assert len([note for note in told.of("/note") if "2 receivers answer" in note["note"]]) == 1
        await trio.second_session.cancel_spawned()  # one is taken off the channel
        await until(lambda: len(trio.sender.receivers) == 1)
        assert await trio.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    fly_trio(rig, course)


def test_a_second_receiver_that_appears_at_the_commit_takes_nothing(rig: Any) -> None:
    """It has seen Targets and hears COMMIT and CONFIRM, and would be able; the sender has not heard
    of it yet.
    """

    async def course(trio: Trio) -> None:
        trio.second_link.lost = lambda message: isinstance(message, Status)
        trio.begin_second()
        await until(lambda: trio.second.live is not None and trio.second_session.alignment.ready)
        trio.sender.agreed(1)
        loop = asyncio.get_running_loop()
        watch = asyncio.create_task(trio.watch(loop.time() + 4.0))
        assert await trio.decide(agree=False) == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }
        await watch
        assert isinstance(trio.receiver.state, Holding) and isinstance(trio.second.state, Observing)
        assert not kinds(trio.second_link.sent, Accept)
        assert "wrong_instance" in [record["why"] for record in trio.second_log.of("/refused")]

    fly_trio(rig, course)


def test_what_the_second_one_says_does_not_settle_the_first_ones_handover(rig: Any) -> None:
    """The first accepted and was never heard again; the second says all the time that it holds
    something.
    """

    async def course(trio: Trio) -> None:
        trio.lose(Role.RECEIVER, Status, when=lambda: trio.sender.handed_over)
        trio.link[Role.SENDER].lost = lambda message: (
            trio.sender.handed_over and not isinstance(message, Commit)
        )
        trio.sender.agreed(1)
        await until(lambda: trio.sender.handed_over)
        loop, session = asyncio.get_running_loop(), trio.session[Role.SENDER]
        template = cast(Status, kinds(trio.link[Role.RECEIVER].sent, Status)[-1])
        end_s = loop.time() + 5.0
        while loop.time() < end_s:
            stamp_ns = session.now_ns() + session.alignment.offset_ns
            word = replace(
                template, stamp_ns=stamp_ns, responsible=True, instance=trio.second.instance
            )
            session.on_status(word)
            await asyncio.sleep(0.2)
        assert [record["outcome"] for record in trio.log[Role.SENDER].of("/settled")] != [
            "handed_over"
        ]

    fly_trio(rig, course)


def test_a_new_mission_waits_until_none_of_those_it_heard_holds_anything(rig: Any) -> None:
    async def course(trio: Trio) -> None:
        await trio.decide()
        trio.begin_second()
        await until(lambda: len(trio.sender.receivers) == 2)
        trio.sender.begin_anew()
        await asyncio.sleep(1.0)
        assert not trio.sender.peer_is_free  # the second one is, the first one is not

    fly_trio(rig, course)


def test_a_restarted_receiver_that_holds_keeps_its_instance_and_one_that_observes_draws_anew(
    rig: Any,
) -> None:
    async def course(trio: Trio) -> None:
        before = trio.receiver.instance
        session = trio.session[Role.RECEIVER]
        observing = ReceiverHandover(
            session, MemoryStore(trio.store[Role.RECEIVER].load()), lambda: True
        )
        assert observing.instance not in (before, 0)
        await trio.decide()
        again = ReceiverHandover(session, trio.store[Role.RECEIVER], lambda: True)
        assert again.instance == before

    fly_trio(rig, course)
