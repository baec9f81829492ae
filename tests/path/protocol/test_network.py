"""Two machines over a link that loses, duplicates, delays and reorders, with clocks that differ and
drift.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from path.messages import AbortReason, Accept, Candidate, Commit, Confirm, Message, Target
from path.observations import MissReason
from path.protocol import receiver, sender
from path.protocol.receiver import Holding, Provisional, ReceiverMachine
from path.protocol.sender import (
    AwaitingAccept,
    HandedOver,
    Idle,
    Keeping,
    SenderMachine,
    TakenBack,
    Verifying,
)
from path.protocol.values import (
    AbortRequested,
    Actions,
    AgreementComplete,
    CommitHeard,
    Ended,
    HandoffOutcome,
    Heard,
    Offer,
    Persist,
    ReceiverEvent,
    ReceiverRecord,
    Release,
    Send,
    SenderEvent,
    SenderRecord,
    TakeResponsibility,
    Tick,
    VerifyAgain,
)

MS = 1_000_000
DRIFT_PPM = 150
UNCERTAINTY = 10 * MS


@dataclass
class Pair:
    """Two machines and the packets between them. ``now_ns`` is true time and the sender's clock."""

    offset_ns: int = 0
    error_ns: int = 0  # of the receiver's conversion of a lease's end; at most UNCERTAINTY
    now_ns: int = 10**12
    # to the sender?
    wire: list[tuple[bool, Message]] = field(default_factory=list[tuple[bool, Message]])
    sender: SenderMachine = field(default_factory=SenderMachine)
    receiver: ReceiverMachine = field(default_factory=ReceiverMachine)
    sender_kept: SenderRecord = field(default_factory=SenderRecord)
    receiver_kept: ReceiverRecord = field(default_factory=ReceiverRecord)
    sender_flag: bool = True  # responsibility as the actions alone tell it
    receiver_flag: bool = False
    sender_ended: list[HandoffOutcome] = field(default_factory=list[HandoffOutcome])

    def receiver_clock(self, true_ns: int) -> int:
        return true_ns + self.offset_ns + true_ns * DRIFT_PPM // 1_000_000

    def holds(self) -> bool:
        return self.receiver.responsible(self.receiver_clock(self.now_ns))

    def tell_sender(self, event: SenderEvent) -> None:
        for action in self.sender.step(event, self.now_ns):
            match action:
                case Send(Commit() as commit):
                    assert not self.sender_flag, "S4: released before the commit"
                    self.wire.append((False, commit))
                case Send(message):
                    self.wire.append((False, message))
                case Persist(SenderRecord() as record):
                    assert record.epoch >= self.sender_kept.epoch, "S2"
                    self.sender_kept = record
                case Release():
                    self.sender_flag = False
                case TakeResponsibility():
                    self.sender_flag = True
                case Ended(outcome):
                    self.sender_ended.append(outcome)
                case _:
                    pass

    def tell_receiver(self, event: ReceiverEvent) -> Actions:
        actions = self.receiver.step(event, self.receiver_clock(self.now_ns))
        for action in actions:
            match action:
                case Send(message):
                    self.wire.append((True, message))
                case Persist(ReceiverRecord() as record):
                    assert record.epoch >= self.receiver_kept.epoch, "S2"
                    self.receiver_kept = record
                case Release():
                    self.receiver_flag = False
                case TakeResponsibility():
                    self.receiver_flag = True
                case _:
                    pass
        return actions

    def restart_sender(self) -> None:
        config = self.sender.config
        self.sender = SenderMachine(config, sender.restored(config, self.sender_kept, self.now_ns))
        self.sender_flag = self.sender.responsible

    def restart_receiver(self) -> None:
        config, now_ns = self.receiver.config, self.receiver_clock(self.now_ns)
        self.receiver = ReceiverMachine(
            config, receiver.restored(config, self.receiver_kept, now_ns)
        )
        self.receiver_flag = self.holds()

    def deliver(self, to_sender: bool, message: Message) -> None:
        if to_sender:
            self.tell_sender(Heard(message))
        elif isinstance(message, Commit):
            lease_end = self.receiver_clock(message.lease_end_ns) + self.error_ns
            before = self.holds()
            self.tell_receiver(CommitHeard(message, lease_end, UNCERTAINTY, 9))
            if self.holds() and not before:
                assert self.now_ns < message.lease_end_ns, "S3"
        else:
            self.tell_receiver(Heard(message))

    def advance(self, by_ns: int) -> None:
        """Let time pass; every machine is told at the instants it asked for."""
        end = self.now_ns + by_ns
        while True:
            due = [self.sender.wake_ns or end, self._receiver_due(end)]
            self.now_ns = max(self.now_ns, min(end, *due))
            if min(due) >= end:
                break
            self.tell_sender(Tick())
            self.tell_receiver(Tick())
            assert not (self.sender.responsible and self.holds()), "S1"
        self.tell_sender(Tick())
        self.tell_receiver(Tick())

    def _receiver_due(self, end: int) -> int:
        wake = self.receiver.wake_ns
        if wake is None:
            return end
        true = (wake - self.offset_ns) * 1_000_000 // (1_000_000 + DRIFT_PPM)
        return true if self.receiver_clock(true) >= wake else true + 1

    def observe(self) -> None:
        """One exchange of Target and Candidate."""
        live = self.sender.live
        if live is None:
            return
        point, down = (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)
        self.wire.append(
            (False, Target(live.handoff_id, live.epoch, live.target_id, 0, 0, point, down, 0.0))
        )
        known = self.receiver.live
        if known is not None:
            reason = MissReason.NO_CANDIDATE
            ids = (known.handoff_id, known.epoch, known.target_id)
            self.wire.append(
                (True, Candidate(*ids, 0, 0, 0, None, reason, point, (1.0, 0.0, 0.0, 0.0), 0.0))
            )

    def agree(self, nonce: int = 1) -> None:
        live = self.sender.live
        assert live is not None
        self.tell_sender(AgreementComplete(live.epoch, live.target_id, nonce, UNCERTAINTY, 9))


