"""Both sides of the hand-over: what a mission asks of its machine of the protocol, and what its
course makes of it.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable

from drivers.interfaces import Received, RecordStore
from flight.outcome import MissionEnd, Outcome
from missions.fly.leg.machine_run import MachineRun, until
from missions.fly.leg.session import RoleSession
from path.messages import Commit, Message
from path.protocol import receiver, sender
from path.protocol.receiver import Holding, LetGo, Provisional, ReceiverMachine
from path.protocol.sender import AwaitingAccept, HandedOver, Idle, Keeping, SenderMachine
from path.protocol.values import (
    AgreementComplete,
    CommitHeard,
    Handoff,
    Heard,
    Offer,
    PeerStatus,
    ProtocolConfig,
    ReceiverEvent,
    ReceiverRecord,
    Refusal,
    SenderRecord,
    TakeResponsibility,
    VerifyAgain,
)
from path.protocol.values import HandoffOutcome as Decision

_HEARD_S = 2.0  # a receiver not heard for so long is gone: it says its Status four times a second
_LAST_INSTANCE = 2**24 - 1


def _instance(machine: ReceiverMachine, entropy: random.Random) -> int:
    """A program's own, unless it goes on with what an earlier one took: then that one's, or nobody
    would believe it.
    """
    live = machine.live
    return (
        live.instance if live is not None and live.instance else entropy.randint(1, _LAST_INSTANCE)
    )


def protocol_config(session: RoleSession) -> ProtocolConfig:
    """The protocol's deadlines for this mission: it may not end a handoff before the mission itself
    does.
    """
    deadlines = session.config.deadlines
    return ProtocolConfig.of_clocks(
        session.config.clock_uncertainty_s,
        offer_s=deadlines.receiver_ready_s + deadlines.verify_s,
        handoff_s=deadlines.receiver_ready_s + 2.0 * deadlines.verify_s,
    )


class SenderHandover(MachineRun[SenderMachine]):
    """D1's side."""

    def __init__(self, session: RoleSession, store: RecordStore) -> None:
        config = protocol_config(session)
        kept = store.load()
        machine = SenderMachine(config)
        if kept is not None:
            assert isinstance(kept.record, SenderRecord)
            machine.state = sender.restored(
                config, kept.record, session.now_ns(), same_clock=kept.same_clock
            )
        super().__init__(session, store, machine, kept, sender.record(machine.state))
        self._anew_ns = session.now_ns()
        # of each receiver the newest Status, and when it came
        self._words: dict[int, tuple[int, PeerStatus]] = {}
        self._warned = False
        # when the boxes agreed and nothing could be begun: what was in the way
        self._agreed_in_vain: tuple[Outcome, str] | None = None
        session.instance = lambda: 0 if self._machine.live is None else self._machine.live.instance
        if kept is not None:  # on the ground a new mission begins: nobody tracks its target yet
            session.set_claim(
                TakeResponsibility()
                if machine.responsible and session.vehicle.state.armed
                else None
            )

    def undecided(self, flying: bool) -> bool:
        state = self._machine.state
        return isinstance(state, AwaitingAccept) or (
            flying and isinstance(state, HandedOver) and not state.settled
        )

    @property
    def epoch(self) -> int:
        """The epoch of the attempt under way; 0 before the first."""
        return 0 if isinstance(self._done, Idle | Keeping) else self._done.live.epoch

    @property
    def released(self) -> bool:
        """Given away, or about to be: this drone is not responsible."""
        return isinstance(self._machine.state, AwaitingAccept | HandedOver)

    @property
    def handed_over(self) -> bool:
        return isinstance(self._machine.state, HandedOver)

    def begin_anew(self) -> None:
        self._anew_ns = self._session.now_ns()
        super().begin_anew()

    def _on_status(self, status: PeerStatus) -> None:
        super()._on_status(status)
        self._words[status.instance] = self._session.now_ns(), status

    @property
    def peer_is_free(self) -> bool:
        """The other drone said that it holds nothing, and said so since this one has nothing left
        to give to it.

        Of several receivers none may hold anything, as far as each was heard last.
        """
        words = [status for _, status in self._words.values()]
        lately = any(status.stamp_ns > self._anew_ns for status in words)
        return lately and not any(status.responsible for status in words)

    @property
    def receivers(self) -> tuple[int, ...]:
        """Instances of the receivers that are heard on this link at present: one, if all is
        well.
        """
        since_ns = self._session.now_ns() - round(_HEARD_S * 1e9)
        return tuple(
            instance
            for instance, (heard_ns, _) in self._words.items()
            if instance and heard_ns > since_ns
        )

    async def until_free(self) -> None:
        """Wait until the other drone is heard not to hold a target.

        Raises MissionEnd(PEER_ABORTED) when it goes on to.
        """
        session = self._session
        await session.until(
            lambda: self.peer_is_free,
            session.config.deadlines.peer_s,
            Outcome.PEER_ABORTED,
            "the receiver did not let go of an earlier handoff's target",
        )

    async def offer(self) -> None:
        """The target is tracked: this drone is responsible for it from now on, and offers it.
        Raises StateError.
        """
        self.begin_offer()
        await self._written()  # nothing is said in an epoch that a restart would begin once more

    def begin_offer(self) -> None:
        """``offer``, without waiting for the disk."""
        config = self._session.config
        self._step(Offer(config.handoff_id, config.target_id))
        self._start_ticking()

    def agreed(self, target_id: int) -> None:
        """The whole window agreed: release, then commit to the one receiver that is heard.

        Refused while the clocks are not known, or not exactly one is heard; may be said again.
        """
        if self.released:
            return
        session = self._session
        alignment = self._session.alignment
        receivers = self.receivers
        self._agreed_in_vain = None
        if len(receivers) > 1 and not self._warned:
            self._warned = True
            session.say(
                f"{len(receivers)} receivers answer with this key on this link: no COMMIT until one is left"
            )
        lease_end_ns = session.now_ns() + round(self._machine.config.lease_s * 1e9)
        uncertainty = alignment.uncertainty_at(lease_end_ns) if alignment.ready else None
        instance = receivers[0] if len(receivers) == 1 else None
        self._step(
            AgreementComplete(
                self.epoch, target_id, session.entropy.getrandbits(32), uncertainty, instance
            )
        )
        refused = None if self.released else self._carrier.refused
        if refused is Refusal.NO_CLOCK:
            self._agreed_in_vain = Outcome.CLOCK_FAULT, session.clocks_known
        elif refused is Refusal.NOT_ONE_RECEIVER:
            why = f"{len(receivers)} receivers are heard, and one is needed"
            self._agreed_in_vain = Outcome.NO_AGREEMENT, why

    def on_message(self, received: Received) -> None:
        self._hear(lambda: Heard(received.message))

    def verify_again(self) -> None:
        """Verify once more after taking back, in the new epoch."""
        self._carrier.ended = None
        self._step(VerifyAgain())

    async def until_decided(self, timeout_s: float, verify_again: Callable[[], None]) -> None:
        """Wait until the receiver has accepted the target.

        An attempt that was committed and not accepted is taken back and verified again, as long as
        there is time. Raises MissionEnd otherwise.
        """
        carrier = self._carrier
        end_s = asyncio.get_running_loop().time() + timeout_s
        while True:
            if not await until(lambda: carrier.ended is not None or self.released, end_s):
                raise self._not_agreed(f"no agreement within {timeout_s:.0f} s")
            # a commit under way is decided by its lease, not by the deadline
            await until(lambda: carrier.ended is not None, math.inf)
            assert carrier.ended is not None
            decision = carrier.ended.outcome
            if decision is Decision.HANDED_OVER:
                return
            if decision is Decision.TIMEOUT:
                raise self._not_agreed(decision.value)
            if decision is not Decision.TAKEN_BACK:
                raise MissionEnd(Outcome.PEER_ABORTED, decision.value)
            self.verify_again()
            verify_again()

    def _not_agreed(self, said: str) -> MissionEnd:
        """Return the end of a time that is over: the boxes may have agreed, and something else be
        what was in the way.
        """
        if self._agreed_in_vain is None:
            return MissionEnd(Outcome.NO_AGREEMENT, said)
        outcome, why = self._agreed_in_vain
        return MissionEnd(outcome, f"the boxes agree, and no hand-over was begun: {why}")

    async def until_settled(self) -> None:
        """Wait after ``until_decided`` until the receiver is known to hold the target, or nobody
        can say.
        """
        carrier = self._carrier
        await until(lambda: carrier.settled is not None, math.inf)
        if carrier.settled is None or carrier.settled.outcome is not Decision.HANDED_OVER:
            raise MissionEnd(Outcome.ORPHANED, "the receiver did not say that it holds the target")

    def end(self, end: MissionEnd | None) -> None:
        """The mission ends on this side: nothing is transferred any more, unless it already was."""
        if not self.handed_over:
            self._give_up(end)


