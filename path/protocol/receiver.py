"""The receiver's side of the hand-over: observe, hold provisionally within a lease, then for good
or not at all.
"""

from __future__ import annotations

from dataclasses import replace

from path.messages import Abort, AbortReason, Accept, Confirm, Target
from path.protocol.values import (
    AbortRequested,
    Actions,
    CommitHeard,
    Ended,
    Handoff,
    HandoffOutcome,
    Heard,
    NewMission,
    PeerStatus,
    Persist,
    ProtocolConfig,
    ReceiverEvent,
    ReceiverRecord,
    Refusal,
    Refused,
    Release,
    Send,
    Settled,
    TakeResponsibility,
    Tick,
    is_abort_of,
    mismatch,
    to_ns,
)
from path.values import frozen


@frozen
class Observing:
    """The receiver is not responsible.

    ``floor`` is the lowest epoch still taken, ``live`` its attempt, until ``end_ns``.
    """

    floor: int = 0
    live: Handoff | None = None
    end_ns: int = 0


@frozen
class Provisional:
    """Responsible before ``lease_end_ns``; ACCEPT is repeated.

    The end is of the own clock, already reduced by uncertainty and guard.
    """

    live: Handoff
    nonce: int
    lease_end_ns: int
    resend_ns: int
    sure_ns: int  # from here on the sender has taken back, or never will


@frozen
class Holding:
    """Responsible for good."""

    live: Handoff
    nonce: int


@frozen
class LetGo:
    """Observing again, after it had accepted.

    ``settled`` once it is known, or too late to know, who is responsible.
    """

    live: Handoff
    nonce: int
    sure_ns: int
    settle_end_ns: int
    settled: HandoffOutcome | None = None


ReceiverState = Observing | Provisional | Holding | LetGo
Step = tuple[ReceiverState, Actions]


def claim(state: ReceiverState) -> TakeResponsibility | None:
    """Return the claim by which a state is responsible; None when it is not."""
    match state:
        case Provisional():
            return TakeResponsibility(state.lease_end_ns)
        case Holding():
            return TakeResponsibility()
        case Observing() | LetGo():
            return None


def is_responsible(state: ReceiverState, now_ns: int) -> bool:
    """Return whether it is responsible at this instant, told of the instant or not."""
    held = claim(state)
    return held is not None and held.at(now_ns)


def floor(state: ReceiverState) -> int:
    """The lowest epoch still taken (S2)."""
    match state:
        case Observing():
            return state.floor
        case Provisional() | Holding():
            return state.live.epoch
        case LetGo():
            return state.live.epoch + 1


def record(state: ReceiverState) -> ReceiverRecord:
    """Return what is to be written down of a state."""
    match state:
        case Observing():
            return ReceiverRecord(state.floor)
        case Provisional():
            return ReceiverRecord(
                floor(state),
                "provisional",
                state.live,
                state.nonce,
                state.lease_end_ns,
                state.sure_ns,
            )
        case Holding():
            return ReceiverRecord(floor(state), "holding", state.live, state.nonce)
        case LetGo():
            return ReceiverRecord(floor(state), "let_go", state.live, state.nonce, 0, state.sure_ns)


def restored(
    config: ProtocolConfig, kept: ReceiverRecord, now_ns: int, *, same_clock: bool = True
) -> ReceiverState:
    """The state after a restart, to be written down before anything else is done.

    What was held for good still is; a lease that is over, or may be, is let go.

    Args:
        same_clock: the record's instants are of the clock that runs now; after a reboot they are
            not.
    """
    if kept.live is None:
        return Observing(kept.epoch)
    if kept.duty == "holding":
        return Holding(kept.live, kept.nonce)
    if kept.duty == "provisional" and same_clock and now_ns < kept.lease_end_ns:
        return Provisional(kept.live, kept.nonce, kept.lease_end_ns, now_ns, kept.sure_ns)
    longest_ns = (
        now_ns + to_ns(config.lease_s) + 2 * to_ns(config.max_uncertainty_s) + to_ns(config.guard_s)
    )
    sure_ns = kept.sure_ns if same_clock else longest_ns
    return LetGo(kept.live, kept.nonce, sure_ns, max(sure_ns, now_ns) + to_ns(config.settle_s))