class Handovers(RuleBasedStateMachine):
    @initialize(
        offset=st.integers(-(10**9), 10**9),
        error=st.integers(-UNCERTAINTY + 2 * MS, UNCERTAINTY - 2 * MS),
    )
    def begin(self, offset: int, error: int) -> None:
        self.pair = Pair(offset, error)
        self.nonce = 0
        self.was_handed_over = False
        self.sender_epoch = 0
        self.receiver_floor = 0
        self.upsets = 0
        self.all_goes_well_up_to_the_commit()

    @rule(ms=st.sampled_from([1, 20, 60, 400, 1500]))
    def time_passes(self, ms: int) -> None:
        self.pair.advance(ms * MS)

    @precondition(lambda self: not isinstance(self.pair.sender.state, Idle | Keeping))
    @rule()
    def observe(self) -> None:
        self.pair.observe()

    @precondition(lambda self: isinstance(self.pair.sender.state, Verifying))
    @rule()
    def agree(self) -> None:
        self.nonce += 1
        self.pair.agree(self.nonce)

    @precondition(lambda self: self.pair.sender.responsible)
    @rule()
    def all_goes_well_up_to_the_commit(self) -> None:
        self.pair.tell_sender(Offer(1, 1))
        for _ in range(2):
            self.pair.observe()
            self.deliver_everything()
        if isinstance(self.pair.sender.state, Verifying):
            self.agree()

    def deliver_everything(self) -> None:
        packets, self.pair.wire = self.pair.wire, []
        for packet in packets:
            self.pair.deliver(*packet)

    @precondition(lambda self: self.pair.wire)
    @rule(data=st.data(), again=st.booleans())
    def deliver(self, data: st.DataObject, again: bool) -> None:
        index = data.draw(st.integers(0, len(self.pair.wire) - 1))
        packet = self.pair.wire[index]
        if not again:
            self.pair.wire.pop(index)
        self.pair.deliver(*packet)

    @precondition(lambda self: self.pair.wire)
    @rule()
    def deliver_all(self) -> None:
        self.deliver_everything()

    @precondition(lambda self: self.pair.wire)
    @rule(data=st.data())
    def lose(self, data: st.DataObject) -> None:
        self.pair.wire.pop(data.draw(st.integers(0, len(self.pair.wire) - 1)))

    @precondition(lambda self: isinstance(self.pair.sender.state, TakenBack))
    @rule()
    def verify_again(self) -> None:
        self.pair.tell_sender(VerifyAgain())

    @precondition(lambda self: self.upsets < 3)
    @rule(
        kind=st.sampled_from(
            ["sender's veto", "receiver's veto", "sender restarts", "receiver restarts"]
        )
    )
    def upset(self, kind: str) -> None:
        self.upsets += 1
        pair = self.pair
        match kind:
            case "sender's veto":
                pair.tell_sender(AbortRequested(AbortReason.PILOT))
            case "receiver's veto":
                pair.tell_receiver(AbortRequested(AbortReason.PILOT))
            case "sender restarts":
                pair.restart_sender()
            case _:
                pair.restart_receiver()

    @invariant()
    def holds(self) -> None:
        if not hasattr(self, "pair"):
            return
        gives, takes = self.pair.sender, self.pair.receiver
        assert not (gives.responsible and self.pair.holds()), "S1"
        assert gives.responsible == self.pair.sender_flag, "the actions tell the state"
        assert self.pair.holds() == self.pair.receiver_flag, "the actions tell the state"
        epoch = sender.epoch(gives.state)
        assert epoch >= self.sender_epoch and receiver.floor(takes.state) >= self.receiver_floor, (
            "S2"
        )
        self.sender_epoch, self.receiver_floor = epoch, receiver.floor(takes.state)
        assert not (self.was_handed_over and gives.responsible), "S4"
        self.was_handed_over = isinstance(gives.state, HandedOver)
        match gives.state, takes.state:
            case (AwaitingAccept() | HandedOver()) as given, (Provisional() | Holding()) as taken:
                assert taken.live.epoch != epoch or taken.live == given.live, "S5"
            case _:
                pass