class ReceiverHandover(MachineRun[ReceiverMachine]):
    """D2's side. ``able``: whether this drone sees the target and could follow it now."""

    def __init__(self, session: RoleSession, store: RecordStore, able: Callable[[], bool]) -> None:
        config = protocol_config(session)
        kept = store.load()
        machine = ReceiverMachine(config)
        if kept is not None:
            assert isinstance(kept.record, ReceiverRecord)
            machine.state = receiver.restored(
                config, kept.record, session.now_ns(), same_clock=kept.same_clock
            )
        super().__init__(session, store, machine, kept, receiver.record(machine.state))
        self._able = able
        self.instance = _instance(machine, session.entropy)
        session.instance = lambda: self.instance
        if kept is not None:
            session.set_claim(receiver.claim(machine.state))

    def undecided(self, flying: bool) -> bool:
        state = self._machine.state
        return isinstance(state, Provisional) or (
            flying and isinstance(state, LetGo) and not state.settled
        )

    @property
    def live(self) -> Handoff | None:
        """The attempt this drone takes part in, once that is written down."""
        return self._done.live

    @property
    def holds(self) -> bool:
        """Responsible, provisionally or for good, at this very instant."""
        return self._machine.responsible(self._session.now_ns())

    @property
    def within_lease(self) -> bool:
        """Return whether it took provisionally, and nothing is decided yet: the lease decides, be
        it over.
        """
        return isinstance(self._machine.state, Provisional)

    @property
    def holds_for_good(self) -> bool:
        return isinstance(self._machine.state, Holding)

    def start(self) -> None:
        self._start_ticking()

    def on_message(self, received: Received) -> None:
        self._hear(lambda: self._event(received.message))

    def _event(self, message: Message) -> ReceiverEvent:
        if not isinstance(message, Commit):
            return Heard(message)
        alignment = self._session.alignment
        lease_end_ns = alignment.to_own_ns(message.lease_end_ns) if alignment.ready else None
        uncertainty = alignment.uncertainty_at(lease_end_ns) if lease_end_ns is not None else 0
        return CommitHeard(message, lease_end_ns, uncertainty, self.instance, self._able())

    async def until_held(self, timeout_s: float) -> None:
        """Wait until this drone holds the target for good. Raises MissionEnd otherwise.

        An attempt that the sender took back may be followed by another one, as long as there is
        time.
        """
        carrier = self._carrier
        end_s = asyncio.get_running_loop().time() + timeout_s
        while (
            await until(lambda: carrier.ended is not None, end_s) or self.within_lease or self.holds
        ):
            # within a lease, the lease decides and not the deadline
            await until(lambda: carrier.ended is not None, math.inf)
            assert carrier.ended is not None
            decision = carrier.ended.outcome
            carrier.ended = None
            if decision is Decision.HANDED_OVER:
                return
            if decision is Decision.LET_GO:
                await until(lambda: carrier.settled is not None, math.inf)
                assert carrier.settled is not None
                settled = carrier.settled.outcome
                carrier.settled = None
                if settled is not Decision.TAKEN_BACK:
                    raise MissionEnd(
                        Outcome.ORPHANED,
                        f"the lease ended without the sender's word: {settled.value}",
                    )
            elif decision is Decision.TIMEOUT:
                raise MissionEnd(Outcome.NO_AGREEMENT, decision.value)
            elif decision is not Decision.SUPERSEDED:
                raise MissionEnd(Outcome.PEER_ABORTED, decision.value)
        raise MissionEnd(Outcome.NO_AGREEMENT, f"no hand-over within {timeout_s:.0f} s")

    def end(self, end: MissionEnd | None) -> None:
        """The mission ends on this side: a target held for good stays held; anything else is given
        up.
        """
        if not self.holds_for_good:
            self._give_up(end)
