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
            return SenderRecord(
                epoch=state.live.epoch,
                duty="released",
                live=state.live,
                nonce=state.commit.nonce,
                lease_end_ns=state.commit.lease_end_ns,
                take_back_ns=state.take_back_ns,
                withdrawn=state.withdrawn,
            )
        case HandedOver():
            return SenderRecord(
                epoch=state.live.epoch,
                duty="handed_over",
                live=state.live,
                nonce=state.nonce,
                take_back_ns=state.sure_ns,
            )


def restored(
    config: ProtocolConfig,
    kept: SenderRecord,
    now_ns: int,
    *,
    same_clock: bool = True,
) -> SenderState:
    """The state after a restart, to be written down before anything else is done.

    What was committed and not accepted was never confirmed, so nobody can hold it for good: it is
    taken back after the lease as without the restart. What was accepted stays handed over.

    Args:
        same_clock: the record's instants are of the clock that runs now; after a reboot they are
            not, and everything is waited for as if it had begun just now.
    """
    live = kept.live
    if live is None:
        return Keeping(kept.epoch) if kept.duty == "mine" else Idle(kept.epoch)

    if same_clock:
        take_back_ns = kept.take_back_ns
        lease_end_ns = kept.lease_end_ns
    else:
        # As if committed just now, and never again promised: the lease may be over.
        take_back_ns = now_ns + to_ns(config.lease_s) + to_ns(config.max_uncertainty_s)
        lease_end_ns = now_ns

    if kept.duty == "handed_over":
        settle_end_ns = max(take_back_ns, now_ns) + to_ns(config.settle_s)
        return HandedOver(live, kept.nonce, sure_ns=take_back_ns, settle_end_ns=settle_end_ns)
    commit = _commit_to(live, kept.nonce, lease_end_ns, now_ns)
    return AwaitingAccept(
        live,
        commit,
        resend_ns=now_ns,
        take_back_ns=take_back_ns,
        withdrawn=kept.withdrawn,
    )


def wake_ns(state: SenderState) -> int | None:
    """Return when the next Tick is due, own clock; None when time changes nothing."""
    match state:
        case Offering() | Verifying():
            return _deadline_ns(state)
        case AwaitingAccept() if _silent(state):
            return state.take_back_ns
        case AwaitingAccept():
            return min(state.resend_ns, state.take_back_ns)
        case HandedOver():
            return state.settle_end_ns if state.settled is None else None
        case Idle() | Keeping() | TakenBack():
            return None


def step(
    config: ProtocolConfig,
    state: SenderState,
    event: SenderEvent,
    now_ns: int,
) -> Step:
    """Take one event at one instant of the own clock, which never goes back.

    What time alone has brought about comes first.
    """
    state, due = _elapse(config, state, now_ns)
    if isinstance(event, Tick):
        return state, due
    state, actions = _react(config, state, event, now_ns)
    return state, due + actions


def _deadline_ns(state: Offering | Verifying) -> int:
    if isinstance(state, Offering):
        return min(state.offer_end_ns, state.end_ns)
    return state.end_ns


def _silent(state: AwaitingAccept) -> bool:
    """No COMMIT any more: withdrawn, or the next one would come after the lease's end."""
    return state.withdrawn is not None or state.resend_ns >= state.commit.lease_end_ns


def _elapse(
    config: ProtocolConfig,
    state: SenderState,
    now_ns: int,
) -> Step:
    match state:
        case Offering() | Verifying() if now_ns >= _deadline_ns(state):
            abort = _abort(state.live, AbortReason.TIMEOUT, now_ns)
            ended = Ended(HandoffOutcome.TIMEOUT)
            return Keeping(state.live.epoch), (Send(abort), ended)
        case AwaitingAccept() if now_ns >= state.take_back_ns:
            return _take_back(state)
        case AwaitingAccept() if not _silent(state) and state.resend_ns <= now_ns:
            lease_end_ns = state.commit.lease_end_ns
            if now_ns >= lease_end_ns:
                # Noticed too late to say it once more.
                return replace(state, resend_ns=lease_end_ns), ()
            again = replace(state.commit, stamp_ns=now_ns)
            resend_ns = now_ns + to_ns(config.retry_s)
            return replace(state, resend_ns=resend_ns), (Send(again),)
        case HandedOver() if state.settled is None and now_ns >= state.settle_end_ns:
            return _settle(state, HandoffOutcome.UNCONFIRMED)
        case _:
            return state, ()


def _take_back(state: AwaitingAccept) -> Step:
    following = state.live.epoch + 1
    after = TakenBack(replace(state.live, epoch=following, instance=0))
    # A receiver that let go at the lease's end says so with TIMEOUT: that is no abort but the lease
    # running out.
    ran_out = state.withdrawn in (None, AbortReason.TIMEOUT)
    outcome = HandoffOutcome.TAKEN_BACK if ran_out else HandoffOutcome.ABORTED
    return after, (
        Persist(record(after)),
        TakeResponsibility(),
        Ended(outcome, state.withdrawn),
    )