def wake_ns(state: ReceiverState) -> int | None:
    """Return when the next Tick is due, own clock; None when time changes nothing."""
    match state:
        case Observing():
            return None if state.live is None else state.end_ns
        case Provisional():
            return min(state.resend_ns, state.lease_end_ns)
        case Holding():
            return None
        case LetGo():
            return state.settle_end_ns if state.settled is None else None


def step(config: ProtocolConfig, state: ReceiverState, event: ReceiverEvent, now_ns: int) -> Step:
    """Take one event at one instant of the own clock, which never goes back.

    What time alone has brought about comes first.
    """
    state, due = _elapse(config, state, now_ns)
    if isinstance(event, Tick):
        return state, due
    state, actions = _react(config, state, event, now_ns)
    return state, due + actions


def _elapse(config: ProtocolConfig, state: ReceiverState, now_ns: int) -> Step:
    match state:
        case Observing(live=Handoff() as live) if now_ns >= state.end_ns:
            after, actions = _spend(live)
            return after, (
                *actions,
                Send(_abort(live, AbortReason.TIMEOUT, now_ns)),
                Ended(HandoffOutcome.TIMEOUT),
            )
        case Provisional() if now_ns >= state.lease_end_ns:
            return _let_go(config, state, AbortReason.TIMEOUT, Ended(HandoffOutcome.LET_GO), now_ns)
        case Provisional() if now_ns >= state.resend_ns:
            again = replace(state, resend_ns=now_ns + to_ns(config.retry_s))
            return again, (Send(_accept(state, now_ns)),)
        case LetGo(settled=None) if now_ns >= state.settle_end_ns:
            return _settle(state, HandoffOutcome.UNCONFIRMED)
        case _:
            return state, ()


def _react(config: ProtocolConfig, state: ReceiverState, event: ReceiverEvent, now_ns: int) -> Step:  # noqa: PLR0911
    match event:
        case Heard(Target() as target):
            return _hear_target(config, state, target, now_ns)
        case Heard(Confirm() as confirm):
            return _hear_confirm(state, confirm, now_ns)
        case Heard(Abort() as abort):
            return _hear_abort(state, abort)
        case CommitHeard():
            return _hear_commit(config, state, event, now_ns)
        case AbortRequested():
            return _abort_requested(config, state, event.reason, now_ns)
        case PeerStatus():
            return _hear_status(state, event)
        case NewMission():
            return _begin_anew(state)
        case _:
            return state, (Refused(Refusal.WRONG_STATE),)


def _hear_target(config: ProtocolConfig, state: ReceiverState, target: Target, now_ns: int) -> Step:
    """Take in the sender's Target: it names the live attempt.

    A higher epoch beats whatever was: nobody but the sender can have one.
    """
    live = state.live
    if live is not None and target.epoch == live.epoch and not isinstance(state, LetGo):
        why = mismatch(live, target)
        return state, () if why is None else (Refused(why),)
    if target.epoch < floor(state):
        return state, (Refused(Refusal.LOWER_EPOCH),)
    before: Actions = ()
    if isinstance(state, Provisional | Holding):
        before = (Release(), Ended(HandoffOutcome.SUPERSEDED))
    elif isinstance(state, LetGo) and state.settled is not HandoffOutcome.TAKEN_BACK:
        before = (Settled(HandoffOutcome.TAKEN_BACK),)
    live = Handoff(target.handoff_id, target.epoch, target.target_id)
    end_ns = now_ns + to_ns(config.handoff_s) + to_ns(config.lease_s)
    after = Observing(live.epoch, live, end_ns)
    return after, (*before, Persist(record(after)))


