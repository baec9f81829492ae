"""The sender's side of the hand-over: release, commit, and take back only when nobody accepted."""

from __future__ import annotations

from dataclasses import replace

from path.messages import Abort, AbortReason, Accept, Candidate, Commit, Confirm
from path.protocol.values import (
    LAST_EPOCH,
    AbortRequested,
    Actions,
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
    SenderEvent,
    SenderRecord,
    Settled,
    TakeResponsibility,
    Tick,
    VerifyAgain,
    is_abort_of,
    mismatch,
    to_ns,
)
from path.values import frozen


@frozen
class Idle:
    """Nothing is this drone's: before its first offer, and when a new mission has begun.

    ``epoch`` is the last one.
    """

    epoch: int = 0


@frozen
class Keeping:
    """Responsible, and no handoff: the last one ended before its COMMIT.

    ``epoch`` is the last one used.
    """

    epoch: int


@frozen
class Offering:
    """Responsible; nobody has answered yet."""

    live: Handoff
    offer_end_ns: int
    end_ns: int


@frozen
class Verifying:
    """Responsible; candidates come in."""

    live: Handoff
    end_ns: int


@frozen
class AwaitingAccept:
    """Released. COMMIT is repeated until the lease ends.

    Unless the handoff was aborted since (``withdrawn``).
    """

    live: Handoff
    commit: Commit
    resend_ns: int
    take_back_ns: int
    withdrawn: AbortReason | None = None


@frozen
class HandedOver:
    """Accepted. Never takes back by itself.

    ``settled`` once it is known, or too late to know, what became of it.
    """

    live: Handoff
    nonce: int
    sure_ns: int  # from here on the receiver holds for good or not at all
    settle_end_ns: int
    settled: HandoffOutcome | None = None


@frozen
class TakenBack:
    """Responsible again, in a new epoch. Ends here unless told to verify again."""

    live: Handoff


SenderState = Idle | Keeping | Offering | Verifying | AwaitingAccept | HandedOver | TakenBack
Step = tuple[SenderState, Actions]


def is_responsible(state: SenderState) -> bool:
    return not isinstance(state, Idle | AwaitingAccept | HandedOver)


def epoch(state: SenderState) -> int:
    """The last one used (S2)."""
    return state.epoch if isinstance(state, Idle | Keeping) else state.live.epoch


def record(state: SenderState) -> SenderRecord:
    """Return what is to be written down of a state."""
    match state:
        case Idle():
            return SenderRecord(state.epoch)
        case Keeping():
            return SenderRecord(state.epoch, "mine")
        case Offering() | Verifying() | TakenBack():
            return SenderRecord(state.live.epoch, "mine")
        case AwaitingAccept():
            commit = state.commit
            return SenderRecord(
                state.live.epoch, "released", state.live, commit.nonce, commit.lease_end_ns, state.take_back_ns,
                state.withdrawn,
            )  # fmt: skip
        case HandedOver():
            return SenderRecord(
                state.live.epoch, "handed_over", state.live, state.nonce, 0, state.sure_ns
            )


def restored(
    config: ProtocolConfig, kept: SenderRecord, now_ns: int, *, same_clock: bool = True
) -> SenderState:
    """The state after a restart, to be written down before anything else is done.

    What was committed and not accepted was never confirmed, so nobody can hold it for good: it is
    taken back after the lease as without the restart. What was accepted stays handed over.

    Args:
        same_clock: the record's instants are of the clock that runs now; after a reboot they are
            not, and everything is waited for as if it had begun just now.
    """
    if kept.live is None:
        return Keeping(kept.epoch) if kept.duty == "mine" else Idle(kept.epoch)
    longest_ns = now_ns + to_ns(config.lease_s) + to_ns(config.max_uncertainty_s)
    take_back_ns = kept.take_back_ns if same_clock else longest_ns
    if kept.duty == "handed_over":
        return HandedOver(
            kept.live, kept.nonce, take_back_ns, max(take_back_ns, now_ns) + to_ns(config.settle_s)
        )
    live = kept.live
    # never again promised: it may be over
    lease_end_ns = kept.lease_end_ns if same_clock else now_ns
    commit = Commit(
        live.handoff_id, live.epoch, live.target_id, kept.nonce, lease_end_ns, now_ns, live.instance
    )
    return AwaitingAccept(live, commit, now_ns, take_back_ns, kept.withdrawn)


