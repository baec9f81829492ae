from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from path.messages import Abort, AbortReason, Accept, Commit, Confirm, Target
from path.protocol.receiver import (
    Holding,
    LetGo,
    Observing,
    Provisional,
    ReceiverMachine,
    record,
    restored,
)
from path.protocol.values import (
    AbortRequested,
    CommitHeard,
    Ended,
    Handoff,
    HandoffOutcome,
    Heard,
    NewMission,
    PeerStatus,
    Persist,
    ProtocolConfig,
    ReceiverRecord,
    Refusal,
    Refused,
    Release,
    Send,
    Settled,
    TakeResponsibility,
    Tick,
)

S = 1_000_000_000
MS = 1_000_000
CONFIG = ProtocolConfig(
    handoff_s=20.0, lease_s=1.0, retry_s=0.1, guard_s=0.02, settle_s=2.0, max_uncertainty_s=0.1
)
TARGET = Target(7, 5, 3, 1, 1, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.01)
T0 = 100 * S
ME, OTHER = 77, 78  # instances of receivers
HEARD = CommitHeard(
    Commit(7, 5, 3, 99, 12345, 1, ME), lease_end_ns=T0 + S, uncertainty_ns=5 * MS, instance=ME
)
LEASE_END = T0 + S - 5 * MS - 20 * MS
SURE = T0 + S + 5 * MS + 100 * MS + 20 * MS
CONFIRM = Confirm(7, 5, 3, 99, 5, ME)
LIVE = Handoff(7, 5, 3, ME)
HELD = Persist(ReceiverRecord(5, "provisional", LIVE, 99, LEASE_END, SURE))
GONE = Persist(ReceiverRecord(6, "let_go", LIVE, 99, 0, SURE))
PILOT = AbortRequested(AbortReason.PILOT)


def joined() -> ReceiverMachine:
    machine = ReceiverMachine(CONFIG)
    assert machine.step(Heard(TARGET), T0) == (Persist(ReceiverRecord(5)),)
    return machine


def provisional() -> ReceiverMachine:
    machine = joined()
    machine.step(HEARD, T0)
    return machine


def holding() -> ReceiverMachine:
    machine = provisional()
    machine.step(Heard(CONFIRM), T0)
    return machine


def let_go() -> ReceiverMachine:
    machine = provisional()
    machine.step(Tick(), LEASE_END)
    return machine


def test_the_whole_way() -> None:
    machine = joined()
    assert machine.live == Handoff(7, 5, 3) and not machine.responsible(T0)
    assert machine.step(Heard(TARGET), T0) == ()
    assert machine.step(HEARD, T0) == (
        HELD,
        TakeResponsibility(LEASE_END),
        Send(Accept(7, 5, 3, 99, T0, ME)),
    )
    assert machine.responsible(T0)
    again = T0 + 100 * MS
    assert machine.wake_ns == again
    assert machine.step(Tick(), again) == (Send(Accept(7, 5, 3, 99, again, ME)),)
    assert machine.step(HEARD, again) == ()  # the repeated Commit changes nothing
    kept = Persist(ReceiverRecord(5, "holding", LIVE, 99))
    assert machine.step(Heard(CONFIRM), again) == (
        kept,
        TakeResponsibility(),
        Ended(HandoffOutcome.HANDED_OVER),
    )
    assert isinstance(machine.state, Holding) and machine.responsible(T0)
    assert machine.step(Heard(CONFIRM), again) == () and machine.step(HEARD, again) == ()
    assert machine.step(Tick(), T0 + 1000 * S) == () and machine.responsible(T0 + 1000 * S)


def test_without_confirm_it_lets_go_before_the_lease_ends_on_any_clock() -> None:
    machine = provisional()
    machine.step(Tick(), LEASE_END - 1)
    assert machine.responsible(LEASE_END - 1)
    actions = machine.step(Tick(), LEASE_END)
    told = Send(Abort(7, 5, AbortReason.TIMEOUT, LEASE_END, ME))
    assert actions == (Release(), GONE, told, Ended(HandoffOutcome.LET_GO))
    assert not machine.responsible(LEASE_END - 1) and HandoffOutcome.LET_GO.alarming