def _react(  # noqa: PLR0911
    config: ProtocolConfig,
    state: SenderState,
    event: SenderEvent,
    now_ns: int,
) -> Step:
    match state, event:
        case Idle() | Keeping() | TakenBack(), Offer():
            return _offer(config, state, event, now_ns)
        case Idle() | Keeping() | TakenBack() | HandedOver(), NewMission():
            anew = Idle(epoch(state))
            before: Actions = (Release(),) if is_responsible(state) else ()
            return anew, (*before, Persist(record(anew)))
        case TakenBack(), VerifyAgain():
            end_ns = now_ns + to_ns(config.handoff_s)
            return Verifying(state.live, end_ns), ()
        case Offering() | Verifying() | AwaitingAccept() | HandedOver(), Heard():
            return _hear(config, state, event, now_ns)
        case Offering() | Verifying(), AbortRequested():
            return _give_up(state, event.reason, now_ns)
        case AwaitingAccept(), AbortRequested():
            withdrawn = replace(state, withdrawn=state.withdrawn or event.reason)
            abort = _abort(state.live, event.reason, now_ns)
            return withdrawn, (Persist(record(withdrawn)), Send(abort))
        case Verifying(), AgreementComplete():
            return _commit(config, state, event, now_ns)
        case HandedOver(settled=None | HandoffOutcome.UNCONFIRMED), PeerStatus() if _tells(
            state,
            event,
        ):
            holds = event.responsible
            outcome = HandoffOutcome.HANDED_OVER if holds else HandoffOutcome.ORPHANED
            return _settle(state, outcome)
        case _, PeerStatus():
            return state, ()
        case _:
            return state, (Refused(Refusal.WRONG_STATE),)


def _offer(
    config: ProtocolConfig,
    state: Idle | Keeping | TakenBack,
    offer: Offer,
    now_ns: int,
) -> Step:
    following = epoch(state) + 1
    if following >= LAST_EPOCH:
        # One more is kept for taking back.
        return state, (Refused(Refusal.EPOCHS_EXHAUSTED),)
    offering = Offering(
        Handoff(offer.handoff_id, following, offer.target_id),
        offer_end_ns=now_ns + to_ns(config.offer_s),
        end_ns=now_ns + to_ns(config.handoff_s),
    )
    written = Persist(record(offering))
    if is_responsible(state):
        return offering, (written,)
    return offering, (written, TakeResponsibility())


def _commit(  # noqa: PLR0911
    config: ProtocolConfig,
    state: Verifying,
    agreed: AgreementComplete,
    now_ns: int,
) -> Step:
    """Release first, then say so; only after the full agreement (S4, S5).

    On the one target of the one epoch.
    """
    live = state.live
    uncertainty_ns = agreed.uncertainty_ns
    if agreed.epoch < live.epoch:
        return state, (Refused(Refusal.LOWER_EPOCH),)
    if agreed.epoch > live.epoch:
        return state, (Refused(Refusal.UNKNOWN_EPOCH),)
    if agreed.target_id != live.target_id:
        return state, (Refused(Refusal.WRONG_TARGET),)
    if uncertainty_ns is None or uncertainty_ns > to_ns(config.max_uncertainty_s):
        return state, (Refused(Refusal.NO_CLOCK),)
    if agreed.instance is None:
        return state, (Refused(Refusal.NOT_ONE_RECEIVER),)
    if live.epoch >= LAST_EPOCH:
        return state, (Refused(Refusal.EPOCHS_EXHAUSTED),)

    lease_end_ns = now_ns + to_ns(config.lease_s)
    committed = replace(live, instance=agreed.instance)
    commit = _commit_to(committed, agreed.nonce, lease_end_ns, now_ns)
    awaiting = AwaitingAccept(
        committed,
        commit,
        resend_ns=now_ns + to_ns(config.retry_s),
        take_back_ns=lease_end_ns + uncertainty_ns,
    )
    return awaiting, (
        Persist(record(awaiting)),
        Release(),
        Send(commit),
    )


def _give_up(
    state: Offering | Verifying,
    reason: AbortReason,
    now_ns: int,
) -> Step:
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
    config: ProtocolConfig,
    state: AwaitingAccept,
    accept: Accept,
    now_ns: int,
) -> Step:
    if accept.nonce != state.commit.nonce:
        return state, (Refused(Refusal.WRONG_NONCE),)
    if state.withdrawn is not None:
        # Nothing is transferred by an aborted handoff; say so again, the first word may be lost.
        return state, (Send(_abort(state.live, state.withdrawn, now_ns)),)
    handed_over = HandedOver(
        state.live,
        accept.nonce,
        sure_ns=state.take_back_ns,
        settle_end_ns=state.take_back_ns + to_ns(config.settle_s),
    )
    return handed_over, (
        Persist(record(handed_over)),
        Send(_confirm(state.live, accept.nonce, now_ns)),
        Ended(HandoffOutcome.HANDED_OVER),
    )


def _abort(
    live: Handoff,
    reason: AbortReason,
    now_ns: int,
) -> Abort:
    return Abort(
        handoff_id=live.handoff_id,
        epoch=live.epoch,
        reason=reason,
        stamp_ns=now_ns,
        instance=live.instance,
    )


def _confirm(
    live: Handoff,
    nonce: int,
    now_ns: int,
) -> Confirm:
    return Confirm(
        handoff_id=live.handoff_id,
        epoch=live.epoch,
        target_id=live.target_id,
        nonce=nonce,
        stamp_ns=now_ns,
        instance=live.instance,
    )


def _commit_to(
    live: Handoff,
    nonce: int,
    lease_end_ns: int,
    now_ns: int,
) -> Commit:
    return Commit(
        handoff_id=live.handoff_id,
        epoch=live.epoch,
        target_id=live.target_id,
        nonce=nonce,
        lease_end_ns=lease_end_ns,
        stamp_ns=now_ns,
        instance=live.instance,
    )


class SenderMachine:
    """``step`` with its state kept.

    Args:
        state: ``restored`` after a restart.
    """

    def __init__(
        self,
        config: ProtocolConfig | None = None,
        state: SenderState | None = None,
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