def wake_ns(state: SenderState) -> int | None:
    """Return when the next Tick is due, own clock; None when time changes nothing."""
    match state:
        case Offering() | Verifying():
            return _deadline_ns(state)
        case AwaitingAccept():
            return (
                state.take_back_ns if _silent(state) else min(state.resend_ns, state.take_back_ns)
            )
        case HandedOver():
            return state.settle_end_ns if state.settled is None else None
        case Idle() | Keeping() | TakenBack():
            return None


def step(config: ProtocolConfig, state: SenderState, event: SenderEvent, now_ns: int) -> Step:
    """Take one event at one instant of the own clock, which never goes back.

    What time alone has brought about comes first.
    """
    state, due = _elapse(config, state, now_ns)
    if isinstance(event, Tick):
        return state, due
    state, actions = _react(config, state, event, now_ns)
    return state, due + actions


def _deadline_ns(state: Offering | Verifying) -> int:
    return min(state.offer_end_ns, state.end_ns) if isinstance(state, Offering) else state.end_ns


def _silent(state: AwaitingAccept) -> bool:
    """No COMMIT any more: withdrawn, or the next one would come after the lease's end."""
    return state.withdrawn is not None or state.resend_ns >= state.commit.lease_end_ns


def _elapse(config: ProtocolConfig, state: SenderState, now_ns: int) -> Step:
    match state:
        case Offering() | Verifying() if now_ns >= _deadline_ns(state):
            abort = _abort(state.live, AbortReason.TIMEOUT, now_ns)
            return Keeping(state.live.epoch), (Send(abort), Ended(HandoffOutcome.TIMEOUT))
        case AwaitingAccept() if now_ns >= state.take_back_ns:
            return _take_back(state)
        case AwaitingAccept() if not _silent(state) and state.resend_ns <= now_ns:
            if now_ns >= state.commit.lease_end_ns:  # noticed too late to say it once more
                return replace(state, resend_ns=state.commit.lease_end_ns), ()
            again = replace(state.commit, stamp_ns=now_ns)
            return replace(state, resend_ns=now_ns + to_ns(config.retry_s)), (Send(again),)
        case HandedOver() if state.settled is None and now_ns >= state.settle_end_ns:
            return _settle(state, HandoffOutcome.UNCONFIRMED)
        case _:
            return state, ()


def _take_back(state: AwaitingAccept) -> Step:
    live = replace(state.live, epoch=state.live.epoch + 1, instance=0)
    # A receiver that let go at the lease's end says so with TIMEOUT: that is no abort but the lease
    # running out.
    ran_out = state.withdrawn in (None, AbortReason.TIMEOUT)
    outcome = HandoffOutcome.TAKEN_BACK if ran_out else HandoffOutcome.ABORTED
    after = TakenBack(live)
    return after, (Persist(record(after)), TakeResponsibility(), Ended(outcome, state.withdrawn))