def test_a_confirm_at_the_very_end_comes_too_late_and_is_proof_of_an_orphan() -> None:
    machine = provisional()
    actions = machine.step(Heard(CONFIRM), LEASE_END)
    assert Release() in actions and actions[-1] == Settled(HandoffOutcome.ORPHANED)
    assert Send(Abort(7, 5, AbortReason.TIMEOUT, LEASE_END, ME)) in actions
    assert not machine.responsible(T0)
    (tell,) = machine.step(Heard(CONFIRM), LEASE_END + S)
    assert isinstance(tell, Send) and isinstance(tell.message, Abort)


@pytest.mark.parametrize(
    ("heard", "why"),
    [
        (replace(HEARD, commit=replace(HEARD.commit, epoch=4)), Refusal.LOWER_EPOCH),
        (replace(HEARD, commit=replace(HEARD.commit, epoch=6)), Refusal.UNKNOWN_EPOCH),
        (replace(HEARD, commit=replace(HEARD.commit, target_id=4)), Refusal.WRONG_TARGET),
        (replace(HEARD, commit=replace(HEARD.commit, handoff_id=8)), Refusal.WRONG_HANDOFF),
        (replace(HEARD, lease_end_ns=None), Refusal.NO_CLOCK),
        (replace(HEARD, uncertainty_ns=101 * MS), Refusal.NO_CLOCK),
        (replace(HEARD, lease_end_ns=T0 + 25 * MS), Refusal.LEASE_OVER),
        (replace(HEARD, able=False), Refusal.NOT_ABLE),
    ],
)
def test_it_takes_over_only_on_the_live_commit(heard: CommitHeard, why: Refusal) -> None:
    machine = joined()
    assert machine.step(heard, T0) == (Refused(why),)
    assert not machine.responsible(T0)
    assert machine.step(HEARD, T0)[:2] == (HELD, TakeResponsibility(LEASE_END))


def test_a_commit_without_any_target_heard_is_refused() -> None:
    assert ReceiverMachine(CONFIG).step(HEARD, T0) == (Refused(Refusal.UNKNOWN_EPOCH),)
    assert ReceiverMachine(CONFIG, Observing(5)).step(HEARD, T0) == (
        Refused(Refusal.UNKNOWN_EPOCH),
    )
    assert ReceiverMachine(CONFIG, Observing(6)).step(HEARD, T0) == (Refused(Refusal.LOWER_EPOCH),)


def test_one_nonce_an_epoch() -> None:
    other = replace(HEARD, commit=replace(HEARD.commit, nonce=98))
    for machine in (provisional(), holding()):
        assert machine.step(other, T0) == (Refused(Refusal.WRONG_NONCE),)
        assert machine.responsible(T0)
    assert provisional().step(Heard(replace(CONFIRM, nonce=98)), T0) == (
        Refused(Refusal.WRONG_NONCE),
    )


@pytest.mark.parametrize(
    "confirm",
    [replace(CONFIRM, epoch=4), replace(CONFIRM, target_id=4), replace(CONFIRM, handoff_id=8)],
)
def test_only_the_live_confirm_counts(confirm: Confirm) -> None:
    machine = provisional()
    (refused,) = machine.step(Heard(confirm), T0)
    assert isinstance(refused, Refused) and isinstance(machine.state, Provisional)


def test_an_epoch_let_go_is_never_taken_again() -> None:
    machine = let_go()
    late = replace(HEARD, lease_end_ns=T0 + 10 * S)
    assert machine.step(late, LEASE_END + 1) == (Refused(Refusal.LEASE_OVER),)
    assert machine.step(Heard(TARGET), LEASE_END + 1) == (Refused(Refusal.LOWER_EPOCH),)
    restarted = ReceiverMachine(CONFIG, Observing(6))  # what it wrote down
    assert restarted.step(Heard(TARGET), LEASE_END + 1) == (Refused(Refusal.LOWER_EPOCH),)
    assert machine.step(Heard(replace(TARGET, epoch=6)), LEASE_END + 1) == (
        Settled(HandoffOutcome.TAKEN_BACK),
        Persist(ReceiverRecord(6)),
    )


def test_lower_epochs_are_refused_and_higher_ones_beat_everything() -> None:
    assert ReceiverMachine(CONFIG, Observing(6)).step(Heard(TARGET), T0) == (
        Refused(Refusal.LOWER_EPOCH),
    )
    for machine in (provisional(), holding()):
        assert machine.step(Heard(replace(TARGET, epoch=4)), T0) == (Refused(Refusal.LOWER_EPOCH),)
        actions = machine.step(Heard(replace(TARGET, epoch=6)), T0)
        assert actions == (Release(), Ended(HandoffOutcome.SUPERSEDED), Persist(ReceiverRecord(6)))
        assert machine.live == Handoff(7, 6, 3) and not machine.responsible(T0)