def _hear_commit(
    config: ProtocolConfig, state: ReceiverState, heard: CommitHeard, now_ns: int
) -> Step:
    """S3: only for the live epoch, its one nonce and this very receiver, before the lease's end."""
    why = _commit_refusal(config, state, heard, now_ns)
    if why is not None:
        return state, (Refused(why),)
    if isinstance(state, Provisional | Holding) or state.live is None or heard.lease_end_ns is None:
        return state, ()
    sure_ns = (
        heard.lease_end_ns
        + heard.uncertainty_ns
        + to_ns(config.max_uncertainty_s)
        + to_ns(config.guard_s)
    )
    held = Provisional(
        live=replace(state.live, instance=heard.instance),
        nonce=heard.commit.nonce,
        lease_end_ns=_lease_end_ns(config, heard.lease_end_ns, heard.uncertainty_ns),
        resend_ns=now_ns + to_ns(config.retry_s),
        sure_ns=sure_ns,
    )
    return held, (
        Persist(record(held)),
        TakeResponsibility(held.lease_end_ns),
        Send(_accept(held, now_ns)),
    )


def _commit_refusal(
    config: ProtocolConfig, state: ReceiverState, heard: CommitHeard, now_ns: int
) -> Refusal | None:
    commit = heard.commit
    if state.live is None:
        return Refusal.LOWER_EPOCH if commit.epoch < floor(state) else Refusal.UNKNOWN_EPOCH
    why = mismatch(replace(state.live, instance=heard.instance), commit)
    if why is None and isinstance(state, Provisional | Holding):
        return None if commit.nonce == state.nonce else Refusal.WRONG_NONCE
    if why is None:
        why = _lease_refusal(config, state, heard, now_ns)
    return why


def _lease_refusal(
    config: ProtocolConfig, state: ReceiverState, heard: CommitHeard, now_ns: int
) -> Refusal | None:
    if isinstance(state, LetGo):
        return Refusal.LEASE_OVER
    if heard.lease_end_ns is None or heard.uncertainty_ns > to_ns(config.max_uncertainty_s):
        return Refusal.NO_CLOCK
    if heard.lease_end_ns - now_ns > to_ns(config.lease_s) + heard.uncertainty_ns:
        return Refusal.LEASE_TOO_LONG
    if now_ns >= _lease_end_ns(config, heard.lease_end_ns, heard.uncertainty_ns):
        return Refusal.LEASE_OVER
    return None if heard.able else Refusal.NOT_ABLE


def _lease_end_ns(config: ProtocolConfig, lease_end_ns: int, uncertainty_ns: int) -> int:
    """The latest instant that is before the lease's end on any clock."""
    return lease_end_ns - uncertainty_ns - to_ns(config.guard_s)


def _hear_confirm(state: ReceiverState, confirm: Confirm, now_ns: int) -> Step:
    if isinstance(state, Observing):
        return state, (Refused(Refusal.WRONG_STATE),)
    why = mismatch(state.live, confirm)
    if why is None and confirm.nonce != state.nonce:
        why = Refusal.WRONG_NONCE
    if why is not None:
        return state, (Refused(why),)
    match state:
        case Provisional():
            holding = Holding(state.live, state.nonce)
            return holding, (
                Persist(record(holding)),
                TakeResponsibility(),
                Ended(HandoffOutcome.HANDED_OVER),
            )
        case Holding():
            return state, ()
        case LetGo():
            # Too late, and proof that the sender handed over. Tell it: it cannot know.
            tell = Send(_abort(state.live, AbortReason.TIMEOUT, now_ns))
            if state.settled is HandoffOutcome.ORPHANED:
                return state, (tell,)
            state, actions = _settle(state, HandoffOutcome.ORPHANED)
            return state, (tell, *actions)


def _hear_abort(state: ReceiverState, abort: Abort) -> Step:
    """The sender aborts only what it will never confirm, so letting go is safe at once."""
    if state.live is None or not is_abort_of(state.live, abort):
        return state, (Refused(Refusal.WRONG_HANDOFF),)
    match state:
        case Observing() | Provisional():
            before: Actions = (Release(),) if isinstance(state, Provisional) else ()
            after, actions = _spend(state.live)
            return after, (*before, *actions, Ended(HandoffOutcome.ABORTED, abort.reason))
        case Holding():
            return state, (Refused(Refusal.WRONG_STATE),)
        case LetGo():
            return state, ()


