"""The rules of a machine's actions in their order: S2 to S5 of the hand-over, on one step."""

from __future__ import annotations

from path.messages import Commit
from path.protocol import receiver, sender
from path.protocol.values import (
    Actions,
    CommitHeard,
    NewMission,
    ReceiverEvent,
    Release,
    Send,
    SenderEvent,
    TakeResponsibility,
)
from path.values import frozen


@frozen
class Dead:
    """A program that does not run, and what is remembered of it: its epoch (S2), and whether it
    handed over (S4).
    """

    epoch: int
    handed_over: bool = False


def used_epoch(state: sender.SenderState | Dead) -> int:
    """The sender's last epoch."""
    return (
        state.epoch if isinstance(state, sender.Idle | sender.Keeping | Dead) else state.live.epoch
    )


def lowest_epoch(state: receiver.ReceiverState | Dead) -> int:
    """The lowest epoch that the receiver may still take. Not asked of the machine: it may be the
    one that is wrong.
    """
    if isinstance(state, Dead):
        return state.epoch
    if isinstance(state, receiver.Observing):
        return state.floor
    return state.live.epoch + isinstance(state, receiver.LetGo)


def sender_rules(
    before: sender.SenderState,
    after: sender.SenderState,
    event: SenderEvent,
    actions: Actions,
    uncertainty: int,
) -> str:
    """Return the first rule that a sender's step breaks; "" when it breaks none.

    S2: each attempt has an epoch of its own. S4: it releases before it says so, and takes back only
    after lease and uncertainty. L2: only a new mission makes nothing its own.
    """
    begins = isinstance(after, sender.Offering) and not isinstance(before, sender.Offering)
    if used_epoch(after) < used_epoch(before) + begins:
        return "S2"
    if (
        isinstance(after, sender.Idle)
        and not isinstance(before, sender.Idle)
        and not isinstance(event, NewMission)
    ):
        return "L2"
    responsible = sender.is_responsible(before)
    for action in actions:
        match action:
            case Release():
                responsible = False
            case TakeResponsibility():
                responsible = True
                if not (isinstance(before, sender.Idle) or _lease_over(before, uncertainty)):
                    return "S4"
            case Send(Commit()) if responsible:
                return "S4"
            case _:
                pass
    return "" if responsible == sender.is_responsible(after) else "S1"


def _lease_over(state: sender.SenderState, uncertainty: int) -> bool:
    return isinstance(state, sender.AwaitingAccept) and state.commit.lease_end_ns + uncertainty <= 0


def across_rules(
    was: sender.SenderState | Dead,
    now: sender.SenderState | Dead,
    held: receiver.ReceiverState | Dead,
    holds: receiver.ReceiverState | Dead,
) -> str:
    """S2: no epoch ever falls. S4: who handed over never takes back. Be it across a restart."""
    if used_epoch(now) < used_epoch(was) or lowest_epoch(holds) < lowest_epoch(held):
        return "S2"
    gave = was.handed_over if isinstance(was, Dead) else isinstance(was, sender.HandedOver)
    return "S4" if gave and responsible_sender(now) else ""


def responsible_sender(state: sender.SenderState | Dead) -> bool:
    return not isinstance(state, Dead) and sender.is_responsible(state)


def responsible_receiver(state: receiver.ReceiverState | Dead, now: int) -> bool:
    return not isinstance(state, Dead) and receiver.is_responsible(state, now)


def receiver_rules(
    before: receiver.ReceiverState, after: receiver.ReceiverState, event: ReceiverEvent, actions: Actions, now: int,
    guard: int,
) -> str:  # fmt: skip
    """Return the first rule that a receiver's step breaks; "" when it breaks none.

    S2, S3: it takes over only on a COMMIT of an epoch it still takes, within its lease and until
    the guard before its end on any clock. ``now``: its own clock.
    """
    responsible = receiver.is_responsible(before, now)
    for action in actions:
        match action:
            case Release():
                responsible = False
            case TakeResponsibility(until_ns=int() as until):
                responsible = True
                if not isinstance(event, CommitHeard) or event.commit.lease_end_ns <= 0:
                    return "S3"
                if not now < until <= event.commit.lease_end_ns - event.uncertainty_ns - guard:
                    return "S3"
                if before.live is None or event.commit.epoch < lowest_epoch(before):
                    return "S2"
            case TakeResponsibility():
                responsible = True
            case _:
                pass
    return "" if responsible == receiver.is_responsible(after, now) else "S1"