def test_another_target_or_handoff_within_the_epoch_is_refused() -> None:
    machine = joined()
    assert machine.step(Heard(replace(TARGET, target_id=4)), T0) == (Refused(Refusal.WRONG_TARGET),)
    assert machine.step(Heard(replace(TARGET, handoff_id=8)), T0) == (
        Refused(Refusal.WRONG_HANDOFF),
    )
    assert machine.live == Handoff(7, 5, 3)


def test_the_senders_abort_ends_it_and_spends_the_epoch() -> None:
    abort = Heard(Abort(7, 5, AbortReason.TARGET_LOST, 5))
    ended = Ended(HandoffOutcome.ABORTED, AbortReason.TARGET_LOST)
    machine = joined()
    assert machine.step(Heard(Abort(7, 4, AbortReason.PILOT, 5)), T0) == (
        Refused(Refusal.WRONG_HANDOFF),
    )
    assert machine.step(abort, T0) == (Persist(ReceiverRecord(6)), ended)
    assert machine.step(HEARD, T0) == (Refused(Refusal.LOWER_EPOCH),)
    machine = provisional()
    assert machine.step(abort, T0) == (Release(), Persist(ReceiverRecord(6)), ended)
    assert not machine.responsible(T0)
    machine = holding()
    assert machine.step(abort, T0) == (Refused(Refusal.WRONG_STATE),)
    assert machine.responsible(T0)


def test_the_pilots_veto() -> None:
    told = Send(Abort(7, 5, AbortReason.PILOT, T0))
    ended = Ended(HandoffOutcome.ABORTED, AbortReason.PILOT)
    machine = joined()
    assert machine.step(PILOT, T0) == (Persist(ReceiverRecord(6)), told, ended)
    assert machine.state == Observing(6)
    machine = provisional()
    told = Send(Abort(7, 5, AbortReason.PILOT, T0, ME))  # it was committed to this very receiver
    assert machine.step(PILOT, T0) == (Release(), GONE, told, ended)
    assert machine.step(Heard(CONFIRM), T0)[-1] == Settled(HandoffOutcome.ORPHANED)
    assert not machine.responsible(T0)
    machine = holding()
    gone = Persist(ReceiverRecord(6, "let_go", LIVE, 99, 0, T0))
    assert machine.step(PILOT, T0) == (
        Release(),
        gone,
        told,
        ended,
        Settled(HandoffOutcome.ORPHANED),
    )
    assert ReceiverMachine(CONFIG).step(PILOT, T0) == (Refused(Refusal.WRONG_STATE),)


def test_a_handoff_that_comes_to_nothing_ends_in_timeout() -> None:
    machine = joined()
    end = T0 + 21 * S
    assert machine.wake_ns == end
    assert machine.step(Tick(), end - 1) == ()
    told = Send(Abort(7, 5, AbortReason.TIMEOUT, end))
    assert machine.step(Tick(), end) == (
        Persist(ReceiverRecord(6)),
        told,
        Ended(HandoffOutcome.TIMEOUT),
    )
    assert machine.live is None and machine.wake_ns is None


@pytest.mark.parametrize(
    ("event", "at", "outcome"),
    [
        (PeerStatus(responsible=True, stamp_ns=SURE + 1), SURE + 2, HandoffOutcome.TAKEN_BACK),
        (PeerStatus(responsible=False, stamp_ns=SURE + 1), SURE + 2, HandoffOutcome.ORPHANED),
        (Tick(), SURE + 2 * S, HandoffOutcome.UNCONFIRMED),
    ],
)
def test_after_letting_go_it_learns_who_is_responsible(
    event: PeerStatus | Tick, at: int, outcome: HandoffOutcome
) -> None:
    machine = let_go()
    assert isinstance(machine.state, LetGo)
    assert machine.step(PeerStatus(responsible=False, stamp_ns=SURE), LEASE_END + 1) == ()
    assert machine.step(event, at) == (Settled(outcome),)


