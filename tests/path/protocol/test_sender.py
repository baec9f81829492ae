from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from path.messages import Abort, AbortReason, Accept, Candidate, Commit, Confirm
from path.observations import MissReason
from path.protocol.sender import (
    AwaitingAccept,
    HandedOver,
    Keeping,
    Offering,
    SenderMachine,
    TakenBack,
    Verifying,
    record,
    restored,
)
from path.protocol.values import (
    AbortRequested,
    AgreementComplete,
    Ended,
    Handoff,
    HandoffOutcome,
    Heard,
    NewMission,
    Offer,
    PeerStatus,
    Persist,
    ProtocolConfig,
    Refusal,
    Refused,
    Release,
    Send,
    SenderRecord,
    Settled,
    TakeResponsibility,
    Tick,
    VerifyAgain,
)

S = 1_000_000_000
MS = 1_000_000
CONFIG = ProtocolConfig(offer_s=10.0, handoff_s=20.0, lease_s=1.0, retry_s=0.1, settle_s=2.0)
ME, OTHER = 77, 78  # instances of receivers
OPEN = Handoff(handoff_id=7, epoch=1, target_id=3)  # before a COMMIT
LIVE = replace(OPEN, instance=ME)
CANDIDATE = Candidate(
    7, 1, 3, 1, 1, 5, None, MissReason.NO_MARKER, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 0.0
)
ACCEPT = Accept(7, 1, 3, 99, 5, ME)
CONFIRM = Confirm(7, 1, 3, 99, 0, ME)
AGREED = AgreementComplete(epoch=1, target_id=3, nonce=99, uncertainty_ns=5 * MS, instance=ME)
T0 = 100 * S
TAKE_BACK = T0 + 1 * S + 5 * MS


def offering() -> SenderMachine:
    machine = SenderMachine(CONFIG)
    assert not machine.responsible
    assert machine.step(Offer(7, 3), T0) == (Persist(SenderRecord(1, "mine")), TakeResponsibility())
    return machine


def verifying() -> SenderMachine:
    machine = offering()
    machine.step(Heard(CANDIDATE), T0)
    return machine


def awaiting() -> SenderMachine:
    machine = verifying()
    machine.step(AGREED, T0)
    return machine


def handed_over() -> SenderMachine:
    machine = awaiting()
    machine.step(Heard(ACCEPT), T0 + 200 * MS)
    return machine


def test_it_is_responsible_until_the_agreement_and_releases_before_it_commits() -> None:
    machine = offering()
    assert machine.responsible and machine.live == OPEN and isinstance(machine.state, Offering)
    assert machine.step(Heard(CANDIDATE), T0) == ()
    assert machine.responsible and isinstance(machine.state, Verifying)
    actions = machine.step(AGREED, T0)
    released = SenderRecord(1, "released", LIVE, 99, T0 + S, TAKE_BACK)
    assert actions == (Persist(released), Release(), Send(Commit(7, 1, 3, 99, T0 + S, T0, ME)))
    assert not machine.responsible


def test_commit_is_repeated_with_one_lease_until_it_ends() -> None:
    machine = awaiting()
    sent: list[Commit] = []
    assert machine.wake_ns == T0 + 100 * MS
    while isinstance(machine.state, AwaitingAccept):
        assert machine.wake_ns is not None
        now = machine.wake_ns
        for action in machine.step(Tick(), now):
            if isinstance(action, Send):
                assert isinstance(action.message, Commit) and action.message.stamp_ns == now
                sent.append(action.message)
    assert [c.stamp_ns - T0 for c in sent] == [k * 100 * MS for k in range(1, 10)]
    assert {c.lease_end_ns for c in sent} == {T0 + S} and {c.nonce for c in sent} == {99}


def test_an_accept_is_final_and_every_accept_is_confirmed() -> None:
    machine = awaiting()
    confirm = replace(CONFIRM, stamp_ns=T0 + 1)
    kept = Persist(SenderRecord(1, "handed_over", LIVE, 99, 0, TAKE_BACK))
    assert machine.step(Heard(ACCEPT), T0 + 1) == (
        kept,
        Send(confirm),
        Ended(HandoffOutcome.HANDED_OVER),
    )
    assert not machine.responsible
    for late in (T0 + 2, TAKE_BACK + 100 * S):
        actions = machine.step(Heard(ACCEPT), late)
        assert Send(replace(CONFIRM, stamp_ns=late)) in actions
        assert isinstance(machine.state, HandedOver)
    assert machine.step(AbortRequested(AbortReason.PILOT), TAKE_BACK + 101 * S) == (
        Refused(Refusal.WRONG_STATE),
    )
    assert not machine.responsible