def _react(config: ProtocolConfig, state: SenderState, event: SenderEvent, now_ns: int) -> Step:  # noqa: PLR0911
    match state, event:
        case Idle() | Keeping() | TakenBack(), Offer():
            return _offer(config, state, event, now_ns)
        case Idle() | Keeping() | TakenBack() | HandedOver(), NewMission():
            anew = Idle(epoch(state))
            before: Actions = (Release(),) if is_responsible(state) else ()
            return anew, (*before, Persist(record(anew)))
        case TakenBack(), VerifyAgain():
            return Verifying(state.live, now_ns + to_ns(config.handoff_s)), ()
        case Offering() | Verifying() | AwaitingAccept() | HandedOver(), Heard():
            return _hear(config, state, event, now_ns)
        case Offering() | Verifying(), AbortRequested():
            return _give_up(state, event.reason, now_ns)
        case AwaitingAccept(), AbortRequested():
            withdrawn = replace(state, withdrawn=state.withdrawn or event.reason)
            return withdrawn, (
                Persist(record(withdrawn)),
                Send(_abort(state.live, event.reason, now_ns)),
            )
        case Verifying(), AgreementComplete():
            return _commit(config, state, event, now_ns)
        case HandedOver(settled=None | HandoffOutcome.UNCONFIRMED), PeerStatus() if _tells(
            state, event
        ):
            return _settle(
                state, HandoffOutcome.HANDED_OVER if event.responsible else HandoffOutcome.ORPHANED
            )
        case _, PeerStatus():
            return state, ()
        case _:
            return state, (Refused(Refusal.WRONG_STATE),)


def _offer(
    config: ProtocolConfig, state: Idle | Keeping | TakenBack, offer: Offer, now_ns: int
) -> Step:
    following = epoch(state) + 1
    if following >= LAST_EPOCH:  # one more is kept for taking back
        return state, (Refused(Refusal.EPOCHS_EXHAUSTED),)
    live = Handoff(offer.handoff_id, following, offer.target_id)
    offering = Offering(live, now_ns + to_ns(config.offer_s), now_ns + to_ns(config.handoff_s))
    take: Actions = () if is_responsible(state) else (TakeResponsibility(),)
    return offering, (Persist(record(offering)), *take)


def _commit(
    config: ProtocolConfig, state: Verifying, agreed: AgreementComplete, now_ns: int
) -> Step:
    """Release first, then say so; only after the full agreement (S4, S5).

    On the one target of the one epoch.
    """
    why: Refusal | None = None
    if agreed.epoch != state.live.epoch:
        why = Refusal.LOWER_EPOCH if agreed.epoch < state.live.epoch else Refusal.UNKNOWN_EPOCH
    elif agreed.target_id != state.live.target_id:
        why = Refusal.WRONG_TARGET
    elif agreed.uncertainty_ns is None or agreed.uncertainty_ns > to_ns(config.max_uncertainty_s):
        why = Refusal.NO_CLOCK
    elif agreed.instance is None:
        why = Refusal.NOT_ONE_RECEIVER
    elif state.live.epoch >= LAST_EPOCH:
        why = Refusal.EPOCHS_EXHAUSTED
    if why is not None or agreed.uncertainty_ns is None or agreed.instance is None:
        return state, (Refused(why or Refusal.NO_CLOCK),)
    live = replace(state.live, instance=agreed.instance)
    lease_end = now_ns + to_ns(config.lease_s)
    commit = Commit(
        live.handoff_id, live.epoch, live.target_id, agreed.nonce, lease_end, now_ns, live.instance
    )
    awaiting = AwaitingAccept(
        live, commit, now_ns + to_ns(config.retry_s), lease_end + agreed.uncertainty_ns
    )
    return awaiting, (Persist(record(awaiting)), Release(), Send(commit))


def _give_up(state: Offering | Verifying, reason: AbortReason, now_ns: int) -> Step:
    """End an attempt before its commit: over at once, and still responsible."""
    return Keeping(state.live.epoch), (
        Send(_abort(state.live, reason, now_ns)),
        Ended(HandoffOutcome.ABORTED, reason),
    )


