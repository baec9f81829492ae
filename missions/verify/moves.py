"""What can happen next in a world, and whether it may: every step is held against the invariants of the hand-over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from missions.verify.model import (
    HANDOFF_ID,
    OTHER_ID,
    TARGET_ID,
    Interned,
    Packet,
    Scope,
    Side,
    World,
    candidate,
    later,
    misdirected,
    packet_later,
    status,
    target,
    unstamped,
)
from missions.verify.rules import lowest_epoch, receiver_rules, sender_rules, used_epoch
from path.messages import AbortReason, Commit, Message, Role, Status
from path.protocol import receiver, sender
from path.protocol.values import (
    AbortRequested,
    Actions,
    AgreementComplete,
    CommitHeard,
    Handoff,
    Heard,
    Offer,
    Outcome,
    PeerStatus,
    Persist,
    ReceiverEvent,
    ReceiverRecord,
    Send,
    SenderEvent,
    SenderRecord,
    Tick,
    VerifyAgain,
)


class Move(NamedTuple):
    """One step: what happened, what came of it, and the invariant it broke ("" when none)."""

    what: str
    world: World
    broken: str = ""


class _Effect(NamedTuple):
    """What a machine does on an event: its new state, packets, record, and the invariant its actions break."""

    state: int
    sent: tuple[int, ...]
    kept: int | None
    commits: tuple[Commit, ...]
    broken: str
    halves: tuple[tuple[tuple[int, ...], int | None], ...]  # sent and kept, when killed after 1, 2, ... actions


class Moves:
    """All steps from a world, of one scope."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self._config = scope.config
        self._senders = Interned[sender.SenderState]()
        self._receivers = Interned[receiver.ReceiverState]()
        self._packets = Interned[Packet]()
        self._sender_records = Interned[SenderRecord]()
        self._receiver_records = Interned[ReceiverRecord]()
        self._sender_effects: dict[tuple[int, SenderEvent], _Effect] = {}
        self._receiver_effects: dict[tuple[int, int, ReceiverEvent], _Effect] = {}
        self._words: dict[tuple[int, int, int], frozenset[int]] = {}
        self._aged: dict[tuple[str, int], int] = {}

    def start(self, skew: int) -> World:
        """The sender is responsible and has begun nothing; the receiver observes."""
        first = World(
            self._senders(sender.Idle()), self._receivers(receiver.Observing()), skew, frozenset(),
            self.scope.crashes, self.scope.aborts, self.scope.attempts,
            self._sender_records(SenderRecord()), self._receiver_records(ReceiverRecord()), 0, 0,
        )  # fmt: skip
        return first._replace(packets=self._said(first))

    def sender_of(self, world: World) -> sender.SenderState:
        return self._senders.values[world.sender]

    def receiver_of(self, world: World) -> receiver.ReceiverState:
        return self._receivers.values[world.receiver]

    def nobody(self, world: World) -> bool:
        return not sender.is_responsible(self.sender_of(world)) and not receiver.is_responsible(self.receiver_of(world))

    def __call__(self, world: World) -> Iterator[Move]:
        yield from self._link(world)
        yield from self._time(world)
        yield from self._sender_program(world)
        yield from self._receiver_program(world)
        if world.crashes:
            yield from self._crashes(world)

    # --- the link ---------------------------------------------------------------------------------------------

    def _link(self, world: World) -> Iterator[Move]:
        for number in world.packets:
            packet = self._packets.values[number]
            name = type(packet.message).__name__
            yield from self._deliver(world, packet, f"{name} reaches the {packet.to}")
            for message in misdirected(packet.message):
                if self._changes(world, Packet(packet.to, message)):
                    yield Move(f"a misdirected {name} reaches the {packet.to}", world, "S6")

    def _deliver(self, world: World, packet: Packet, what: str) -> Iterator[Move]:
        if packet.to == "sender":
            yield from self._tell_sender(world, self._heard_by_sender(packet.message), what)
        else:
            yield from self._tell_receiver(world, self._heard_by_receiver(packet.message), what)

    def _heard_by_sender(self, message: Message) -> SenderEvent:
        if isinstance(message, Status):
            return PeerStatus(message.responsible, message.stamp_ns - self.scope.uncertainty)
        return Heard(message)

    def _heard_by_receiver(self, message: Message) -> ReceiverEvent:
        if isinstance(message, Status):
            return PeerStatus(message.responsible, message.stamp_ns - self.scope.uncertainty)
        if isinstance(message, Commit):
            return CommitHeard(message, message.lease_end_ns, self.scope.uncertainty)
        return Heard(message)

    def _changes(self, world: World, packet: Packet) -> bool:
        """Whether a packet does more to its machine than the mere passing of time."""
        if packet.to == "sender":
            told = self._sender_effect(world, self._heard_by_sender(packet.message))
            return told.state != self._sender_effect(world, Tick()).state
        told = self._receiver_effect(world, self._heard_by_receiver(packet.message))
        return told.state != self._receiver_effect(world, Tick()).state

    # --- time -------------------------------------------------------------------------------------------------

    def _time(self, world: World) -> Iterator[Move]:
        guard = self.scope.guard
        due, waiting = sender.wake_ns(self.sender_of(world)), receiver.wake_ns(self.receiver_of(world))
        if due is not None and due <= 0:
            yield from self._tell_sender(world, Tick(), "the sender notices the time", awaited=True)
        if waiting is not None and waiting <= world.skew:
            yield from self._tell_receiver(world, Tick(), "the receiver notices the time", awaited=True)
        if due is not None and 1 - due > guard:
            return
        for skew in range(max(world.skew - 1, -self.scope.uncertainty), min(world.skew + 1, self.scope.uncertainty) + 1):
            if waiting is None or skew + 1 - waiting <= guard:
                yield self._tick(world, skew)

    def _tick(self, world: World, skew: int) -> Move:
        packets = (self._packet_later(number) for number in world.packets)
        after = world._replace(
            sender=self._later("sender", self._senders, world.sender),
            receiver=self._later("receiver", self._receivers, world.receiver),
            skew=skew,
            packets=frozenset(number for number in packets if number >= 0),
            sender_kept=self._later("sender record", self._sender_records, world.sender_kept),
            receiver_kept=self._later("receiver record", self._receiver_records, world.receiver_kept),
            alone=min(world.alone + 1, self.scope.longest_gap + 1) if self.nobody(world) else 0,
        )
        after = after._replace(packets=after.packets | self._said(after))
        return Move("a tick passes", after, self._overdue(after))

    def _later(self, kind: str, interned: Interned[Any], number: int) -> int:
        aged = self._aged.get((kind, number))
        if aged is None:
            aged = self._aged[kind, number] = interned(later(interned.values[number], self.scope.past))
        return aged

    def _packet_later(self, number: int) -> int:
        aged = self._aged.get(("packet", number))
        if aged is None:
            packet = packet_later(self._packets.values[number], self.scope.past)
            aged = self._aged["packet", number] = -1 if packet is None else self._packets(packet)
        return aged

    def _overdue(self, world: World) -> str:
        """L1: everything that waits, ends. L2: no gap but the orphan, and that one is alarmed."""
        state, held = self.sender_of(world), self.receiver_of(world)
        latest = -self.scope.guard
        match state:
            case sender.Offering() | sender.Verifying():
                late = state.end_ns < latest
            case sender.AwaitingAccept():
                late = state.take_back_ns < latest
            case sender.HandedOver(settled=None):
                late = state.settle_end_ns < latest
            case _:
                late = False
        if isinstance(held, receiver.Provisional):
            late = late or held.lease_end_ns < world.skew + latest
        elif isinstance(held, receiver.LetGo) and held.settled is None:
            late = late or held.settle_end_ns < world.skew + latest
        if late:
            return "L1"
        if world.alone <= self.scope.longest_gap:
            return ""
        if not (isinstance(state, sender.HandedOver) and isinstance(held, receiver.LetGo)):
            return "L2"
        undisturbed = world.crashes == self.scope.crashes and world.aborts == self.scope.aborts
        return "L2" if state.settled is Outcome.HANDED_OVER and undisturbed else ""

    # --- the programs -----------------------------------------------------------------------------------------

    def _sender_program(self, world: World) -> Iterator[Move]:
        state = self.sender_of(world)
        if world.attempts:
            begun = world._replace(attempts=world.attempts - 1)
            if isinstance(state, sender.Idle | sender.TakenBack):
                yield from self._tell_sender(begun, Offer(HANDOFF_ID, TARGET_ID), "the sender offers the target")
            if isinstance(state, sender.TakenBack):
                yield from self._tell_sender(begun, VerifyAgain(), "the sender verifies again")
        if isinstance(state, sender.Verifying):
            yield from self._agreements(world, state.live)
        if world.aborts:
            upset = world._replace(aborts=world.aborts - 1)
            yield from self._tell_sender(upset, AbortRequested(AbortReason.PILOT), "a pilot takes the sender")

    def _agreements(self, world: World, live: Handoff) -> Iterator[Move]:
        nonce, told = 100 * live.epoch, self.scope.uncertainty
        whole = AgreementComplete(live.epoch, TARGET_ID, nonce, told)
        yield from self._tell_sender(world._replace(agreed=live.epoch), whole, "the agreement is complete")
        for wrong, what in (
            (AgreementComplete(live.epoch - 1, TARGET_ID, nonce, told), "an agreement of an earlier attempt is told"),
            (AgreementComplete(live.epoch, OTHER_ID, nonce, told), "an agreement on another object is told"),
            (AgreementComplete(live.epoch, TARGET_ID, nonce, None), "an agreement is told without aligned clocks"),
        ):
            yield from self._tell_sender(world, wrong, what)

    def _receiver_program(self, world: World) -> Iterator[Move]:
        state = self.receiver_of(world)
        if world.aborts:
            upset = world._replace(aborts=world.aborts - 1)
            yield from self._tell_receiver(upset, AbortRequested(AbortReason.PILOT), "a pilot takes the receiver")

    def _said(self, world: World) -> frozenset[int]:
        """What both drones say in this world, as they say it all the time."""
        found = self._words.get((world.sender, world.receiver, world.skew))
        if found is None:
            state, held = self.sender_of(world), self.receiver_of(world)
            said = [
                Packet("receiver", status(Role.SENDER, sender.is_responsible(state), 0)),
                Packet("sender", status(Role.RECEIVER, receiver.is_responsible(held), world.skew)),
            ]
            if not isinstance(state, sender.Idle | sender.HandedOver):
                said.append(Packet("receiver", target(state.live)))
            if held.live is not None:
                said.append(Packet("sender", candidate(held.live)))
            found = frozenset(self._packets(packet) for packet in said)
            self._words[world.sender, world.receiver, world.skew] = found
        return found

    def _crashes(self, world: World) -> Iterator[Move]:
        for same_clock, how in ((True, "killed and started again"), (False, "lost to a reboot and started again")):
            yield self._reborn_sender(world, world.sender_kept, f"the sender is {how}", same_clock)
            yield self._reborn_receiver(world, world.receiver_kept, f"the receiver is {how}", same_clock)

    def _reborn_sender(self, world: World, kept: int, what: str, same_clock: bool) -> Move:
        state = sender.restored(self._config, self._sender_records.values[kept], 0, same_clock=same_clock)
        alone = world.alone if same_clock else 0  # a reboot's clock begins anew, and so does what is waited for
        kept = self._sender_records(sender.record(state))
        after = world._replace(sender=self._senders(state), sender_kept=kept, crashes=world.crashes - 1, alone=alone)
        return self._checked(world, after, what)

    def _reborn_receiver(self, world: World, kept: int, what: str, same_clock: bool) -> Move:
        record = self._receiver_records.values[kept]
        state = receiver.restored(self._config, record, world.skew, same_clock=same_clock)
        kept = self._receiver_records(receiver.record(state))
        after = world._replace(receiver=self._receivers(state), receiver_kept=kept, crashes=world.crashes - 1)
        return self._checked(world, after, what)

    # --- a machine's step, with all that may interrupt it -----------------------------------------------------

    def _sender_effect(self, world: World, event: SenderEvent) -> _Effect:
        key = (world.sender, event)
        effect = self._sender_effects.get(key)
        if effect is None:
            before = self.sender_of(world)
            state, actions = sender.step(self._config, before, event, 0)
            broken = sender_rules(before, state, actions, self.scope.uncertainty)
            effect = self._sender_effects[key] = self._effect("receiver", self._senders(state), actions, broken)
        return effect

    def _receiver_effect(self, world: World, event: ReceiverEvent) -> _Effect:
        key = (world.receiver, world.skew, event)
        effect = self._receiver_effects.get(key)
        if effect is None:
            before = self.receiver_of(world)
            state, actions = receiver.step(self._config, before, event, world.skew)
            broken = receiver_rules(before, state, event, actions)
            effect = self._receiver_effects[key] = self._effect("sender", self._receivers(state), actions, broken)
        return effect

    def _effect(self, to: Side, state: int, actions: Actions, broken: str) -> _Effect:
        sent: list[int] = []
        commits: list[Commit] = []
        kept: int | None = None
        halves: list[tuple[tuple[int, ...], int | None]] = []
        for action in actions:
            if isinstance(action, Send):
                sent.append(self._packets(Packet(to, unstamped(action.message))))
                if isinstance(action.message, Commit):
                    commits.append(action.message)
            elif isinstance(action, Persist):
                record = action.record
                kept = (
                    self._sender_records(record)
                    if isinstance(record, SenderRecord)
                    else self._receiver_records(record)
                )
            halves.append((tuple(sent), kept))
        return _Effect(state, tuple(sent), kept, tuple(commits), broken, tuple(dict.fromkeys(halves[:-1])))

    def _tell_sender(
        self, world: World, event: SenderEvent, what: str, *, awaited: bool = False
    ) -> Iterator[Move]:
        """``awaited``: the machine asked to be told of this instant, and has to make something of it (L1)."""
        effect = self._sender_effect(world, event)
        broken = effect.broken or ("L1" if awaited and effect.state == world.sender else "")
        if any(commit.epoch != world.agreed or commit.target_id != TARGET_ID for commit in effect.commits):
            broken = broken or "S5"
        kept = world.sender_kept if effect.kept is None else effect.kept
        after = world._replace(sender=effect.state, sender_kept=kept, packets=world.packets.union(effect.sent))
        yield self._checked(world, after, what, broken)
        if world.crashes:
            for sent, half_kept in effect.halves:
                half = world._replace(packets=world.packets.union(sent))
                kept = world.sender_kept if half_kept is None else half_kept
                yield self._reborn_sender(half, kept, f"{what}; it is killed half-way", same_clock=True)

    def _tell_receiver(
        self, world: World, event: ReceiverEvent, what: str, *, awaited: bool = False
    ) -> Iterator[Move]:
        effect = self._receiver_effect(world, event)
        broken = effect.broken or ("L1" if awaited and effect.state == world.receiver else "")
        kept = world.receiver_kept if effect.kept is None else effect.kept
        after = world._replace(receiver=effect.state, receiver_kept=kept, packets=world.packets.union(effect.sent))
        yield self._checked(world, after, what, broken)
        if world.crashes:
            for sent, half_kept in effect.halves:
                half = world._replace(packets=world.packets.union(sent))
                kept = world.receiver_kept if half_kept is None else half_kept
                yield self._reborn_receiver(half, kept, f"{what}; it is killed half-way", same_clock=True)

    def _checked(self, before: World, after: World, what: str, broken: str = "") -> Move:
        was, now = self.sender_of(before), self.sender_of(after)
        held, holds = self.receiver_of(before), self.receiver_of(after)
        if sender.is_responsible(now) and receiver.is_responsible(holds):
            broken = broken or "S1"
        if used_epoch(now) < used_epoch(was) or lowest_epoch(holds) < lowest_epoch(held):
            broken = broken or "S2"
        if isinstance(was, sender.HandedOver) and sender.is_responsible(now):
            broken = broken or "S4"
        if after.alone and (sender.is_responsible(now) or receiver.is_responsible(holds)):
            after = after._replace(alone=0)
        if not after.crashes:
            after = after._replace(sender_kept=0, receiver_kept=0)
        return Move(what, after._replace(packets=after.packets | self._said(after)), broken)