def test_it_takes_back_only_after_lease_end_and_uncertainty() -> None:
    machine = awaiting()
    machine.step(Tick(), TAKE_BACK - 1)
    assert not machine.responsible
    actions = machine.step(Tick(), TAKE_BACK)
    assert actions == (
        Persist(SenderRecord(2, "mine")),
        TakeResponsibility(),
        Ended(HandoffOutcome.TAKEN_BACK),
    )
    assert machine.responsible and machine.live == replace(OPEN, epoch=2)


def test_an_accept_at_the_very_end_comes_too_late() -> None:
    machine = awaiting()
    actions = machine.step(Heard(ACCEPT), TAKE_BACK)
    assert TakeResponsibility() in actions and actions[-1] == Refused(Refusal.WRONG_STATE)
    assert not any(isinstance(action, Send) for action in actions)
    assert isinstance(machine.state, TakenBack)


def test_after_taking_back_it_verifies_again_in_the_new_epoch_only() -> None:
    machine = awaiting()
    machine.step(Tick(), TAKE_BACK)
    assert machine.step(VerifyAgain(), TAKE_BACK) == ()
    assert machine.step(AGREED, TAKE_BACK) == (Refused(Refusal.LOWER_EPOCH),)
    assert machine.step(Heard(CANDIDATE), TAKE_BACK) == (Refused(Refusal.LOWER_EPOCH),)
    actions = machine.step(replace(AGREED, epoch=2, nonce=5), TAKE_BACK)
    second = replace(LIVE, epoch=2)
    assert actions[0] == Persist(
        SenderRecord(2, "released", second, 5, TAKE_BACK + 1 * S, TAKE_BACK + 1 * S + 5 * MS)
    )
    assert machine.step(Heard(ACCEPT), TAKE_BACK + 1) == (Refused(Refusal.LOWER_EPOCH),)


@pytest.mark.parametrize(
    ("agreed", "why"),
    [
        (replace(AGREED, target_id=4), Refusal.WRONG_TARGET),
        (replace(AGREED, epoch=0), Refusal.LOWER_EPOCH),
        (replace(AGREED, epoch=2), Refusal.UNKNOWN_EPOCH),
        (replace(AGREED, uncertainty_ns=None), Refusal.NO_CLOCK),
        (replace(AGREED, uncertainty_ns=101 * MS), Refusal.NO_CLOCK),
        (replace(AGREED, instance=None), Refusal.NOT_ONE_RECEIVER),
    ],
)
def test_no_commit_without_the_full_agreement_and_a_clock(
    agreed: AgreementComplete, why: Refusal
) -> None:
    machine = verifying()
    assert machine.step(agreed, T0) == (Refused(why),)
    assert machine.responsible and isinstance(machine.state, Verifying)


def test_no_commit_before_anybody_answered() -> None:
    assert offering().step(AGREED, T0) == (Refused(Refusal.WRONG_STATE),)


@pytest.mark.parametrize(
    ("accept", "why"),
    [
        (replace(ACCEPT, nonce=98), Refusal.WRONG_NONCE),
        (replace(ACCEPT, target_id=4), Refusal.WRONG_TARGET),
        (replace(ACCEPT, handoff_id=8), Refusal.WRONG_HANDOFF),
        (replace(ACCEPT, epoch=0), Refusal.LOWER_EPOCH),
        (replace(ACCEPT, epoch=2), Refusal.UNKNOWN_EPOCH),
        (replace(ACCEPT, instance=OTHER), Refusal.WRONG_INSTANCE),
    ],
)
def test_only_the_live_accept_counts(accept: Accept, why: Refusal) -> None:
    for machine in (awaiting(), handed_over()):
        before = machine.state
        assert machine.step(Heard(accept), T0 + 1) == (Refused(why),)
        assert machine.state == before


def test_deadlines_end_in_timeout_and_responsible() -> None:
    machine = offering()
    assert machine.wake_ns == T0 + 10 * S
    abort = Abort(7, 1, AbortReason.TIMEOUT, T0 + 10 * S)
    assert machine.step(Tick(), T0 + 10 * S) == (Send(abort), Ended(HandoffOutcome.TIMEOUT))
    assert machine.responsible and machine.live is None
    machine = verifying()
    assert machine.wake_ns == T0 + 20 * S
    actions = machine.step(AGREED, T0 + 20 * S)
    assert actions[1:] == (Ended(HandoffOutcome.TIMEOUT), Refused(Refusal.WRONG_STATE))
    assert machine.responsible
    assert machine.step(Offer(8, 3), T0 + 21 * S) == (Persist(SenderRecord(2, "mine")),)


