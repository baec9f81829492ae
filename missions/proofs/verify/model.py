"""A small world around the two protocol machines, in which everything that can go wrong may go
wrong at any moment.

One tick is one nanosecond of the machines. Instants are kept relative to the present of the
sender's clock, so that the same situation at another time is the same state: what is reachable is
finite, and all of it is explored.

What the world may do at any moment:

- deliver any packet that was ever sent: at once, later (delay, reordering), again (duplication) or
  never (loss). Nothing is ever taken off the link: any number of packets is in flight, and a lost
  one is one that never arrives;
- let a tick pass, in which the receiver's clock runs slow, right or fast, always within the
  uncertainty that both sides have been told; either program may notice the time late, by up to the
  guard;
- both drones say all the time what they say all the time (Targets, Candidates, Status), and that
  too is kept;
- complete an agreement, report one of another epoch or of another object, let a pilot abort on
  either side;
- let programs sleep, in scopes with stalls for any time;
- let a second receiver hear and say all that the first one does, in scopes with two;
- kill either program between any two of its actions, and start it again, at once or at any later
  time, with what it had written down; on a clock that goes on, or on another one after a reboot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

from path.messages import Accept, Candidate, Commit, Confirm, Message, Role, Status, Target
from path.observations import MissReason
from path.protocol.values import Handoff, ProtocolConfig
from path.values import frozen

TICK_S = 1e-9
HANDOFF_ID = 1
TARGET_ID = 1
OTHER_ID = 2
RECEIVER_ID = 1
SECOND_ID = 2
NOBODYS_ID = 3
UNREAD = NOBODY = -1
STATUS_AGE = -3  # ticks after which a delayed Status is dropped, as the link drops what is stale
ORIGIN = (0.0, 0.0, 0.0)
DOWN = (0.0, 0.0, 1.0)

Side = Literal["sender", "receiver"]


@frozen
class Scope:
    """The size of the world that is explored; times in ticks.

    Attributes:
        crashes, aborts: how often each may happen; ``attempts``: how often the sender begins.
        uncertainty: bound on the difference of the clocks, which wanders within it, by a tick a
            tick.
        stalls: programs may sleep through anything, for any time. Nothing comes to an end in time
            then (L1, L2 are not asked for); all else still holds.
        receivers: 2: another drone with the same role and key hears what the first one hears, and
            says what it says.
        beyond: ticks by which the clocks may differ more than both sides were told. Breaks what it
            is meant to: the bound is an assumption.
        forgetful: a disk may have an earlier record at a restart, or none. That it keeps the newest
            is an assumption.
        lease, retry, guard, settle, offer, handoff: as of the protocol.
    """

    crashes: int = 0
    aborts: int = 0
    attempts: int = 1
    stalls: bool = False
    receivers: int = 1
    beyond: int = 0
    forgetful: bool = False
    uncertainty: int = 1
    lease: int = 5
    retry: int = 2
    guard: int = 1
    settle: int = 2
    offer: int = 4
    handoff: int = 6

    @property
    def config(self) -> ProtocolConfig:
        return ProtocolConfig(
            offer_s=self.offer * TICK_S,
            handoff_s=self.handoff * TICK_S,
            lease_s=self.lease * TICK_S,
            retry_s=self.retry * TICK_S,
            guard_s=self.guard * TICK_S,
            settle_s=self.settle * TICK_S,
            max_uncertainty_s=self.uncertainty * TICK_S,
        )

    @property
    def longest_gap(self) -> int:
        """L2: nobody is responsible for longer than lease and clock uncertainty, and the lateness
        of a program.
        """
        return self.lease + self.uncertainty + self.guard

    @property
    def past(self) -> int:
        """Instants longer ago than this are all alike: no comparison of the machines tells them
        apart any more.
        """
        return 2 * self.uncertainty + self.guard + 1 - STATUS_AGE


class ModelPacket(NamedTuple):
    to: Side
    message: Message


class ModelWorld(NamedTuple):
    """One situation: numbers of interned values, see ``Effects``. All instants are relative to the
    sender's clock.

    Attributes:
        packets: on the link, a bit each.
        skew: the receiver's clock less the sender's.
        sender_kept, receiver_kept: what each has on disk; ``UNREAD`` when it can crash no more.
        second: another receiver's state; ``NOBODY`` when there is none.
        agreed: the epoch in which the agreement was complete; 0 before.
        alone: ticks since somebody was responsible; no higher than one above the longest that is
            allowed.
    """

    sender: int
    receiver: int
    skew: int
    packets: int
    crashes: int
    aborts: int
    attempts: int
    sender_kept: int
    receiver_kept: int
    second: int
    agreed: int
    alone: int

    def stepped(
        self,
        sent: int,
        *,
        sender: int | None = None,
        receiver: int | None = None,
        sender_kept: int | None = None,
        receiver_kept: int | None = None,
        second: int | None = None,
    ) -> ModelWorld:
        """The world with more packets on its link, and with what else is told: ``_replace``, in
        half of its time.
        """
        return ModelWorld(
            self.sender if sender is None else sender,
            self.receiver if receiver is None else receiver,
            self.skew,
            self.packets | sent,
            self.crashes,
            self.aborts,
            self.attempts,
            self.sender_kept if sender_kept is None else sender_kept,
            self.receiver_kept if receiver_kept is None else receiver_kept,
            self.second if second is None else second,
            self.agreed,
            self.alone,
        )


def packet_later(packet: ModelPacket, past: int) -> ModelPacket | None:
    """A tick later; only instants that a machine looks at age. None for a Status that is too old to
    be told apart.
    """
    message = packet.message
    if isinstance(message, Commit):
        return ModelPacket(
            packet.to, replace(message, lease_end_ns=max(message.lease_end_ns - 1, -past))
        )
    if isinstance(message, Status):
        aged = replace(message, stamp_ns=message.stamp_ns - 1)
        return ModelPacket(packet.to, aged) if aged.stamp_ns > STATUS_AGE else None
    return packet


def target(live: Handoff) -> Target:
    return Target(live.handoff_id, live.epoch, live.target_id, 0, 0, ORIGIN, DOWN, 0.0)


def candidate(live: Handoff) -> Candidate:
    return Candidate(
        live.handoff_id, live.epoch, live.target_id, 0, 0, 0, None, MissReason.NO_CANDIDATE, ORIGIN,
        (1.0, 0.0, 0.0, 0.0), 0.0,
    )  # fmt: skip


def status(
    role: Role,
    responsible: bool,
    stamp: int,
    instance: int = RECEIVER_ID,
) -> Status:
    return Status(role, stamp, ORIGIN, ORIGIN, 0.0, 0, responsible, True, 1.0, instance)


def unstamped(message: Message) -> Message:
    """Return a message without the stamps that no machine looks at: packets that say the same are
    the same.
    """
    return (
        message
        if isinstance(message, Status | Target | Candidate)
        else replace(message, stamp_ns=0)
    )


def misdirected(message: Message, scope: Scope) -> tuple[Message, ...]:
    """Return the same word about another handoff, object, commit or receiver, and a lease that
    nobody gives.

    Nothing may follow from these (S6).

    A Target begins an attempt and a first Commit brings its nonce: another is as good.
    """
    if isinstance(message, Status) and message.role is Role.RECEIVER:
        return (replace(message, instance=NOBODYS_ID),)
    if not isinstance(message, Candidate | Commit | Accept | Confirm):
        return ()
    wrong = (replace(message, handoff_id=HANDOFF_ID + 1), replace(message, target_id=OTHER_ID))
    if not isinstance(message, Candidate):
        wrong = (*wrong, replace(message, instance=NOBODYS_ID))
    if isinstance(message, Commit):
        return (*wrong, replace(message, lease_end_ns=scope.lease + 2 * scope.uncertainty + 1))
    return (
        (*wrong, replace(message, nonce=message.nonce + 1))
        if isinstance(message, Accept | Confirm)
        else wrong
    )
