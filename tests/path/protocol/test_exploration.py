"""Every interleaving of a small model: two machines, two packets in flight, loss, duplication, reordering, clock error,
aborts and restarts. One tick is one nanosecond."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest

from path.messages import Abort, AbortReason, Accept, Commit, Confirm, Message, Target
from path.protocol import receiver, sender
from path.protocol.values import (
    AbortRequested,
    Actions,
    AgreementComplete,
    CommitHeard,
    Handoff,
    Heard,
    Outcome,
    PeerStatus,
    PersistEpoch,
    ProtocolConfig,
    ReceiverEvent,
    Send,
    SenderEvent,
    Settled,
    Tick,
    VerifyAgain,
)

TICK = 1e-9
UNCERTAINTY = 1
LEASE = 5
CONFIG = ProtocolConfig(
    offer_s=50 * TICK,
    handoff_s=50 * TICK,
    lease_s=LEASE * TICK,
    retry_s=2 * TICK,
    guard_s=0.0,
    settle_s=2 * TICK,
    max_uncertainty_s=UNCERTAINTY * TICK,
)
IN_FLIGHT = 2
ROUND = LEASE + UNCERTAINTY + 3  # from a commit until both sides have settled
LIVE = Handoff(1, 1, 1)


@dataclass(frozen=True, slots=True)
class World:
    """``error``: by how much the receiver misjudges the lease's end. ``upsets``: aborts and restarts still to come."""

    now: int
    sender: sender.SenderState
    receiver: receiver.ReceiverState
    wire: frozenset[tuple[str, Message]]  # to whom, what; a set: any packet may be delivered again
    error: int
    upsets: int
    rounds: int  # agreements still to come
    sender_kept: PersistEpoch  # what is on disk
    receiver_kept: int
    sender_settled: Outcome | None = None


def start(error: int, upsets: int, rounds: int) -> World:
    return World(
        now=0,
        sender=sender.Verifying(LIVE, 50),
        receiver=receiver.Observing(1, LIVE, 60),
        wire=frozenset(),
        error=error,
        upsets=upsets,
        rounds=rounds,
        sender_kept=PersistEpoch(1),
        receiver_kept=1,
    )


def put(world: World, to: str, actions: Actions) -> World:
    """Carry out what a machine asked for. A packet that finds the wire full is lost."""
    for action in actions:
        if isinstance(action, Send):
            assert isinstance(action.message, Commit | Accept | Confirm | Abort)
            packet = (to, replace(action.message, stamp_ns=0))
            if len(world.wire) < IN_FLIGHT:
                world = replace(world, wire=world.wire | {packet})
        elif isinstance(action, PersistEpoch) and to == "receiver":
            world = replace(world, sender_kept=action)
        elif isinstance(action, PersistEpoch):
            world = replace(world, receiver_kept=action.epoch)
        elif isinstance(action, Settled) and to == "receiver":
            world = replace(world, sender_settled=action.outcome)
    return world


def tell_sender(world: World, event: SenderEvent) -> World:
    state, actions = sender.step(CONFIG, world.sender, event, world.now)
    return put(replace(world, sender=state), "receiver", actions)


def tell_receiver(world: World, event: ReceiverEvent) -> World:
    state, actions = receiver.step(CONFIG, world.receiver, event, world.now)
    return put(replace(world, receiver=state), "sender", actions)


def deliver(world: World, to: str, message: Message) -> World:
    if to == "sender":
        return tell_sender(world, Heard(message))
    if isinstance(message, Commit):
        return tell_receiver(world, CommitHeard(message, message.lease_end_ns + world.error, UNCERTAINTY))
    return tell_receiver(world, Heard(message))


def target(world: World) -> Target:
    live = world.sender.live if not isinstance(world.sender, sender.Idle) else LIVE
    return Target(live.handoff_id, live.epoch, live.target_id, 0, 0, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.0)


