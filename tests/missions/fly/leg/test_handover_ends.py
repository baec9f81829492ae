"""Deadlines of a hand-over, and its ends: what is given up, told and never decided twice."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from flight.outcome import MissionEnd, Outcome
from missions.fly.leg.handover import protocol_config
from path.messages import Abort, AbortReason, Accept, Role, Status
from tests.missions.fly.leg.handover_pair import CONFIG, NO_END, Pair, fly, kinds


def test_without_agreement_the_deadline_ends_it(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        start_s = asyncio.get_running_loop().time()
        with pytest.raises(MissionEnd) as caught:
            await pair.sender.until_decided(6.0, pair.verify_again)
        assert caught.value.outcome is Outcome.NO_AGREEMENT
        assert asyncio.get_running_loop().time() - start_s == pytest.approx(6.0, abs=0.5)
        pair.sender.end(caught.value)
        with pytest.raises(MissionEnd) as peer:
            await pair.receiver.until_held(6.0)
        assert peer.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    (abort,) = kinds(pair.link[Role.SENDER].sent, Abort)
    assert isinstance(abort, Abort)
    assert abort.reason is AbortReason.TIMEOUT


def test_a_commit_under_way_at_the_deadline_is_decided_by_its_lease(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        async def agree_late() -> None:
            await asyncio.sleep(2.9)
            pair.lose(
                Role.RECEIVER,
                Accept,
                when=lambda: asyncio.get_running_loop().time() < deadline_s + 0.5,
            )
            pair.sender.agreed(1)

        deadline_s = asyncio.get_running_loop().time() + 3.0
        late = asyncio.create_task(agree_late())
        assert await pair.decide(timeout_s=3.0, agree=False) == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }
        await late

    fly(rig, course)


@pytest.mark.parametrize("quitter", Role)
def test_who_gives_up_before_the_commit_tells_the_other_why(rig: Any, quitter: Role) -> None:
    async def course(pair: Pair) -> None:
        (pair.sender if quitter is Role.SENDER else pair.receiver).end(NO_END)
        stays = (
            pair.receiver.until_held(5.0)
            if quitter is Role.SENDER
            else pair.sender.until_decided(5.0, lambda: None)
        )
        with pytest.raises(MissionEnd) as caught:
            await stays
        assert caught.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    reasons = [
        abort.reason for abort in kinds(pair.link[quitter].sent, Abort) if isinstance(abort, Abort)
    ]
    assert reasons[0] is AbortReason.TARGET_LOST
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}


def test_what_was_handed_over_is_not_given_up_by_a_later_end(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        before = {role: len(kinds(pair.link[role].sent, Abort)) for role in Role}
        pair.sender.end(NO_END)
        pair.receiver.end(NO_END)
        await asyncio.sleep(1.0)
        assert {role: len(kinds(pair.link[role].sent, Abort)) for role in Role} == before

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


def test_a_mission_that_ends_well_gives_nothing_up(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.sender.end(None)
        pair.receiver.end(None)
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    fly(rig, course)


def test_a_receiver_that_gives_up_what_it_holds_provisionally_orphans_nothing_it_was_not_given(
    rig: Any,
) -> None:
    """Its ACCEPTs are lost, it ends: the sender takes back at the lease's end, and knows that it
    was no time-out.
    """

    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await asyncio.sleep(0.2)
        assert pair.receiver.holds and not pair.receiver.holds_for_good
        pair.receiver.end(NO_END)
        assert not pair.receiver.holds
        with pytest.raises(MissionEnd) as caught:
            await pair.sender.until_decided(5.0, pair.verify_again)
        assert caught.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert pair.verified_again == []


def test_a_receiver_that_does_not_see_the_target_refuses_it(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        outcomes = await pair.decide(timeout_s=3.0)
        assert outcomes[Role.SENDER] is Outcome.NO_AGREEMENT

    pair = fly(rig, course, able=False)
    assert "not_able" in [record["why"] for record in pair.log[Role.RECEIVER].of("/refused")]
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert not kinds(pair.link[Role.RECEIVER].sent, Accept)


def test_the_protocol_does_not_end_a_handoff_before_the_mission_does(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        config = protocol_config(pair.session[Role.SENDER])
        deadlines = CONFIG.deadlines
        assert config.offer_s >= deadlines.receiver_ready_s + deadlines.verify_s
        assert config.handoff_s >= config.offer_s + deadlines.verify_s

    fly(rig, course)


def test_a_status_says_who_is_responsible(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await asyncio.sleep(0.5)

    pair = fly(rig, course)
    newest = {role: kinds(pair.link[role].sent, Status)[-1] for role in Role}
    assert [cast(Status, newest[role]).responsible for role in Role] == [False, True]
