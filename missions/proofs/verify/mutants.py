"""Machines that skip one rule each. An explorer that does not catch every one of them proves
nothing.

They are here and not with the tests because ``path-handoff verify`` shows on every machine that it
catches them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from types import ModuleType
from typing import Any

from missions.proofs.verify.explore import ANY, Covering, Exploration, explore
from missions.proofs.verify.model import Scope
from path.protocol import receiver, sender
from path.protocol.values import Persist, Refusal, Release, Send
from path.values import frozen

Patch = tuple[ModuleType, str, Callable[[Any], Any]]
"""Module, name of a function in it, and what makes the wrong function from the right one."""

SMALL = Scope(lease=4)
CRASHING = replace(SMALL, crashes=1)
ABORTING = replace(SMALL, aborts=1)
TWICE = replace(SMALL, attempts=2)
SHORT = Scope(lease=3, offer=2, handoff=3)
SLEEPY = replace(SMALL, stalls=True)
TRIO = replace(SHORT, receivers=2)


@frozen
class Mutant:
    """A rule that is skipped, the invariants one of which this must break, and a scope in which it
    does.
    """

    rule: str
    breaks: tuple[str, ...]
    patches: Sequence[Patch]
    scope: Scope = field(default=SMALL)


@contextmanager
def wrong(mutant: Mutant) -> Generator[None, None, None]:
    """The machines, wrong in this one way."""
    right = [(module, name, getattr(module, name)) for module, name, _ in mutant.patches]
    try:
        for module, name, make in mutant.patches:
            setattr(module, name, make(getattr(module, name)))
        yield
    finally:
        for module, name, function in right:
            setattr(module, name, function)


def caught(mutant: Mutant) -> Exploration | None:
    """The exploration that shows an invariant broken which the mutant's rule keeps; None when there
    is none.
    """
    with wrong(mutant):
        found = explore(mutant.scope, until_broken=ANY, seen=Covering())
    return found if set(found.broken) & set(mutant.breaks) else None


def _without_persist(step: Any) -> Any:
    """The same step, which writes nothing down."""

    def forgetful(*arguments: Any) -> Any:
        state, actions = step(*arguments)
        return state, tuple(action for action in actions if not isinstance(action, Persist))

    return forgetful


def _early(commit: Any) -> Any:
    def impatient(*arguments: Any) -> Any:
        state, actions = commit(*arguments)
        if isinstance(state, sender.AwaitingAccept):
            state = replace(state, take_back_ns=state.commit.lease_end_ns)
        return state, actions

    return impatient


def _agreement_of_anything(commit: Any) -> Any:
    def careless(
        config: Any,
        state: Any,
        agreed: Any,
        now_ns: int,
    ) -> Any:
        return commit(
            config,
            state,
            replace(agreed, epoch=state.live.epoch, target_id=state.live.target_id),
            now_ns,
        )

    return careless


def _same_epoch_again(offer: Any) -> Any:
    def repeating(
        config: Any,
        state: Any,
        event: Any,
        now_ns: int,
    ) -> Any:
        before = (
            replace(state, epoch=state.epoch - 1)
            if isinstance(state, sender.Idle | sender.Keeping)
            else state
        )
        return offer(config, before, event, now_ns)

    return repeating


def _takes_back_when_unsure(settle: Any) -> Any:
    def greedy(state: Any, outcome: Any) -> Any:
        after, actions = settle(state, outcome)
        return (sender.Keeping(state.live.epoch), actions) if outcome.alarming else (after, actions)

    return greedy


def _confirms_what_was_aborted(hear_accept: Any) -> Any:
    def deaf(
        config: Any,
        state: Any,
        accept: Any,
        now_ns: int,
    ) -> Any:
        same = accept.nonce == state.commit.nonce
        return hear_accept(
            config,
            replace(state, withdrawn=None) if same else state,
            accept,
            now_ns,
        )

    return deaf


def _any_nonce(hear_accept: Any) -> Any:
    def trusting(
        config: Any,
        state: Any,
        accept: Any,
        now_ns: int,
    ) -> Any:
        return hear_accept(config, state, replace(accept, nonce=state.commit.nonce), now_ns)

    return trusting


def _in_order(*kinds: type[Any]) -> Callable[[Any], Any]:
    """The same step, with its actions of these kinds in this order, and the others after them."""

    def place(action: Any) -> int:
        return kinds.index(type(action)) if type(action) in kinds else len(kinds)

    def of(step: Any) -> Any:
        def reordered(*arguments: Any) -> Any:
            state, actions = step(*arguments)
            return state, tuple(sorted(actions, key=place))

        return reordered

    return of


def _blind_to(refusal: Refusal) -> Callable[[Any], Any]:
    def of(refuse: Any) -> Any:
        def blind(*arguments: Any) -> Any:
            why = refuse(*arguments)
            return None if why is refusal else why

        return blind

    return of


def _responsible_by_flag(_: Any) -> Any:
    def flag(state: Any, now_ns: int) -> bool:
        del now_ns
        return receiver.claim(state) is not None

    return flag


def _of_any_receiver(mismatch: Any) -> Any:
    def blind(live: Any, message: Any) -> Any:
        why = mismatch(live, message)
        return None if why is Refusal.WRONG_INSTANCE else why

    return blind


def _told_by_any_receiver(tells: Any) -> Any:
    def trusting(state: Any, status: Any) -> Any:
        return tells(state, replace(status, instance=state.live.instance))

    return trusting


def _never_lets_go(elapse: Any) -> Any:
    def clinging(
        config: Any,
        state: Any,
        now_ns: int,
    ) -> Any:
        return (
            (state, ())
            if isinstance(state, receiver.Provisional)
            else elapse(config, state, now_ns)
        )

    return clinging


def _restored_as(make: Callable[[Any, int], Any]) -> Callable[[Any], Any]:
    """A restart that makes this of the record and the time, when it has one of a handoff."""

    def of(restored: Any) -> Any:
        def wrong_restart(
            config: Any,
            kept: Any,
            now_ns: int,
            *,
            same_clock: bool = True,
        ) -> Any:
            if kept.live is None:
                return restored(config, kept, now_ns, same_clock=same_clock)
            return make(kept, now_ns)

        return wrong_restart

    return of


def _restored_idle_as(make: Callable[[int], Any]) -> Callable[[Any], Any]:
    """A restart that makes this of the epoch, when nothing is given away."""

    def of(restored: Any) -> Any:
        def wrong_restart(
            config: Any,
            kept: Any,
            now_ns: int,
            *,
            same_clock: bool = True,
        ) -> Any:
            return (
                make(kept.epoch)
                if kept.live is None
                else restored(config, kept, now_ns, same_clock=same_clock)
            )

        return wrong_restart

    return of


def _holds_on(kept: Any, now_ns: int) -> Any:
    match kept.duty:
        case "holding":
            return receiver.Holding(kept.live, kept.nonce)
        case "provisional":
            return receiver.Provisional(kept.live, kept.nonce, now_ns + 2, now_ns, kept.sure_ns)
        case _:
            return receiver.LetGo(
                kept.live,
                kept.nonce,
                kept.sure_ns,
                max(kept.sure_ns, now_ns) + 2,
            )


def _always(value: Any) -> Callable[[Any], Any]:
    def of(_: Any) -> Any:
        def constant(*arguments: Any) -> Any:
            del arguments
            return value

        return constant

    return of


def _never_taken_back(_: Any) -> Any:
    def idle(state: Any) -> Any:
        return state, ()

    return idle


def _lease_to_the_end(_: Any) -> Any:
    def unguarded(
        config: Any,
        lease_end_ns: int,
        uncertainty_ns: int,
    ) -> int:
        del config, uncertainty_ns
        return lease_end_ns

    return unguarded


def _lease_without_guard(_: Any) -> Any:
    def tight(
        config: Any,
        lease_end_ns: int,
        uncertainty_ns: int,
    ) -> int:
        del config
        return lease_end_ns - uncertainty_ns

    return tight


MUTANTS = (
    Mutant("the receiver keeps its lease to the end of its own clock", ("S3", "S1"), [
        (receiver, "_lease_end_ns", _lease_to_the_end)]),
    Mutant("the receiver leaves its program no time to act", ("S3",), [
        (receiver, "_lease_end_ns", _lease_without_guard)]),
    Mutant("the sender takes back without the clocks' uncertainty", ("S1", "S4"), [(sender, "_commit", _early)]),
    Mutant("the sender does not write down that it released", ("S1",), [
        (sender, "_commit", _without_persist)], CRASHING),
    Mutant("the sender does not write down that it was accepted", ("S1", "L2"), [
        (sender, "_hear_accept", _without_persist)], CRASHING),
    Mutant("the sender begins again in the epoch it had", ("S2",), [(sender, "_offer", _same_epoch_again)], TWICE),
    Mutant("the receiver does not write its epoch down", ("S2",), [(receiver, "step", _without_persist)], CRASHING),
    Mutant("the receiver takes over when the lease is over", ("S3", "S6"), [
        (receiver, "_lease_refusal", _blind_to(Refusal.LEASE_OVER))]),
    Mutant("the receiver believes any lease, however long", ("S6",), [
        (receiver, "_lease_refusal", _blind_to(Refusal.LEASE_TOO_LONG))]),
    Mutant("the receiver never lets go", ("L1", "S1"), [(receiver, "_elapse", _never_lets_go)]),
    Mutant("the sender says COMMIT before it is written down", ("S1",), [
        (sender, "_commit", _in_order(Release, Send, Persist))], CRASHING),
    Mutant("the receiver says ACCEPT before it is written down", ("L2",), [
        (receiver, "_hear_commit", _in_order(Send, Persist))], CRASHING),
    Mutant("the sender starts again as if it had given nothing away", ("S1", "S4"), [
        (sender, "restored", _restored_as(lambda kept, _: sender.Keeping(kept.epoch)))], CRASHING),
    Mutant("the sender starts again as if the target of an earlier mission were its own", ("S1",), [
        (sender, "restored", _restored_idle_as(sender.Keeping))], CRASHING),
    Mutant("the sender starts again as if it had never had the target", ("L2",), [
        (sender, "restored", _restored_idle_as(sender.Idle))], CRASHING),
    Mutant("the receiver starts again as if it held nothing", ("L2",), [
        (receiver, "restored", _restored_as(lambda kept, _: receiver.Observing(kept.epoch + 1)))], CRASHING),
    Mutant("the receiver starts again with a lease of its own", ("S1",), [
        (receiver, "restored", _restored_as(_holds_on))], CRASHING),
    Mutant("the sender says COMMIT, and then releases", ("S4",), [
        (sender, "_commit", _in_order(Send, Persist, Release))]),
    Mutant("the sender takes back when it is not sure", ("S1", "S4"), [(sender, "_settle", _takes_back_when_unsure)]),
    Mutant("any agreement is good enough for a COMMIT", ("S5",), [(sender, "_commit", _agreement_of_anything)], TWICE),
    Mutant("the sender takes words about other handoffs", ("S6",), [(sender, "mismatch", _always(None))]),
    Mutant("the receiver takes words about other handoffs", ("S6",), [(receiver, "mismatch", _always(None))]),
    Mutant("the sender takes an ACCEPT of any COMMIT", ("S6",), [(sender, "_hear_accept", _any_nonce)]),
    Mutant("the sender waits for an agreement for ever", ("L1",), [(sender, "_deadline_ns", _always(1 << 40))]),
    Mutant("the sender never takes back", ("L1", "L2"), [(sender, "_take_back", _never_taken_back)]),
    Mutant("the sender confirms what it has aborted", ("L2",), [
        (sender, "_hear_accept", _confirms_what_was_aborted)], ABORTING),
    Mutant("the receiver is responsible until somebody has told it that its lease is over", ("S1",), [
        (receiver, "is_responsible", _responsible_by_flag)], SLEEPY),
    Mutant("the receiver takes the COMMIT that is another's", ("S1", "S6"), [
        (receiver, "mismatch", _of_any_receiver)], TRIO),
    Mutant("the sender takes an ACCEPT of any receiver", ("S6",), [(sender, "mismatch", _of_any_receiver)]),
    Mutant("the sender believes any receiver's Status", ("S6",), [(sender, "_tells", _told_by_any_receiver)]),
)  # fmt: skip
"""At least one for each invariant."""