def test_an_abort_before_the_commit_ends_it_at_once() -> None:
    machine = verifying()
    told = (
        Send(Abort(7, 1, AbortReason.PILOT, T0)),
        Ended(HandoffOutcome.ABORTED, AbortReason.PILOT),
    )
    assert machine.step(AbortRequested(AbortReason.PILOT), T0) == told
    assert machine.state == Keeping(1)
    machine = verifying()
    abort = Abort(7, 1, AbortReason.TARGET_LOST, 5)
    assert machine.step(Heard(replace(abort, epoch=0)), T0) == (Refused(Refusal.WRONG_HANDOFF),)
    assert machine.step(Heard(abort), T0) == (
        Ended(HandoffOutcome.ABORTED, AbortReason.TARGET_LOST),
    )
    assert machine.responsible


@pytest.mark.parametrize(
    "event",
    [AbortRequested(AbortReason.PILOT), Heard(Abort(7, 1, AbortReason.PILOT, 5))],
    ids=["own", "peer"],
)
def test_an_abort_after_the_commit_still_waits_for_the_lease_and_confirms_nothing(
    event: AbortRequested | Heard,
) -> None:
    machine = awaiting()
    machine.step(event, T0 + 1)
    assert not machine.responsible and machine.wake_ns == TAKE_BACK
    (answer,) = machine.step(Heard(ACCEPT), T0 + 500 * MS)
    assert isinstance(answer, Send) and isinstance(answer.message, Abort)
    assert machine.step(Tick(), TAKE_BACK - 1) == ()
    actions = machine.step(Tick(), TAKE_BACK)
    assert TakeResponsibility() in actions and actions[-1] == Ended(
        HandoffOutcome.ABORTED, AbortReason.PILOT
    )


@pytest.mark.parametrize(
    ("event", "at", "outcome"),
    [
        (PeerStatus(True, TAKE_BACK + 1, ME), TAKE_BACK + 2, HandoffOutcome.HANDED_OVER),
        (PeerStatus(False, TAKE_BACK + 1, ME), TAKE_BACK + 2, HandoffOutcome.ORPHANED),
        (Heard(Abort(7, 1, AbortReason.TIMEOUT, 5, ME)), T0 + 900 * MS, HandoffOutcome.ORPHANED),
        (Tick(), TAKE_BACK + 2 * S, HandoffOutcome.UNCONFIRMED),
    ],
)
def test_it_learns_what_became_of_the_receiver(
    event: PeerStatus | Heard | Tick, at: int, outcome: HandoffOutcome
) -> None:
    machine = handed_over()
    provisional = PeerStatus(True, TAKE_BACK, ME)  # within the lease it says nothing
    assert machine.step(provisional, T0 + 300 * MS) == ()
    assert machine.step(event, at) == (Settled(outcome),)
    assert not machine.responsible
    assert outcome.alarming == (outcome is not HandoffOutcome.HANDED_OVER)
    assert machine.wake_ns is None


@pytest.mark.parametrize(
    "word",
    [
        PeerStatus(True, TAKE_BACK + 1, OTHER),
        PeerStatus(False, TAKE_BACK + 1, OTHER),
        PeerStatus(True, TAKE_BACK + 1),
        Heard(Abort(7, 1, AbortReason.TIMEOUT, 5, OTHER)),
        Heard(Abort(7, 1, AbortReason.PILOT, 5)),
    ],
)
def test_another_receiver_does_not_say_what_became_of_the_one_that_accepted(
    word: PeerStatus | Heard,
) -> None:
    machine = handed_over()
    before = machine.state
    machine.step(word, TAKE_BACK + 2)
    assert machine.state == before


def test_a_link_that_comes_back_settles_what_was_unconfirmed() -> None:
    machine = handed_over()
    machine.step(Tick(), TAKE_BACK + 3 * S)
    holds = PeerStatus(True, TAKE_BACK + 4 * S, ME)
    assert machine.step(holds, TAKE_BACK + 5 * S) == (Settled(HandoffOutcome.HANDED_OVER),)


def restarted(machine: SenderMachine, now_ns: int, *, same_clock: bool = True) -> SenderMachine:
    """With what the machine would have written down."""
    kept = record(machine.state)
    return SenderMachine(CONFIG, restored(CONFIG, kept, now_ns, same_clock=same_clock))


