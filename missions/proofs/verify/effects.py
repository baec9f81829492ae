"""The effects of an event on either machine, worked out once for each state: worlds of numbers,
tables of effects.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import fields, is_dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

from missions.proofs.verify.model import (
    NOBODY,
    RECEIVER_ID,
    SECOND_ID,
    UNREAD,
    ModelPacket,
    Scope,
    Side,
    candidate,
    misdirected,
    packet_later,
    status,
    target,
    unstamped,
)
from missions.proofs.verify.rules import Dead, receiver_rules, sender_rules
from path.messages import Commit, Message, Role, Status
from path.protocol import receiver, sender
from path.protocol.values import (
    Actions,
    CommitHeard,
    Heard,
    PeerStatus,
    Persist,
    ReceiverEvent,
    ReceiverRecord,
    Send,
    SenderEvent,
    SenderRecord,
    Tick,
)

T = TypeVar("T", bound=Hashable)

_SENDER = 1 << 30  # in the place of a skew: the sender's clock has none


class Interned(Generic[T]):
    """Values by small numbers: worlds of numbers are cheap to compare, and what a machine does is
    worked out once.
    """

    def __init__(self) -> None:
        self._numbers: dict[T, int] = {}
        self.values: list[T] = []

    def __call__(self, value: T) -> int:
        number = self._numbers.get(value)
        if number is None:
            number = self._numbers[value] = len(self.values)
            self.values.append(value)
        return number


class Effect(NamedTuple):
    """The effect of an event on a machine.

    Attributes:
        what: the event, in words.
        state, kept: the new state, and the record written down; ``kept`` is -1 when none was.
        sent: packets, a bit each.
        commits: epoch and object of each COMMIT.
        broken: the invariant that the actions break; "" when none.
        halves: what was sent and kept when it is killed after one action, two, ...
    """

    what: str
    state: int
    sent: int
    kept: int
    commits: tuple[tuple[int, int], ...]
    broken: str
    halves: tuple[tuple[int, int], ...]


def later(value: Any, past: int) -> Any:
    """The same value a tick later: its instants (fields in ``_ns``) are that much nearer, or longer
    ago.
    """
    changed: dict[str, Any] = {}
    for field in fields(value):
        old = getattr(value, field.name)
        if field.name.endswith("_ns"):
            changed[field.name] = max(old - 1, -past)
        elif is_dataclass(old) and not isinstance(old, type):
            changed[field.name] = later(old, past)
    return replace(value, **changed) if changed else value


def bits(mask: int) -> list[int]:
    """The numbers of the bits that are set."""
    numbers: list[int] = []
    while mask:
        lowest = mask & -mask
        numbers.append(lowest.bit_length() - 1)
        mask ^= lowest
    return numbers


class Effects:
    """Tables of one scope.

    Machines are told every instant relative to the present of the sender's clock, which is 0. The
    receiver's clock then shows the skew.
    """

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.config = scope.config
        self.senders = Interned[sender.SenderState | Dead]()
        self.receivers = Interned[receiver.ReceiverState | Dead]()
        self.packets = Interned[ModelPacket]()
        self.sender_records = Interned[SenderRecord]()
        self.receiver_records = Interned[ReceiverRecord]()
        self._by_sender: dict[tuple[int, SenderEvent], Effect] = {}
        self._by_receiver: dict[tuple[int, int, ReceiverEvent], Effect] = {}
        self._heard: dict[tuple[tuple[int, int, int], int], tuple[Effect, ...]] = {}
        self._deaf: dict[tuple[int, int, int], int] = {}
        self._words: dict[tuple[int, int, int, int], int] = {}
        self._aged: dict[tuple[str, int], int] = {}
        self._aged_masks: dict[int, int] = {}

    # --- events

    def sender_told(self, state: int, event: SenderEvent, what: str) -> Effect:
        key = (state, event)
        effect = self._by_sender.get(key)
        if effect is None:
            before = self.senders.values[state]
            assert not isinstance(before, Dead)
            after, actions = sender.step(self.config, before, event, 0)
            broken = sender_rules(before, after, event, actions, self.scope.uncertainty)
            effect = self._by_sender[key] = self._effect(
                "receiver", what, self.senders(after), actions, broken
            )
        return effect

    def receiver_told(self, state: int, skew: int, event: ReceiverEvent, what: str) -> Effect:
        key = (state, skew, event)
        effect = self._by_receiver.get(key)
        if effect is None:
            before = self.receivers.values[state]
            assert not isinstance(before, Dead)
            after, actions = receiver.step(self.config, before, event, skew)
            broken = receiver_rules(before, after, event, actions, skew, self.scope.guard)
            effect = self._by_receiver[key] = self._effect(
                "sender", what, self.receivers(after), actions, broken
            )
        return effect

    def _effect(self, to: Side, what: str, state: int, actions: Actions, broken: str) -> Effect:
        sent = 0
        kept = -1
        commits: list[tuple[int, int]] = []
        halves: list[tuple[int, int]] = []
        for action in actions:
            if isinstance(action, Send):
                sent |= 1 << self.packets(ModelPacket(to, unstamped(action.message)))
                if isinstance(action.message, Commit):
                    commits.append((action.message.epoch, action.message.target_id))
            elif isinstance(action, Persist) and isinstance(action.record, SenderRecord):
                kept = self.sender_records(action.record)
            elif isinstance(action, Persist) and isinstance(action.record, ReceiverRecord):
                kept = self.receiver_records(action.record)
            halves.append((sent, kept))
        return Effect(
            what, state, sent, kept, tuple(commits), broken, tuple(dict.fromkeys(halves[:-1]))
        )

    # --- packets

    def heard_by_sender(self, state: int, packets: int) -> list[Effect]:
        """Return what may come of the packets on the link; those of which nothing comes are left
        out.
        """
        return self._heard_of("sender", state, 0, packets)

    def heard_by_receiver(
        self, state: int, skew: int, packets: int, instance: int = RECEIVER_ID
    ) -> list[Effect]:
        return self._heard_of("receiver", state, skew, packets, instance)

    def _heard_of(
        self, side: Side, state: int, skew: int, packets: int, instance: int = RECEIVER_ID
    ) -> list[Effect]:
        where = (state, skew, instance) if side == "receiver" else (state, _SENDER, 0)
        deaf = self._deaf.get(where, 0)
        effects: list[Effect] = []
        for number in bits(packets & ~deaf):
            key = (where, number)
            of_packet = self._heard.get(key)
            if of_packet is None:
                of_packet = self._heard[key] = self._hear(
                    side, state, skew, self.packets.values[number], instance
                )
                if not of_packet:
                    deaf = self._deaf[where] = deaf | 1 << number
            effects.extend(of_packet)
        return effects

    def _hear(
        self, side: Side, state: int, skew: int, packet: ModelPacket, instance: int
    ) -> tuple[Effect, ...]:
        """Return the effects of the packet and, of the same word about something else, any at all.

        There may be none (S6).
        """
        if packet.to != side:
            return ()
        name = type(packet.message).__name__
        who = side if instance == RECEIVER_ID else f"second {side}"
        effect = self._told(
            side, state, skew, packet.message, f"{name} reaches the {who}", instance
        )
        nothing = (
            effect.state == state and not effect.sent and effect.kept < 0 and not effect.broken
        )
        found = [] if nothing else [effect]
        idle = self._tick(side, state, skew).state
        for wrong in misdirected(packet.message, self.scope):
            told = self._told(
                side, state, skew, wrong, f"a misdirected {name} reaches the {who}", instance
            )
            if told.state != idle:
                found.append(told._replace(broken="S6"))
        return tuple(found)

    def _told(
        self, side: Side, state: int, skew: int, message: Message, what: str, instance: int
    ) -> Effect:
        uncertainty = self.scope.uncertainty
        if isinstance(message, Status):
            event = PeerStatus(
                message.responsible, message.stamp_ns - uncertainty, message.instance
            )
        elif isinstance(message, Commit) and side == "receiver":
            event = CommitHeard(message, message.lease_end_ns, uncertainty, instance)
        else:
            event = Heard(message)
        if side == "receiver":
            return self.receiver_told(state, skew, event, what)
        assert not isinstance(event, CommitHeard)
        return self.sender_told(state, event, what)

    def _tick(self, side: Side, state: int, skew: int) -> Effect:
        if side == "sender":
            return self.sender_told(state, Tick(), "the sender notices the time")
        return self.receiver_told(state, skew, Tick(), "the receiver notices the time")

    def said(self, state: int, held: int, skew: int, second: int = NOBODY) -> int:
        """Return the packets that the drones send in these states all the time."""
        found = self._words.get((state, held, skew, second))
        if found is None:
            packets: list[ModelPacket] = []
            gives = self.senders.values[state]
            takes = self.receivers.values[held]
            if not isinstance(gives, Dead):
                packets.append(
                    ModelPacket("receiver", status(Role.SENDER, sender.is_responsible(gives), 0))
                )
                if not isinstance(gives, sender.Idle | sender.Keeping | sender.HandedOver):
                    packets.append(ModelPacket("receiver", target(gives.live)))
            if not isinstance(takes, Dead):
                packets.append(
                    ModelPacket(
                        "sender", status(Role.RECEIVER, receiver.is_responsible(takes, skew), skew)
                    )
                )
                if takes.live is not None:
                    packets.append(ModelPacket("sender", candidate(takes.live)))
            if second != NOBODY:
                other = self.receivers.values[second]
                assert not isinstance(other, Dead)
                said = status(Role.RECEIVER, receiver.is_responsible(other, skew), skew, SECOND_ID)
                packets.append(ModelPacket("sender", said))
            found = 0
            for packet in packets:
                found |= 1 << self.packets(packet)
            self._words[state, held, skew, second] = found
        return found

    # --- time

    def aged(self, kind: str, interned: Interned[Any], number: int) -> int:
        """The number of a value a tick later."""
        if number == UNREAD:
            return UNREAD
        found = self._aged.get((kind, number))
        if found is None:
            value = interned.values[number]
            timeless = isinstance(value, SenderRecord | ReceiverRecord) and value.live is None
            found = self._aged[kind, number] = (
                number if timeless else interned(later(value, self.scope.past))
            )
        return found

    def packets_aged(self, packets: int) -> int:
        """The link a tick later. Stale statuses are gone."""
        found = self._aged_masks.get(packets)
        if found is None:
            found = 0
            for number in bits(packets):
                found |= self._packet_aged(number)
            self._aged_masks[packets] = found
        return found

    def _packet_aged(self, number: int) -> int:
        aged = self._aged.get(("packet", number))
        if aged is None:
            packet = packet_later(self.packets.values[number], self.scope.past)
            aged = self._aged["packet", number] = 0 if packet is None else 1 << self.packets(packet)
        return aged

    # --- restarts

    def sender_restored(self, kept: int, same_clock: bool) -> tuple[int, int]:
        """State, and what it writes down at once."""
        state = sender.restored(
            self.config, self.sender_records.values[kept], 0, same_clock=same_clock
        )
        return self.senders(state), self.sender_records(sender.record(state))

    def receiver_restored(self, kept: int, skew: int, same_clock: bool) -> tuple[int, int]:
        state = receiver.restored(
            self.config, self.receiver_records.values[kept], skew, same_clock=same_clock
        )
        return self.receivers(state), self.receiver_records(receiver.record(state))