def _hear(  # noqa: PLR0911
    config: ProtocolConfig,
    state: Offering | Verifying | AwaitingAccept | HandedOver,
    event: Heard,
    now_ns: int,
) -> Step:
    message = event.message
    if isinstance(message, Abort):
        return _hear_abort(state, message)
    if not isinstance(message, Candidate | Accept):
        return state, (Refused(Refusal.WRONG_STATE),)
    why = mismatch(state.live, message)
    if why is not None:
        return state, (Refused(why),)
    match state, message:
        case Offering(), Candidate():
            return Verifying(state.live, state.end_ns), ()
        case _, Candidate():
            return state, ()
        case AwaitingAccept(), Accept():
            return _hear_accept(config, state, message, now_ns)
        case HandedOver(), Accept() if message.nonce == state.nonce:
            return state, (Send(_confirm(state.live, state.nonce, now_ns)),)
        case HandedOver(), Accept():
            return state, (Refused(Refusal.WRONG_NONCE),)
        case _:
            return state, (Refused(Refusal.WRONG_STATE),)


def _hear_abort(state: Offering | Verifying | AwaitingAccept | HandedOver, abort: Abort) -> Step:
    if not is_abort_of(state.live, abort):
        return state, (Refused(Refusal.WRONG_HANDOFF),)
    match state:
        case Offering() | Verifying():
            return Keeping(state.live.epoch), (Ended(HandoffOutcome.ABORTED, abort.reason),)
        case AwaitingAccept():
            # Not yet responsible again: S4 waits for the lease's end, whatever the receiver says.
            withdrawn = replace(state, withdrawn=state.withdrawn or abort.reason)
            return withdrawn, () if withdrawn == state else (Persist(record(withdrawn)),)
        case HandedOver() if abort.instance != state.live.instance:
            return state, (Refused(Refusal.WRONG_INSTANCE),)  # it never had the target
        case HandedOver(settled=HandoffOutcome.ORPHANED):
            return state, ()
        case HandedOver():
            return _settle(state, HandoffOutcome.ORPHANED)


def _tells(state: HandedOver, status: PeerStatus) -> bool:
    """Return whether a Status tells what became of the hand-over.

    Of the receiver that accepted, once its lease is over.
    """
    return status.stamp_ns > state.sure_ns and status.instance == state.live.instance


def _settle(state: HandedOver, outcome: HandoffOutcome) -> Step:
    return replace(state, settled=outcome), (Settled(outcome),)


def _hear_accept(
    config: ProtocolConfig, state: AwaitingAccept, accept: Accept, now_ns: int
) -> Step:
    if accept.nonce != state.commit.nonce:
        return state, (Refused(Refusal.WRONG_NONCE),)
    if state.withdrawn is not None:
        # Nothing is transferred by an aborted handoff; say so again, the first word may be lost.
        return state, (Send(_abort(state.live, state.withdrawn, now_ns)),)
    settle_end = state.take_back_ns + to_ns(config.settle_s)
    handed_over = HandedOver(state.live, accept.nonce, state.take_back_ns, settle_end)
    confirm = Send(_confirm(state.live, accept.nonce, now_ns))
    return handed_over, (Persist(record(handed_over)), confirm, Ended(HandoffOutcome.HANDED_OVER))


def _abort(live: Handoff, reason: AbortReason, now_ns: int) -> Abort:
    return Abort(live.handoff_id, live.epoch, reason, now_ns, live.instance)


def _confirm(live: Handoff, nonce: int, now_ns: int) -> Confirm:
    return Confirm(live.handoff_id, live.epoch, live.target_id, nonce, now_ns, live.instance)


class SenderMachine:
    """``step`` with its state kept.

    Args:
        state: ``restored`` after a restart.
    """

    def __init__(
        self, config: ProtocolConfig | None = None, state: SenderState | None = None
    ) -> None:
        self.config = config or ProtocolConfig()
        self.state: SenderState = state or Idle()

    def step(self, event: SenderEvent, now_ns: int) -> Actions:
        self.state, actions = step(self.config, self.state, event, now_ns)
        return actions

    @property
    def live(self) -> Handoff | None:
        """The attempt that Targets are to carry; None when there is no handoff."""
        return None if isinstance(self.state, Idle | Keeping) else self.state.live

    @property
    def responsible(self) -> bool:
        return is_responsible(self.state)

    @property
    def wake_ns(self) -> int | None:
        return wake_ns(self.state)