def restarted(machine: ReceiverMachine, now_ns: int, *, same_clock: bool = True) -> ReceiverMachine:
    """With what the machine would have written down."""
    kept = record(machine.state)
    return ReceiverMachine(CONFIG, restored(CONFIG, kept, now_ns, same_clock=same_clock))


def test_within_its_lease_it_holds_on_after_a_restart_and_says_so() -> None:
    machine = restarted(provisional(), T0 + 100 * MS)
    assert machine.responsible(T0 + 100 * MS)
    accept = Accept(7, 5, 3, 99, T0 + 100 * MS, ME)
    assert machine.step(Tick(), T0 + 100 * MS) == (Send(accept),)
    machine.step(Heard(CONFIRM), T0 + 200 * MS)
    assert isinstance(machine.state, Holding)


@pytest.mark.parametrize(
    ("now_ns", "same_clock"), [(LEASE_END, True), (LEASE_END + 10 * S, True), (5 * S, False)]
)
def test_a_lease_that_may_be_over_is_let_go_after_a_restart(now_ns: int, same_clock: bool) -> None:
    machine = restarted(provisional(), now_ns, same_clock=same_clock)
    assert isinstance(machine.state, LetGo) and not machine.responsible(now_ns)
    assert machine.step(HEARD, now_ns) == (Refused(Refusal.LEASE_OVER),)
    # nothing said before may be taken for news
    last = now_ns + S + 220 * MS if not same_clock else SURE
    assert machine.step(PeerStatus(responsible=False, stamp_ns=last), last) == ()


@pytest.mark.parametrize("same_clock", [True, False])
def test_what_is_held_for_good_is_held_after_a_restart(same_clock: bool) -> None:
    machine = restarted(holding(), 5 * S, same_clock=same_clock)
    assert isinstance(machine.state, Holding) and machine.responsible(T0)


@pytest.mark.parametrize("make", [joined, provisional, holding, let_go])
def test_a_restored_state_is_written_down_as_it_was(make: Callable[[], ReceiverMachine]) -> None:
    kept = record(make().state)
    assert record(restored(CONFIG, kept, T0 + 1)) == kept


def test_a_commit_or_confirm_to_another_receiver_is_none() -> None:
    machine = joined()
    other = replace(HEARD, commit=replace(HEARD.commit, instance=OTHER))
    assert machine.step(other, T0) == (Refused(Refusal.WRONG_INSTANCE),)
    assert not machine.responsible(T0) and isinstance(machine.state, Observing)
    for machine in (provisional(), holding()):
        before = machine.state
        assert machine.step(Heard(replace(CONFIRM, instance=OTHER)), T0) == (
            Refused(Refusal.WRONG_INSTANCE),
        )
        assert machine.step(other, T0) == (Refused(Refusal.WRONG_INSTANCE),)
        assert machine.state == before


def test_a_lease_longer_than_any_that_is_given_is_no_lease() -> None:
    machine = joined()
    longest = T0 + S + HEARD.uncertainty_ns
    assert machine.step(replace(HEARD, lease_end_ns=longest + 1), T0) == (
        Refused(Refusal.LEASE_TOO_LONG),
    )
    until_ns = LEASE_END + HEARD.uncertainty_ns
    assert machine.step(replace(HEARD, lease_end_ns=longest), T0)[1] == TakeResponsibility(until_ns)


def test_a_lease_that_is_over_is_over_before_anybody_has_told_the_machine() -> None:
    machine = provisional()
    assert machine.responsible(LEASE_END - 1) and not machine.responsible(LEASE_END)
    assert isinstance(machine.state, Provisional)
    for late in (LEASE_END, LEASE_END + 2 * S):
        machine = provisional()
        actions = machine.step(Heard(CONFIRM), late)
        assert isinstance(machine.state, LetGo) and actions[0] == Release()
        assert not any(isinstance(action, TakeResponsibility) for action in actions)


def test_a_new_mission_within_a_lease_is_none() -> None:
    machine = provisional()
    before = machine.state
    assert machine.step(NewMission(), T0) == (Refused(Refusal.WRONG_STATE),)
    assert machine.state == before and machine.responsible(T0)


def test_what_has_an_end_is_provisional() -> None:
    assert TakeResponsibility(5).provisional and not TakeResponsibility().provisional
    assert (
        TakeResponsibility(5).at(4)
        and not TakeResponsibility(5).at(5)
        and TakeResponsibility().at(1 << 62)
    )
