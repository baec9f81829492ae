"""Both sides of the hand-over on a link that loses what a test wants lost, in virtual time."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest

from flight.outcome import MissionEnd, Outcome
from path.messages import Accept, Commit, Confirm, Role
from tests.missions.fly.leg.handover_pair import Pair, fly, kinds, until

RECEIVER_AHEAD_NS = 3_200_000_000  # of the sender's clock


# --- the good path


def test_commit_accept_confirm_hands_the_target_over(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}
    assert pair.sender.handed_over and pair.sender.released
    assert pair.receiver.holds and pair.receiver.holds_for_good
    assert pair.verified_again == []
    sender, receiver = pair.log[Role.SENDER], pair.log[Role.RECEIVER]
    assert [r["responsible"] for r in sender.of("/responsibility")] == [True, False]
    provisional, for_good = receiver.of("/responsibility")
    assert (
        provisional["responsible"]
        and provisional["until_ns"] < commit_of(pair).lease_end_ns + RECEIVER_AHEAD_NS
    )
    assert for_good == {"responsible": True, "until_ns": None}
    assert [r["outcome"] for r in sender.of("/decision")] == ["handed_over"]
    assert [r["outcome"] for r in sender.of("/settled")] == ["handed_over"]
    assert [r["outcome"] for r in receiver.of("/decision")] == ["handed_over"]


def test_the_release_is_written_before_the_commit_is_sent(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        sent_before = len(kinds(pair.link[Role.SENDER].sent, Commit))
        pair.sender.agreed(1)
        assert (sent_before, len(kinds(pair.link[Role.SENDER].sent, Commit))) == (0, 1)

    pair = fly(rig, course)
    topics = [
        topic
        for _, topic, _ in pair.log[Role.SENDER].entries
        if topic in ("/epoch", "/responsibility", "/commit")
    ]
    assert topics[-3:] == ["/epoch", "/responsibility", "/commit"]
    assert pair.log[Role.SENDER].of("/epoch")[-1] == {"epoch": 1, "duty": "released"}
    (commit,) = pair.log[Role.SENDER].of("/commit")
    (sent,) = kinds(pair.link[Role.SENDER].sent, Commit)
    assert isinstance(sent, Commit)
    assert commit == {
        "target_id": 1,
        "epoch": 1,
        "nonce": sent.nonce,
        "lease_end_ns": sent.lease_end_ns,
    }


def test_agreeing_frame_after_frame_is_one_commit(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Commit, when=lambda: asyncio.get_running_loop().time() < 1.0)
        for _ in range(5):
            pair.sender.agreed(1)
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    commits = kinds(fly(rig, course).link[Role.SENDER].sent, Commit)
    assert len({commit.nonce for commit in commits if isinstance(commit, Commit)}) == 1


def test_an_attempt_taken_back_before_anybody_waited_is_verified_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await asyncio.sleep(4.0)
        assert await pair.decide(agree=False, timeout_s=2.0) == {
            Role.SENDER: Outcome.NO_AGREEMENT,
            Role.RECEIVER: Outcome.NO_AGREEMENT,
        }

    assert fly(rig, course).verified_again == [2]


@pytest.mark.parametrize("delay_s", [0.1, 0.15, 0.3])
def test_a_slow_link_hands_over_when_the_rig_says_how_slow_it_is(rig: Any, delay_s: float) -> None:
    async def course(pair: Pair) -> None:
        ends = await pair.decide()
        assert set(ends.values()) == {Outcome.COMMITTED}

    fly(rig, course, delay_s=delay_s, clocks_s=1.5 * delay_s)


def test_boxes_that_agree_while_the_clocks_are_unknown_end_as_a_clock_fault(rig: Any) -> None:
    said: list[str] = []

    async def course(pair: Pair) -> None:
        session = pair.session[Role.SENDER]
        session.alignment.reset()
        pair.cut()
        pair.sender.agreed(1)
        with pytest.raises(MissionEnd) as end:
            await pair.sender.until_decided(3.0, pair.verify_again)
        assert end.value.outcome is Outcome.CLOCK_FAULT
        said.append(str(end.value))

    fly(rig, course)
    assert "the boxes agree" in said[0]
    assert "clock_uncertainty_s" in said[0]


# --- what a link may lose


def test_a_lost_accept_is_taken_back_and_verified_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept, when=lambda: pair.sender.epoch == 1)
        agree = asyncio.create_task(agree_again(pair))
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }
        agree.cancel()

    pair = fly(rig, course)
    assert pair.verified_again == [2]
    assert [r["outcome"] for r in pair.log[Role.SENDER].of("/decision")] == [
        "taken_back",
        "handed_over",
    ]
    assert [r["outcome"] for r in pair.log[Role.RECEIVER].of("/decision")] == [
        "let_go",
        "handed_over",
    ]
    assert [r["epoch"] for r in pair.log[Role.SENDER].of("/commit")][-1] == 2
    nonces = {commit["epoch"]: commit["nonce"] for commit in pair.log[Role.SENDER].of("/commit")}
    assert nonces[1] != nonces[2]
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


def commit_of(pair: Pair) -> Commit:
    commit = kinds(pair.link[Role.SENDER].sent, Commit)[0]
    assert isinstance(commit, Commit)
    return commit


async def agree_again(pair: Pair) -> None:
    await until(lambda: bool(pair.verified_again))
    await asyncio.sleep(0.5)
    pair.sender.agreed(1)


def test_a_lost_confirm_is_asked_for_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        start_s = asyncio.get_running_loop().time()
        pair.lose(
            Role.SENDER, Confirm, when=lambda: asyncio.get_running_loop().time() < start_s + 0.4
        )
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    pair = fly(rig, course)
    assert len(kinds(pair.link[Role.RECEIVER].sent, Accept)) > 3
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


def test_without_any_confirm_nobody_holds_and_both_say_so(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Confirm)
        assert await pair.decide() == {
            Role.SENDER: Outcome.ORPHANED,
            Role.RECEIVER: Outcome.ORPHANED,
        }

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: False}
    assert pair.verified_again == []  # what was accepted is never taken back


def test_a_link_that_dies_after_the_accept_orphans(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.link[Role.SENDER].lost = lambda message: (
            isinstance(message, Confirm) or pair.sender.handed_over
        )
        pair.link[Role.RECEIVER].lost = lambda _: pair.sender.handed_over
        assert await pair.decide() == {
            Role.SENDER: Outcome.ORPHANED,
            Role.RECEIVER: Outcome.ORPHANED,
        }

    pair = fly(rig, course)
    assert pair.log[Role.SENDER].of("/settled")[0]["outcome"] == "unconfirmed"
    assert pair.log[Role.RECEIVER].of("/settled")[0]["outcome"] == "unconfirmed"


def test_a_link_that_dies_at_the_commit_leaves_the_target_with_the_sender(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.cut()
        outcomes = await pair.decide(timeout_s=5.0)
        assert outcomes == {Role.SENDER: Outcome.NO_AGREEMENT, Role.RECEIVER: Outcome.NO_AGREEMENT}

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert pair.verified_again == [2]


@pytest.mark.parametrize("seed", range(8))
def test_whatever_is_lost_there_are_never_two_and_both_come_to_an_end(rig: Any, seed: int) -> None:
    """S1 and no dead end, with up to 80 % of all packets lost."""
    chance = random.Random(seed)
    share = chance.uniform(0.2, 0.8)

    async def course(pair: Pair) -> None:
        for link in pair.link.values():
            link.lost = lambda _: chance.random() < share

        async def agree_always() -> None:
            while True:
                pair.sender.agreed(1)
                await asyncio.sleep(0.3)

        agreeing = asyncio.create_task(agree_always())
        outcomes = await pair.decide()
        agreeing.cancel()
        assert set(outcomes.values()) <= {
            Outcome.COMMITTED,
            Outcome.NO_AGREEMENT,
            Outcome.ORPHANED,
            Outcome.PEER_ABORTED,
        }
        if outcomes[Role.SENDER] is Outcome.COMMITTED:
            assert pair.receiver.holds_for_good
        if pair.receiver.holds_for_good:
            assert pair.sender.handed_over

    fly(rig, course)