def test_epochs_survive_restarts() -> None:
    machine = restarted(verifying(), T0)
    assert machine.responsible and machine.live is None
    assert machine.step(Offer(7, 3), T0) == (Persist(SenderRecord(2, "mine")),)


def test_what_was_released_is_committed_again_after_a_restart_and_taken_back_in_time() -> None:
    machine = restarted(awaiting(), T0 + 500 * MS)
    assert not machine.responsible and machine.live == LIVE
    commit = Commit(7, 1, 3, 99, T0 + 1 * S, T0 + 500 * MS, ME)
    assert machine.step(Tick(), T0 + 500 * MS) == (Send(commit),)
    assert machine.step(Tick(), TAKE_BACK - 1) == ()
    assert TakeResponsibility() in machine.step(Tick(), TAKE_BACK)
    assert restarted(awaiting(), TAKE_BACK + 1).wake_ns == TAKE_BACK


def test_what_was_withdrawn_stays_withdrawn_after_a_restart() -> None:
    machine = awaiting()
    machine.step(AbortRequested(AbortReason.PILOT), T0 + 1)
    machine = restarted(machine, T0 + 2)
    (answer,) = machine.step(Heard(ACCEPT), T0 + 3)
    assert isinstance(answer, Send) and isinstance(answer.message, Abort)


def test_after_a_reboot_the_lease_is_waited_for_anew_and_never_promised_again() -> None:
    machine = restarted(awaiting(), 5 * S, same_clock=False)
    longest = round((CONFIG.lease_s + CONFIG.max_uncertainty_s) * S)
    assert machine.step(Tick(), 5 * S + longest - 1) == () and not machine.responsible
    assert TakeResponsibility() in machine.step(Tick(), 5 * S + longest)


@pytest.mark.parametrize("same_clock", [True, False])
def test_what_was_handed_over_stays_so_after_a_restart_and_is_still_confirmed(
    same_clock: bool,
) -> None:
    machine = restarted(handed_over(), T0 + 300 * MS, same_clock=same_clock)
    assert isinstance(machine.state, HandedOver) and not machine.responsible
    assert machine.step(Heard(ACCEPT), T0 + 400 * MS) == (
        Send(Confirm(7, 1, 3, 99, T0 + 400 * MS, ME)),
    )


@pytest.mark.parametrize("make", [offering, verifying, awaiting, handed_over])
def test_a_restored_state_is_written_down_as_it_was(make: Callable[[], SenderMachine]) -> None:
    kept = record(make().state)
    assert record(restored(CONFIG, kept, T0 + 1)) == kept


@pytest.mark.parametrize("make", [verifying, handed_over])
def test_after_a_new_mission_nothing_is_its_own_and_no_restart_makes_it_so(
    make: Callable[[], SenderMachine],
) -> None:
    machine = make()
    machine.step(Tick(), T0 + 60 * S)
    released = (Release(),) if machine.responsible else ()
    assert machine.step(NewMission(), T0 + 61 * S) == (*released, Persist(SenderRecord(1, "idle")))
    machine = restarted(machine, T0 + 62 * S)
    assert not machine.responsible and machine.live is None
    offered = machine.step(Offer(7, 3), T0 + 63 * S)
    assert offered == (Persist(SenderRecord(2, "mine")), TakeResponsibility())


def test_epochs_do_not_wrap() -> None:
    machine = SenderMachine(CONFIG, Keeping(65534))
    assert machine.step(Offer(7, 3), T0) == (Refused(Refusal.EPOCHS_EXHAUSTED),)
    machine = SenderMachine(CONFIG, Keeping(65533))
    machine.step(Offer(7, 3), T0)
    machine.step(Heard(replace(CANDIDATE, epoch=65534)), T0)
    machine.step(replace(AGREED, epoch=65534), T0)
    assert Persist(SenderRecord(65535, "mine")) in machine.step(Tick(), TAKE_BACK)
    machine.step(VerifyAgain(), TAKE_BACK)
    assert machine.step(replace(AGREED, epoch=65535), TAKE_BACK) == (
        Refused(Refusal.EPOCHS_EXHAUSTED),
    )
    assert machine.responsible


@pytest.mark.parametrize(
    "changes", [{"lease_s": 0.1}, {"retry_s": 0.0}, {"handoff_s": float("nan")}]
)
def test_a_config_that_cannot_work_is_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(changes))):
        replace(CONFIG, **changes)


def test_an_orphan_is_told_of_once() -> None:
    machine, abort = handed_over(), Heard(Abort(7, 1, AbortReason.TIMEOUT, 5, ME))
    assert machine.step(abort, T0 + 2) == (Settled(HandoffOutcome.ORPHANED),)
    assert machine.step(abort, T0 + 3) == ()


