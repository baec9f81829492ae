"""The values of the two protocol machines: events they are told, actions they want done, and ends
of a handoff.
"""

from __future__ import annotations

import math
from dataclasses import fields
from enum import Enum
from typing import Literal, Self

from path.messages import Abort, AbortReason, Accept, Candidate, Commit, Confirm, Message, Target
from path.values import frozen, value

LAST_EPOCH = 65535

SenderDuty = Literal["idle", "mine", "released", "handed_over"]
ReceiverDuty = Literal["observing", "provisional", "holding", "let_go"]


@frozen
class ProtocolConfig:
    """Deadlines of the hand-over.

    Attributes:
        offer_s: the sender's wait for the receiver's first candidate.
        handoff_s: from the first word of a handoff to the agreement; then the outcome is TIMEOUT.
        lease_s: from COMMIT to the end of its lease.
        retry_s: between two COMMITs, and two ACCEPTs.
        guard_s: the receiver's lease ends this much early: time from its last look at the clock
            until what it then did has happened.
        settle_s: after the lease, how long to wait for word of what became of the other side.
        max_uncertainty_s: clocks known no better than this cannot carry a lease.
    """

    offer_s: float = 30.0
    handoff_s: float = 60.0
    lease_s: float = 1.5
    retry_s: float = 0.05
    guard_s: float = 0.05
    settle_s: float = 3.0
    max_uncertainty_s: float = 0.1

    @classmethod
    def of_clocks(cls, max_uncertainty_s: float, **deadlines: float) -> Self:
        """Return the deadlines for clocks that are known to within so much, s.

        A lease leaves as long for COMMIT and ACCEPT as the usual one does: what is taken off for
        clocks that are known less well is put on.
        """
        usual = cls()
        more_s = max(0.0, max_uncertainty_s - usual.max_uncertainty_s)
        return cls(lease_s=usual.lease_s + more_s, max_uncertainty_s=max_uncertainty_s, **deadlines)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (
                math.isfinite(value) and (value > 0.0 or (value == 0.0 and field.name == "guard_s"))
            ):
                raise ValueError(f"{field.name}: {value!r} is not above 0")
        if not self.max_uncertainty_s + self.guard_s < self.lease_s:
            raise ValueError(
                "lease_s must be longer than max_uncertainty_s + guard_s: nothing would be left of it"
            )


def to_ns(seconds: float) -> int:
    return round(seconds * 1e9)


class HandoffOutcome(Enum):
    """The end of a handoff for one side."""

    HANDED_OVER = "handed_over"
    TIMEOUT = "timeout"
    ABORTED = "aborted"
    TAKEN_BACK = "taken_back"  # committed, not accepted: the sender is responsible again
    # accepted, not confirmed within the lease: the receiver does not know what the sender knows
    LET_GO = "let_go"
    SUPERSEDED = "superseded"  # the sender went on to a higher epoch
    ORPHANED = "orphaned"  # the sender handed over and the receiver let go: nobody is responsible
    UNCONFIRMED = "unconfirmed"  # nothing was heard of the other side: perhaps orphaned

    @property
    def alarming(self) -> bool:
        """Perhaps nobody is responsible: a person must be told."""
        return self in (HandoffOutcome.LET_GO, HandoffOutcome.ORPHANED, HandoffOutcome.UNCONFIRMED)


class Refusal(Enum):
    """The reason why an event changed nothing."""

    WRONG_STATE = "wrong_state"
    WRONG_HANDOFF = "wrong_handoff"
    LOWER_EPOCH = "lower_epoch"
    UNKNOWN_EPOCH = "unknown_epoch"
    WRONG_TARGET = "wrong_target"
    WRONG_NONCE = "wrong_nonce"
    LEASE_OVER = "lease_over"
    # longer than any that is given: the clocks are not what they were
    LEASE_TOO_LONG = "lease_too_long"
    NO_CLOCK = "no_clock"
    WRONG_INSTANCE = "wrong_instance"  # another receiver's, which answers on the same channel
    NOT_ONE_RECEIVER = "not_one_receiver"  # none is heard, or more than one
    NOT_ABLE = "not_able"
    EPOCHS_EXHAUSTED = "epochs_exhausted"


@frozen
class Handoff:
    """The identity of one attempt, to which its messages are bound.

    ``instance``: the receiver it is committed to, 0 before.
    """

    handoff_id: int
    epoch: int
    target_id: int
    instance: int = 0

    def follows(self, other: Handoff | None) -> bool:
        """Return whether it is another attempt than ``other``."""
        return other is None or self._attempt != other._attempt

    @property
    def _attempt(self) -> tuple[int, int, int]:
        return self.handoff_id, self.epoch, self.target_id


Bound = Target | Candidate | Commit | Accept | Confirm


def mismatch(live: Handoff, message: Bound) -> Refusal | None:
    """Return why a message does not belong to the live attempt; None when it does."""
    if message.epoch != live.epoch:
        return Refusal.LOWER_EPOCH if message.epoch < live.epoch else Refusal.UNKNOWN_EPOCH
    if message.handoff_id != live.handoff_id:
        return Refusal.WRONG_HANDOFF
    if message.target_id != live.target_id:
        return Refusal.WRONG_TARGET
    if isinstance(message, Commit | Accept | Confirm) and message.instance != live.instance:
        return Refusal.WRONG_INSTANCE
    return None