def _abort_requested(
    config: ProtocolConfig, state: ReceiverState, reason: AbortReason, now_ns: int
) -> Step:
    match state:
        case Observing(live=Handoff() as live):
            after, actions = _spend(live)
            return after, (
                *actions,
                Send(_abort(live, reason, now_ns)),
                Ended(HandoffOutcome.ABORTED, reason),
            )
        case Provisional():
            return _let_go(config, state, reason, Ended(HandoffOutcome.ABORTED, reason), now_ns)
        case Holding():
            end = now_ns + to_ns(config.settle_s)
            gone = LetGo(state.live, state.nonce, now_ns, end, settled=HandoffOutcome.ORPHANED)
            tell = Send(_abort(state.live, reason, now_ns))
            ended = (Ended(HandoffOutcome.ABORTED, reason), Settled(HandoffOutcome.ORPHANED))
            return gone, (Release(), Persist(record(gone)), tell, *ended)
        case _:
            return state, (Refused(Refusal.WRONG_STATE),)


def _hear_status(state: ReceiverState, status: PeerStatus) -> Step:
    match state:
        case LetGo(settled=None | HandoffOutcome.UNCONFIRMED) if status.stamp_ns > state.sure_ns:
            return _settle(
                state, HandoffOutcome.TAKEN_BACK if status.responsible else HandoffOutcome.ORPHANED
            )
        case _:
            return state, ()


def _begin_anew(state: ReceiverState) -> Step:
    if state.live is None:
        return state, ()
    if isinstance(state, Provisional):
        return state, (Refused(Refusal.WRONG_STATE),)
    after, actions = _spend(state.live)
    return after, (Release(), *actions) if isinstance(state, Holding) else actions


def _spend(live: Handoff) -> tuple[Observing, Actions]:
    """End an epoch: nothing more is taken in it, not even after a restart."""
    after = Observing(live.epoch + 1)
    return after, (Persist(record(after)),)


def _let_go(
    config: ProtocolConfig, state: Provisional, reason: AbortReason, ended: Ended, now_ns: int
) -> Step:
    gone = LetGo(state.live, state.nonce, state.sure_ns, state.sure_ns + to_ns(config.settle_s))
    tell = Send(_abort(state.live, reason, now_ns))
    return gone, (Release(), Persist(record(gone)), tell, ended)


def _settle(state: LetGo, outcome: HandoffOutcome) -> Step:
    return replace(state, settled=outcome), (Settled(outcome),)


def _accept(state: Provisional, now_ns: int) -> Accept:
    live = state.live
    return Accept(live.handoff_id, live.epoch, live.target_id, state.nonce, now_ns, live.instance)


def _abort(live: Handoff, reason: AbortReason, now_ns: int) -> Abort:
    return Abort(live.handoff_id, live.epoch, reason, now_ns, live.instance)


class ReceiverMachine:
    """``step`` with its state kept.

    Args:
        state: ``restored`` after a restart.
    """

    def __init__(
        self, config: ProtocolConfig | None = None, state: ReceiverState | None = None
    ) -> None:
        self.config = config or ProtocolConfig()
        self.state: ReceiverState = state or Observing()

    def step(self, event: ReceiverEvent, now_ns: int) -> Actions:
        self.state, actions = step(self.config, self.state, event, now_ns)
        return actions

    @property
    def live(self) -> Handoff | None:
        """Return the attempt that Candidates are to carry.

        None before the first Target of a handoff, and after its end.
        """
        return self.state.live

    def responsible(self, now_ns: int) -> bool:
        return is_responsible(self.state, now_ns)

    @property
    def wake_ns(self) -> int | None:
        return wake_ns(self.state)
