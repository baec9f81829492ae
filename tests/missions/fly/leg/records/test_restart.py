"""A role's program is killed and started again: what was written down decides."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any, cast

import pytest

from drivers.interfaces import Kept
from drivers.log.state_file import MemoryStore
from flight.outcome import MissionEnd, Outcome
from missions.fly.leg.handover import ReceiverHandover, SenderHandover, protocol_config
from path.messages import Accept, Confirm, Role, Status
from path.protocol.receiver import LetGo
from tests.missions.fly.leg.handover_pair import Pair, fly, killed, kinds, started, until

NS = 1_000_000_000


@pytest.mark.parametrize("down_s", [0.05, 0.4, 3.0])
def test_a_sender_killed_after_its_commit_takes_back_what_nobody_accepted(
    rig: Any, down_s: float
) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await killed(pair, Role.SENDER)
        await asyncio.sleep(down_s)
        sender = started(pair, rig, Role.SENDER, flying=True)
        assert not pair.session[Role.SENDER].responsible
        with pytest.raises(MissionEnd) as caught:
            await sender.resume()
        assert caught.value.outcome is Outcome.RESTARTED
        assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}

    fly(rig, course)


def test_a_sender_killed_after_the_accept_confirms_it_when_it_is_back(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Confirm)
        pair.sender.agreed(1)
        await until(lambda: pair.sender.handed_over)
        await killed(pair, Role.SENDER)
        await asyncio.sleep(0.3)
        pair.link[Role.SENDER].lost = lambda _: False
        sender = started(pair, rig, Role.SENDER, flying=True)
        with pytest.raises(MissionEnd, match="handed_over"):
            await sender.resume()

    pair = fly(rig, course)
    assert pair.receiver.holds_for_good
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}
    assert pair.log[Role.SENDER].of("/settled")[-1]["outcome"] == "handed_over"


@pytest.mark.parametrize("down_s", [0.05, 3.0])
def test_a_receiver_killed_within_its_lease_holds_on_or_lets_go(rig: Any, down_s: float) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        await killed(pair, Role.RECEIVER)
        pair.link[Role.RECEIVER].lost = lambda _: False
        await asyncio.sleep(down_s)
        receiver = started(pair, rig, Role.RECEIVER, flying=True)
        assert pair.session[Role.RECEIVER].responsible == (down_s < 1.0)
        told = pair.log[Role.RECEIVER].of("/epoch")[-1]["duty"]  # what it is now, not what it was
        assert told == ("provisional" if down_s < 1.0 else "let_go")
        with pytest.raises(MissionEnd) as caught:
            await receiver.resume()
        assert caught.value.outcome is Outcome.RESTARTED
        handed_over = down_s < 1.0
        assert pair.responsible() == {Role.SENDER: not handed_over, Role.RECEIVER: handed_over}
        assert pair.receiver.holds_for_good == handed_over

    fly(rig, course)


def test_a_receiver_killed_while_it_holds_still_does_and_says_so(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await killed(pair, Role.RECEIVER)
        await asyncio.sleep(5.0)
        started(pair, rig, Role.RECEIVER, flying=True)
        await asyncio.sleep(0.5)
        (said,) = {
            cast(Status, m).responsible for m in kinds(pair.link[Role.RECEIVER].sent[-5:], Status)
        }
        assert said and pair.receiver.holds_for_good

    fly(rig, course)


def test_on_the_ground_a_new_mission_begins_with_the_next_epoch(rig: Any) -> None:
    """Whichever program is started first: a sender waits for the receiver to have let go of the old
    target.
    """

    async def course(pair: Pair) -> None:
        await pair.decide()
        for role in Role:
            await killed(pair, role)
        sender = cast(SenderHandover, started(pair, rig, Role.SENDER, flying=False))
        await sender.resume()
        free = asyncio.create_task(sender.until_free())
        receiver = started(pair, rig, Role.RECEIVER, flying=False)
        await asyncio.sleep(0.5)
        assert pair.receiver.holds_for_good and not free.done()
        await receiver.resume()
        await free
        await until(lambda: all(session.alignment.ready for session in pair.session.values()))
        assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: False}
        await sender.offer()
        pair.receiver.start()
        pair.session[Role.SENDER].spawn(pair.offer_targets())
        await asyncio.sleep(0.5)
        assert sender.epoch == 2
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    fly(rig, course)


def test_a_sender_does_not_begin_anew_while_the_receiver_holds(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await killed(pair, Role.SENDER)
        sender = cast(SenderHandover, started(pair, rig, Role.SENDER, flying=False))
        await sender.resume()
        with pytest.raises(MissionEnd, match="did not let go") as caught:
            await sender.until_free()
        assert caught.value.outcome is Outcome.PEER_ABORTED
        assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}

    fly(rig, course)


def test_what_the_receiver_said_before_it_was_given_the_target_is_no_word_of_its_being_free(
    rig: Any,
) -> None:
    """A sender killed after its COMMIT, started on the ground, hands over by its record and begins
    anew at once.
    """

    async def course(pair: Pair) -> None:
        session = pair.session[Role.SENDER]
        status = next(m for m in reversed(pair.link[Role.RECEIVER].sent) if isinstance(m, Status))
        assert not status.responsible
        old_ns = session.alignment.to_own_ns(status.stamp_ns)
        handover = pair.sender
        handover.begin_anew()
        handover.on_status(status)
        assert not handover.peer_is_free and old_ns < session.now_ns()
        handover.on_status(replace(status, stamp_ns=status.stamp_ns + 10**9))
        assert handover.peer_is_free
        handover.on_status(replace(status, stamp_ns=status.stamp_ns + 2 * 10**9, responsible=True))
        assert not handover.peer_is_free

    fly(rig, course)


def test_after_a_reboot_a_lease_is_over_for_the_receiver_and_begins_anew_for_the_sender(
    rig: Any,
) -> None:
    """The boot's change reaches the machines: instants of another clock are no instants."""

    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        kept = {role: cast(Kept, pair.store[role].load()).record for role in Role}
        session = pair.session[Role.RECEIVER]
        again = ReceiverHandover(
            session, MemoryStore(Kept(kept[Role.RECEIVER], same_clock=False)), lambda: True
        )
        assert isinstance(again.state, LetGo) and not again.holds and not session.responsible
        sender = pair.session[Role.SENDER]
        whole = SenderHandover(sender, MemoryStore(Kept(kept[Role.SENDER], same_clock=False)))
        config = protocol_config(sender)
        longest_ns = round((config.lease_s + config.max_uncertainty_s) * 1e9)
        assert whole.state.take_back_ns == sender.now_ns() + longest_ns

    fly(rig, course)