def moves(world: World, end: int) -> Iterator[World]:
    for packet in world.wire:
        without = replace(world, wire=world.wire - {packet})
        yield deliver(world, *packet)  # and may come again
        yield deliver(without, *packet)
        yield without  # lost
    if world.now < end:
        later = replace(world, now=world.now + 1)
        yield tell_sender(tell_receiver(later, Tick()), Tick())
    if world.rounds and isinstance(world.sender, sender.Verifying) and world.now + ROUND <= end:
        agreed = AgreementComplete(world.sender.live.epoch, LIVE.target_id, 40 + world.rounds, UNCERTAINTY)
        yield tell_sender(replace(world, rounds=world.rounds - 1), agreed)
    if world.rounds and isinstance(world.sender, sender.TakenBack):
        yield tell_receiver(tell_sender(world, VerifyAgain()), Heard(target(world)))
    if isinstance(world.sender, sender.HandedOver) and world.sender.settled is None:
        yield tell_sender(world, PeerStatus(receiver.is_responsible(world.receiver), world.now - UNCERTAINTY))
    if world.upsets:
        upset = replace(world, upsets=world.upsets - 1)
        yield tell_sender(upset, AbortRequested(AbortReason.PILOT))
        yield tell_receiver(upset, AbortRequested(AbortReason.PILOT))
        kept = world.sender_kept
        yield replace(upset, sender=sender.Idle(kept.epoch, not kept.released))
        reborn = replace(upset, receiver=receiver.Observing(world.receiver_kept))
        yield reborn
        if world.receiver_kept == LIVE.epoch:  # it hears the sender's Targets again
            yield tell_receiver(reborn, Heard(target(world)))


def explore(first: World, end: int) -> Iterator[tuple[World, World]]:
    """Every step of every history: (before, after)."""
    seen, queue = {first}, deque([first])
    while queue:
        world = queue.popleft()
        for after in moves(world, end):
            if after not in seen:
                seen.add(after)
                queue.append(after)
                yield world, after


def epoch(state: sender.SenderState) -> int:
    return state.epoch if isinstance(state, sender.Idle) else state.live.epoch


def check(before: World, after: World) -> None:
    """S1 to S5 on one step."""
    was, now = before.sender, after.sender
    assert not (sender.is_responsible(now) and receiver.is_responsible(after.receiver)), "S1"
    assert epoch(now) >= epoch(was) and receiver.floor(after.receiver) >= receiver.floor(before.receiver), "S2"
    if isinstance(after.receiver, receiver.Provisional) and not isinstance(before.receiver, receiver.Provisional):
        leases = [message.lease_end_ns for _, message in before.wire if isinstance(message, Commit)]
        assert leases and after.now < max(leases), "S3"
    if isinstance(was, sender.AwaitingAccept) and sender.is_responsible(now):
        assert after.now >= was.commit.lease_end_ns + UNCERTAINTY, "S4"
    if isinstance(was, sender.HandedOver):
        assert not sender.is_responsible(now), "S4"
    if isinstance(now, sender.AwaitingAccept):
        assert after.rounds < before.rounds or isinstance(was, sender.AwaitingAccept), "S5"
    if after.sender_settled is Outcome.HANDED_OVER and before.sender_settled is None:
        assert isinstance(after.receiver, receiver.Holding), "told that the receiver holds, and it does not"


@pytest.mark.parametrize("error", [-UNCERTAINTY, 0, UNCERTAINTY])
def test_without_upsets_the_only_gap_is_the_alarmed_orphan(error: int) -> None:
    end = ROUND + 1
    ends: set[tuple[type, type]] = set()
    for before, after in explore(start(error, upsets=0, rounds=1), end):
        check(before, after)
        handed_over = isinstance(after.sender, sender.HandedOver)
        if not sender.is_responsible(after.sender) and not receiver.is_responsible(after.receiver) and not handed_over:
            assert isinstance(after.sender, sender.AwaitingAccept), "L2"
            assert after.now < after.sender.take_back_ns, "L2"
        if after.now == end:
            ends.add((type(after.sender), type(after.receiver)))
            if not sender.is_responsible(after.sender) and not receiver.is_responsible(after.receiver):
                assert isinstance(after.receiver, receiver.LetGo) and after.sender_settled is not None
                assert after.sender_settled.alarming
    assert (sender.HandedOver, receiver.Holding) in ends
    assert (sender.HandedOver, receiver.LetGo) in ends  # the orphan can happen
    assert {pair for pair in ends if pair[0] is sender.HandedOver} == {
        (sender.HandedOver, receiver.Holding),
        (sender.HandedOver, receiver.LetGo),
    }
    assert (sender.TakenBack, receiver.LetGo) in ends and (sender.TakenBack, receiver.Observing) in ends


@pytest.mark.parametrize("error", [-UNCERTAINTY, UNCERTAINTY])
def test_aborts_and_restarts_break_nothing(error: int) -> None:
    kinds: set[tuple[type, type]] = set()
    for before, after in explore(start(error, upsets=1, rounds=1), ROUND + 1):
        check(before, after)
        kinds.add((type(after.sender), type(after.receiver)))
    assert len(kinds) > 8


def test_a_second_attempt_after_taking_back_breaks_nothing() -> None:
    second = False
    for before, after in explore(start(UNCERTAINTY, upsets=0, rounds=2), 2 * ROUND):
        check(before, after)
        second = second or (isinstance(after.receiver, receiver.Holding) and after.receiver.live.epoch == 2)
    assert second