Handovers.TestCase.settings = settings(max_examples=200, stateful_step_count=25)
TestHandovers = Handovers.TestCase


def test_a_lossy_link_decides_in_bounded_time() -> None:
    """L1: a third of the packets lost, the rest late by up to 80 ms, some twice."""
    outcomes: list[HandoffOutcome] = []
    for seed in range(60):
        rng = random.Random(seed)
        pair = Pair(offset_ns=rng.randrange(10**9), error_ns=rng.randrange(-8 * MS, 8 * MS))
        pair.tell_sender(Offer(1, 1))
        flying: list[tuple[int, bool, Message]] = []
        agreed_ns = None
        while not pair.sender_ended and pair.now_ns < 10**12 + 10**10:
            if not isinstance(pair.sender.state, AwaitingAccept | HandedOver):
                pair.observe()
            if agreed_ns is None and isinstance(pair.sender.state, Verifying):
                pair.agree()
                agreed_ns = pair.now_ns
            for to_sender, message in pair.wire:
                for _ in range(rng.choice((0, 1, 1, 1, 2)) if rng.random() > 0.2 else 0):
                    flying.append((pair.now_ns + rng.randrange(80 * MS), to_sender, message))
            pair.wire.clear()
            for packet in [packet for packet in flying if packet[0] <= pair.now_ns]:
                flying.remove(packet)
                pair.deliver(*packet[1:])
            pair.advance(10 * MS)
        outcomes += pair.sender_ended
        assert agreed_ns is not None and pair.now_ns - agreed_ns < 1600 * MS
    assert len(outcomes) == 60
    assert outcomes.count(HandoffOutcome.HANDED_OVER) >= 58
    assert set(outcomes) <= {HandoffOutcome.HANDED_OVER, HandoffOutcome.TAKEN_BACK}


def test_a_link_that_dies_between_accept_and_confirm_leaves_an_orphan_that_both_alarm() -> None:
    pair = Pair()
    pair.tell_sender(Offer(1, 1))
    for _ in range(2):  # the receiver joins, then answers
        pair.observe()
        packets, pair.wire = pair.wire, []
        for packet in packets:
            pair.deliver(*packet)
    pair.agree()
    pair.deliver(*pair.wire.pop())
    assert isinstance(pair.wire[-1][1], Accept)
    pair.deliver(*pair.wire.pop())
    assert isinstance(pair.wire.pop()[1], Confirm)  # lost, and everything after it
    pair.advance(6 * 10**9)
    assert not pair.sender.responsible and not pair.holds()
    assert (
        isinstance(pair.sender.state, HandedOver)
        and pair.sender.state.settled is HandoffOutcome.UNCONFIRMED
    )
    assert pair.sender.state.settled.alarming