@pytest.mark.parametrize(
    "word", [AbortRequested(AbortReason.PILOT), Heard(Abort(7, 1, AbortReason.PILOT, 5, ME))]
)
def test_a_withdrawal_is_written_down_before_anything_is_said_of_it(
    word: AbortRequested | Heard,
) -> None:
    machine = awaiting()
    actions = machine.step(word, T0 + 1)
    assert isinstance(actions[0], Persist) and isinstance(actions[0].record, SenderRecord)
    assert actions[0].record.withdrawn is AbortReason.PILOT
    told = (
        (Send(Abort(7, 1, AbortReason.PILOT, T0 + 1, ME)),)
        if isinstance(word, AbortRequested)
        else ()
    )
    assert actions[1:] == told
    # the first word counts
    assert machine.step(Heard(Abort(7, 1, AbortReason.GUARD, 6, ME)), T0 + 2) == ()


def test_a_new_mission_within_a_lease_is_none() -> None:
    machine = awaiting()
    before = machine.state
    assert machine.step(NewMission(), T0 + 1) == (Refused(Refusal.WRONG_STATE),)
    assert machine.state == before and machine.wake_ns is not None


def test_an_attempt_is_the_same_before_and_after_its_commit() -> None:
    assert LIVE.follows(None) and LIVE.follows(replace(LIVE, epoch=2)) and not LIVE.follows(OPEN)


def test_nothing_is_promised_at_the_very_end_of_a_lease() -> None:
    """A program that wakes at the last instant: a COMMIT sent then could only be taken too late."""
    machine = awaiting()
    assert machine.step(Tick(), T0 + S) == () and isinstance(machine.state, AwaitingAccept)
    assert machine.wake_ns == TAKE_BACK
    in_time = awaiting()
    assert [type(action) for action in in_time.step(Tick(), T0 + S - 1)] == [Send]


@pytest.mark.parametrize("make", [offering, verifying])
def test_an_accept_before_any_commit_is_refused(make: Callable[[], SenderMachine]) -> None:
    machine = make()
    before = machine.state
    assert machine.step(Heard(replace(ACCEPT, instance=0)), T0) == (Refused(Refusal.WRONG_STATE),)
    assert machine.state == before and machine.responsible


def test_the_instants_of_a_word_that_counts() -> None:
    """One from the lease's own last instant says nothing of what came after it."""
    for stamp_ns, settles in ((TAKE_BACK, False), (TAKE_BACK + 1, True)):
        machine = handed_over()
        assert bool(machine.step(PeerStatus(True, stamp_ns, ME), T0 + 1500 * MS)) is settles


def test_clocks_may_be_as_uncertain_as_is_allowed_and_no_more() -> None:
    most = round(CONFIG.max_uncertainty_s * 1e9)
    for uncertainty_ns, commits in ((most, True), (most + 1, False)):
        machine = verifying()
        machine.step(replace(AGREED, uncertainty_ns=uncertainty_ns), T0)
        assert isinstance(machine.state, AwaitingAccept) is commits


@pytest.mark.parametrize(
    "field", ["offer_s", "handoff_s", "lease_s", "retry_s", "settle_s", "max_uncertainty_s"]
)
def test_no_deadline_is_nothing_and_only_the_guard_may_be(field: str) -> None:
    for value in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=field):
            ProtocolConfig(**{field: value})
    assert ProtocolConfig(guard_s=0.0).guard_s == 0.0
    for value in (-0.01, float("nan")):
        with pytest.raises(ValueError, match="guard_s"):
            ProtocolConfig(guard_s=value)


def test_something_must_be_left_of_a_lease() -> None:
    ProtocolConfig(lease_s=1.0, max_uncertainty_s=0.5, guard_s=0.499)
    with pytest.raises(ValueError, match="nothing would be left"):
        ProtocolConfig(lease_s=1.0, max_uncertainty_s=0.5, guard_s=0.5)


def test_an_attempt_is_the_same_to_whichever_receiver_it_is_committed() -> None:
    for before, after in ((OPEN, LIVE), (LIVE, OPEN), (LIVE, replace(LIVE, instance=OTHER))):
        assert not after.follows(before)
    for other in (replace(OPEN, epoch=2), replace(OPEN, handoff_id=8), replace(OPEN, target_id=4)):
        assert other.follows(LIVE) and LIVE.follows(other)
    assert OPEN.follows(None)
