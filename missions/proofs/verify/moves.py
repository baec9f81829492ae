"""The steps from a world, each held against the invariants of the hand-over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from missions.proofs.verify.effects import Effect, Effects, Interned
from missions.proofs.verify.model import (
    HANDOFF_ID,
    NOBODY,
    OTHER_ID,
    RECEIVER_ID,
    SECOND_ID,
    TARGET_ID,
    UNREAD,
    ModelWorld,
    Scope,
)
from missions.proofs.verify.rules import (
    Dead,
    across_rules,
    lowest_epoch,
    responsible_receiver,
    responsible_sender,
    used_epoch,
)
from path.messages import AbortReason
from path.protocol import receiver, sender
from path.protocol.values import (
    AbortRequested,
    AgreementComplete,
    Handoff,
    HandoffOutcome,
    NewMission,
    Offer,
    ReceiverRecord,
    SenderEvent,
    SenderRecord,
    Tick,
    VerifyAgain,
)

TICK = "a tick passes"

_CLOCKS = ((True, ""), (False, ", after a reboot"))
_PILOT = AbortRequested(AbortReason.PILOT)


class ModelStep(NamedTuple):
    """One step: what happened, what came of it, and the invariant it broke ("" when none)."""

    what: str
    world: ModelWorld
    broken: str = ""


class Moves:
    """All steps from a world, of one scope."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        self.effects = Effects(scope)
        self._senders = self.effects.senders.values
        self._receivers = self.effects.receivers.values
        self._across: dict[tuple[int, int, int, int], str] = {}
        self._giving: dict[int, bool] = {}
        self._taking: dict[tuple[int, int], bool] = {}

    def start(self, skew: int) -> ModelWorld:
        """Return the world in which nothing has begun; the receiver observes."""
        effects = self.effects
        scope = self.scope
        state = effects.senders(sender.Idle())
        held = effects.receivers(receiver.Observing())
        kept = effects.sender_records(SenderRecord())
        noted = effects.receiver_records(ReceiverRecord())
        if not scope.crashes:
            kept = noted = UNREAD
        second = held if scope.receivers > 1 else NOBODY
        packets = effects.said(state, held, skew, second)
        begun = ModelWorld(
            state,
            held,
            skew,
            packets,
            scope.crashes,
            scope.aborts,
            scope.attempts,
            kept,
            noted,
            second,
            0,
            0,
        )
        return begun

    def sender_of(self, world: ModelWorld) -> sender.SenderState | Dead:
        return self._senders[world.sender]

    def receiver_of(self, world: ModelWorld) -> receiver.ReceiverState | Dead:
        return self._receivers[world.receiver]

    def names(self, state: int, held: int) -> tuple[str, str]:
        """Return the names of a pair of the machines' states, by their numbers."""
        return type(self._senders[state]).__name__, type(self._receivers[held]).__name__

    def __call__(self, world: ModelWorld) -> Iterator[ModelStep]:
        if not isinstance(self.sender_of(world), Dead):
            for effect in self.effects.heard_by_sender(world.sender, world.packets):
                yield from self._sender_does(world, effect)
            yield from self._sender_program(world)
        if not isinstance(self.receiver_of(world), Dead):
            for effect in self.effects.heard_by_receiver(world.receiver, world.skew, world.packets):
                yield from self._receiver_does(world, effect)
            if world.aborts:
                told = self.effects.receiver_told(
                    world.receiver, world.skew, _PILOT, "a pilot takes the receiver"
                )
                yield from self._receiver_does(world._replace(aborts=world.aborts - 1), told)
        if world.second != NOBODY:
            heard = self.effects.heard_by_receiver(
                world.second, world.skew, world.packets, SECOND_ID
            )
            for effect in heard:
                yield self._second_does(world, effect)
        yield from self._time(world)
        yield from self._crashes(world)

    # --- time

    def _time(self, world: ModelWorld) -> Iterator[ModelStep]:
        """Either program notices what is due, at once or late by up to the guard; or a tick
        passes.
        """
        guard = self.scope.guard
        most = self.scope.uncertainty + self.scope.beyond
        gives = self.sender_of(world)
        takes = self.receiver_of(world)
        due = None if isinstance(gives, Dead) else sender.wake_ns(gives)
        waiting = None if isinstance(takes, Dead) else receiver.wake_ns(takes)
        if due is not None and due <= 0:
            effect = self.effects.sender_told(world.sender, Tick(), "the sender notices the time")
            yield from self._sender_does(world, _awaited(effect, world.sender))
        if waiting is not None and waiting <= world.skew:
            effect = self.effects.receiver_told(
                world.receiver, world.skew, Tick(), "the receiver notices the time"
            )
            yield from self._receiver_does(world, _awaited(effect, world.receiver))
        second = None if world.second == NOBODY else receiver.wake_ns(self._second_of(world))
        if second is not None and second <= world.skew:
            effect = self.effects.receiver_told(
                world.second, world.skew, Tick(), "the second receiver notices the time"
            )
            yield self._second_does(world, _awaited(effect, world.second))
        patient = self.scope.stalls
        if due is not None and 1 - due > guard and not patient:
            return
        for skew in range(max(world.skew - 1, -most), min(world.skew + 1, most) + 1):
            late = (skew + 1 - at > guard for at in (waiting, second) if at is not None)
            if patient or not any(late):
                yield self._tick(world, skew)

    def _tick(self, world: ModelWorld, skew: int) -> ModelStep:
        effects = self.effects
        state = effects.aged("sender", effects.senders, world.sender)
        held = effects.aged("receiver", effects.receivers, world.receiver)
        second = (
            NOBODY
            if world.second == NOBODY
            else effects.aged("receiver", effects.receivers, world.second)
        )
        after = ModelWorld(
            state,
            held,
            skew,
            effects.packets_aged(world.packets) | effects.said(state, held, skew, second),
            world.crashes,
            world.aborts,
            world.attempts,
            effects.aged("sender record", effects.sender_records, world.sender_kept),
            effects.aged("receiver record", effects.receiver_records, world.receiver_kept),
            second,
            world.agreed,
            min(world.alone + 1, self.scope.longest_gap + 1)
            if self._bounded and self._nobody(world)
            else 0,
        )
        return ModelStep(TICK, after, self._overdue(after) if self._bounded else "")

    @property
    def _bounded(self) -> bool:
        """Programs are awake in time, and each gap and wait may be held against its bound."""
        return not self.scope.stalls and self.scope.receivers == 1

    def _gives(self, state: int) -> bool:
        """Return whether a sender in this state is responsible."""
        found = self._giving.get(state)
        if found is None:
            found = self._giving[state] = responsible_sender(self._senders[state])
        return found

    def _takes(self, held: int, skew: int) -> bool:
        """Return whether a receiver in this state is responsible."""
        found = self._taking.get((held, skew))
        if found is None:
            found = self._taking[held, skew] = responsible_receiver(self._receivers[held], skew)
        return found

    def _second_of(self, world: ModelWorld) -> receiver.ReceiverState:
        second = self._receivers[world.second]
        assert not isinstance(second, Dead)
        return second

    def _nobody(self, world: ModelWorld) -> bool:
        """Return whether nobody is responsible, though whoever would have to be runs."""
        gives = self.sender_of(world)
        takes = self.receiver_of(world)
        if isinstance(gives, Dead | sender.Idle) or sender.is_responsible(gives):
            return False  # of a sender that is idle nothing is asked
        if isinstance(takes, Dead):
            return not isinstance(gives, sender.HandedOver)
        return not receiver.is_responsible(takes, world.skew)

    def _overdue(self, world: ModelWorld) -> str:
        """L1: everything that waits, ends. L2: no gap but the orphan, and neither side takes that
        for all well.
        """
        state = self.sender_of(world)
        held = self.receiver_of(world)
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
        match held:
            case receiver.Provisional():
                late = late or held.lease_end_ns < world.skew + latest
            case receiver.LetGo(settled=None):
                late = late or held.settle_end_ns < world.skew + latest
            case _:
                pass
        if late:
            return "L1"
        if world.alone <= self.scope.longest_gap:
            return ""
        if not (isinstance(state, sender.HandedOver) and isinstance(held, receiver.LetGo)):
            return "L2"
        if held.settled is HandoffOutcome.TAKEN_BACK:
            return "L2"  # the receiver believes that all is well
        # who may have let go of what the sender knows to be held
        no_pilot = world.aborts == self.scope.aborts
        return "L2" if state.settled is HandoffOutcome.HANDED_OVER and no_pilot else ""

    # --- the sender's program

    def _sender_program(self, world: ModelWorld) -> Iterator[ModelStep]:
        state = self.sender_of(world)
        if world.attempts:
            begun = world._replace(attempts=world.attempts - 1)
            if isinstance(state, sender.Keeping | sender.TakenBack) or self._free(world):
                yield from self._tell_sender(
                    begun, Offer(HANDOFF_ID, TARGET_ID), "the sender offers the target"
                )
            if isinstance(state, sender.TakenBack):
                yield from self._tell_sender(begun, VerifyAgain(), "the sender verifies again")
        if isinstance(state, sender.Keeping | sender.TakenBack | sender.HandedOver):
            yield from self._tell_sender(
                world, NewMission(), "the sender has landed, and begins a new mission"
            )
        if isinstance(state, sender.Verifying):
            yield from self._agreements(world, state.live)
        if world.aborts:
            yield from self._tell_sender(
                world._replace(aborts=world.aborts - 1), _PILOT, "a pilot takes the sender"
            )

    def _free(self, world: ModelWorld) -> bool:
        """An idle sender takes off, and offers, only when it has heard that the receiver holds
        nothing.
        """
        gives = self.sender_of(world)
        takes = self.receiver_of(world)
        if not isinstance(gives, sender.Idle):
            return False
        return gives.epoch == 0 or not (
            isinstance(takes, Dead) or receiver.is_responsible(takes, world.skew)
        )

    def _agreements(self, world: ModelWorld, live: Handoff) -> Iterator[ModelStep]:
        """The one that the window counted, and those of which nothing may come (S5)."""
        nonce = 100 * live.epoch
        told = self.scope.uncertainty
        # whichever of them is heard
        for instance in (RECEIVER_ID, SECOND_ID)[: self.scope.receivers]:
            whole = AgreementComplete(live.epoch, TARGET_ID, nonce, told, instance)
            yield from self._tell_sender(
                world._replace(agreed=live.epoch), whole, "the agreement is complete"
            )
        for wrong, what in (
            (
                AgreementComplete(live.epoch - 1, TARGET_ID, nonce, told, RECEIVER_ID),
                "an agreement of an earlier attempt is told",
            ),
            (
                AgreementComplete(live.epoch, OTHER_ID, nonce, told, RECEIVER_ID),
                "an agreement on another object is told",
            ),
            (
                AgreementComplete(live.epoch, TARGET_ID, nonce, None, RECEIVER_ID),
                "an agreement is told without clocks",
            ),
            (
                AgreementComplete(live.epoch, TARGET_ID, nonce, told, None),
                "an agreement is told with two receivers",
            ),
        ):
            yield from self._tell_sender(world, wrong, what)

    def _tell_sender(self, world: ModelWorld, event: SenderEvent, what: str) -> Iterator[ModelStep]:
        return self._sender_does(world, self.effects.sender_told(world.sender, event, what))

    # --- crashes

    def _crashes(self, world: ModelWorld) -> Iterator[ModelStep]:
        """Killed at any moment, with whatever is on disk; started again at any later one."""
        gives = self.sender_of(world)
        takes = self.receiver_of(world)
        if world.crashes and not isinstance(gives, Dead):
            yield ModelStep("the sender is killed", self._sender_killed(world, world.sender_kept))
        if world.crashes and not isinstance(takes, Dead):
            yield ModelStep(
                "the receiver is killed", self._receiver_killed(world, world.receiver_kept)
            )
        if isinstance(gives, Dead):
            for same_clock, how in _CLOCKS:
                for read, lost in self._read(world.sender_kept, self.effects.sender_records):
                    yield self._sender_restarted(world, read, same_clock, how + lost)
        if isinstance(takes, Dead):
            for same_clock, how in _CLOCKS:
                for read, lost in self._read(world.receiver_kept, self.effects.receiver_records):
                    held, kept = self.effects.receiver_restored(read, world.skew, same_clock)
                    up = world._replace(receiver=held, receiver_kept=kept)
                    yield self._checked(world, up, f"the receiver is started again{how}{lost}", "")

    def _read(self, kept: int, interned: Interned[Any]) -> tuple[tuple[int, str], ...]:
        """Return what a program may find on its disk: its record, an earlier one, or none."""
        if not self.scope.forgetful:
            return ((kept, ""),)
        record = interned.values[kept]
        earlier = (
            SenderRecord(record.epoch, "mine")
            if isinstance(record, SenderRecord)
            else ReceiverRecord(record.epoch)
        )
        nothing = type(record)()
        return (
            (kept, ""),
            (interned(earlier), ", on an earlier record"),
            (interned(nothing), ", its record lost"),
        )

    def _sender_restarted(
        self, world: ModelWorld, read: int, same_clock: bool, how: str
    ) -> ModelStep:
        state, kept = self.effects.sender_restored(read, same_clock)
        alone = world.alone if same_clock else 0  # a new clock begins anew what is waited for
        up = world._replace(sender=state, sender_kept=kept, alone=alone)
        mine = self.effects.sender_records.values[read].duty == "mine"
        lost = "L2" if mine and not responsible_sender(self.sender_of(up)) else ""
        return self._checked(world, up, f"the sender is started again{how}", lost)

    def _sender_killed(self, world: ModelWorld, kept: int) -> ModelWorld:
        state = self.sender_of(world)
        dead = self.effects.senders(Dead(used_epoch(state), isinstance(state, sender.HandedOver)))
        return world._replace(sender=dead, sender_kept=kept, crashes=world.crashes - 1)

    def _receiver_killed(self, world: ModelWorld, kept: int) -> ModelWorld:
        dead = self.effects.receivers(Dead(lowest_epoch(self.receiver_of(world))))
        return world._replace(receiver=dead, receiver_kept=kept, crashes=world.crashes - 1)

    # --- a machine's step, with all that may interrupt it

    def _sender_does(self, world: ModelWorld, effect: Effect) -> Iterator[ModelStep]:
        broken = effect.broken
        if any(commit != (world.agreed, TARGET_ID) for commit in effect.commits):
            broken = broken or "S5"
        kept = world.sender_kept if effect.kept < 0 else effect.kept
        after = world.stepped(effect.sent, sender=effect.state, sender_kept=kept)
        yield self._checked(world, after, effect.what, broken)
        if world.crashes:
            for sent, half_kept in effect.halves:
                half = world.stepped(sent)
                dead = self._sender_killed(half, world.sender_kept if half_kept < 0 else half_kept)
                yield ModelStep(f"{effect.what}; it is killed half-way", dead)

    def _receiver_does(self, world: ModelWorld, effect: Effect) -> Iterator[ModelStep]:
        kept = world.receiver_kept if effect.kept < 0 else effect.kept
        after = world.stepped(effect.sent, receiver=effect.state, receiver_kept=kept)
        yield self._checked(world, after, effect.what, effect.broken)
        if world.crashes:
            for sent, half_kept in effect.halves:
                half = world.stepped(sent)
                dead = self._receiver_killed(
                    half, world.receiver_kept if half_kept < 0 else half_kept
                )
                yield ModelStep(f"{effect.what}; it is killed half-way", dead)

    def _second_does(self, world: ModelWorld, effect: Effect) -> ModelStep:
        after = world.stepped(effect.sent, second=effect.state)
        return self._checked(world, after, effect.what, effect.broken)

    def _checked(self, before: ModelWorld, after: ModelWorld, what: str, broken: str) -> ModelStep:
        (
            state,
            held,
            skew,
            packets,
            crashes,
            aborts,
            attempts,
            sender_kept,
            receiver_kept,
            second,
            agreed,
            alone,
        ) = after
        gives = self._gives(state)
        takes = self._takes(held, skew)
        key = before.sender, state, before.receiver, held
        across = self._across.get(key)
        if across is None:
            senders = self._senders
            receivers = self._receivers
            across = across_rules(
                senders[key[0]], senders[state], receivers[key[2]], receivers[held]
            )
            self._across[key] = across
        broken = broken or across
        if gives + takes + (second != NOBODY and self._takes(second, skew)) > 1:
            broken = broken or "S1"
        if not crashes:  # nobody will ever read it
            sender_kept = sender_kept if isinstance(self._senders[state], Dead) else UNREAD
            receiver_kept = receiver_kept if isinstance(self._receivers[held], Dead) else UNREAD
        packets |= self.effects.said(state, held, skew, second)
        alone = 0 if gives or takes else alone
        world = ModelWorld(
            state,
            held,
            skew,
            packets,
            crashes,
            aborts,
            attempts,
            sender_kept,
            receiver_kept,
            second,
            agreed,
            alone,
        )
        return ModelStep(what, world, broken)


def _awaited(effect: Effect, state: int) -> Effect:
    """A machine that asked to be told of this instant has to make something of it (L1)."""
    return effect._replace(broken="L1") if effect.state == state and not effect.broken else effect