def is_abort_of(live: Handoff, message: Message) -> bool:
    return (
        isinstance(message, Abort)
        and message.handoff_id == live.handoff_id
        and message.epoch == live.epoch
    )


# --- events


@frozen
class Tick:
    """Time has passed. Due at ``wake_ns`` of a machine at the latest."""


@value
class Heard:
    """A message of the other drone, except Commit and Status (``CommitHeard``, ``PeerStatus``)."""

    message: Message


@frozen
class AbortRequested:
    """A pilot, a guard or the mission on this side ends the handoff."""

    reason: AbortReason


@value
class PeerStatus:
    """The other drone's Status, of a proved stream and while the clocks are aligned.

    Attributes:
        stamp_ns: the earliest its stamp can be in the own clock.
        instance: as in ``path.messages.Status``.
    """

    responsible: bool
    stamp_ns: int
    instance: int = 0


@frozen
class Offer:
    """Sender: begin a handoff of the object it tracks, and is responsible for from here on."""

    handoff_id: int
    target_id: int


@frozen
class AgreementComplete:
    """Sender: the whole window agreed, within this epoch and on this target.

    Attributes:
        nonce: u32, fresh, unpredictable; drawn by the caller.
        uncertainty_ns: bound on the clocks' offset until the lease's end; None when they are not
            aligned.
        instance: of the receiver that answers; None when none is heard, or more than one.
    """

    epoch: int
    target_id: int
    nonce: int
    uncertainty_ns: int | None
    instance: int | None


@frozen
class VerifyAgain:
    """Sender: after taking back, verify once more, in the new epoch."""


@frozen
class NewMission:
    """A person begins anew on the ground: what an earlier mission held is over.

    Epochs go on.
    """


@frozen
class CommitHeard:
    """Receiver: a Commit came in.

    Attributes:
        lease_end_ns: its lease's end in the receiver's own clock; None when the clocks are not
            aligned.
        uncertainty_ns: bound on the error of that conversion.
        instance: this receiver's own.
        able: whether the receiver sees the target and may follow it now.
    """

    commit: Commit
    lease_end_ns: int | None
    uncertainty_ns: int
    instance: int
    able: bool = True


SenderEvent = (
    Tick
    | Heard
    | AbortRequested
    | PeerStatus
    | Offer
    | AgreementComplete
    | VerifyAgain
    | NewMission
)
ReceiverEvent = Tick | Heard | AbortRequested | PeerStatus | CommitHeard | NewMission


# --- actions: to be carried out in their order


@frozen
class Send:
    message: Message


@frozen
class SenderRecord:
    """The facts that a restarted sender has to know. Instants are of its own clock.

    Attributes:
        epoch: the last one used.
        duty: "idle" (nothing is its own), "mine" (responsible), "released" (committed, nothing
            confirmed) or "handed_over" (accepted).
        live: the attempt it is released or handed over in; None when it is neither.
        nonce, lease_end_ns, take_back_ns: of its COMMIT; 0 when there is none.
        withdrawn: the attempt was aborted after the COMMIT.
    """

    epoch: int = 0
    duty: SenderDuty = "idle"
    live: Handoff | None = None
    nonce: int = 0
    lease_end_ns: int = 0
    take_back_ns: int = 0
    withdrawn: AbortReason | None = None


@frozen
class ReceiverRecord:
    """The facts that a restarted receiver has to know. Instants are of its own clock.

    Attributes:
        epoch: the lowest one it still takes.
        duty: "observing", "provisional", "holding" (responsible for good) or "let_go".
        live: the attempt it holds, or let go, the target in; None while observing.
        nonce, lease_end_ns, sure_ns: of what it accepted; 0 while observing.
    """

    epoch: int = 0
    duty: ReceiverDuty = "observing"
    live: Handoff | None = None
    nonce: int = 0
    lease_end_ns: int = 0
    sure_ns: int = 0


@frozen
class Persist:
    """Write this down, and only then go on: after a restart the machine begins with it."""

    record: SenderRecord | ReceiverRecord


@value
class TakeResponsibility:
    """Responsible from now on: until an instant of the own clock, or for good when there is none.

    The end is part of it. Whoever says or acts on it compares it with the clock (``at``); a program
    that slept through the end is not responsible when it wakes, though nothing has told it so.
    """

    until_ns: int | None = None

    @property
    def provisional(self) -> bool:
        return self.until_ns is not None

    def at(self, now_ns: int) -> bool:
        """Return whether the claim still holds at an instant of the own clock."""
        return self.until_ns is None or now_ns < self.until_ns


@frozen
class Release:
    """No longer responsible from now on; observing goes on."""


@frozen
class Ended:
    """This attempt is decided, as far as this side is concerned."""

    outcome: HandoffOutcome
    reason: AbortReason | None = None


@frozen
class Settled:
    """The other side's half is decided, after ``Ended``.

    Until then a sender that handed over keeps observing.
    """

    outcome: HandoffOutcome


@frozen
class Refused:
    """An event changed nothing; for counting and logging."""

    why: Refusal


Action = Send | Persist | TakeResponsibility | Release | Ended | Settled | Refused
Actions = tuple[Action, ...]
