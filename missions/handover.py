"""The hand-over protocol on a role's link: the machines decide, this carries out what they want done.

What a machine wants written down is on the disk before anything that follows is done or sent, so that the program may
die between any two lines of this file and be started again. Only the machine waits for the disk: what it is told
meanwhile comes to it after, as if the link had been that much slower, and the drone is flown on.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, Generic, TypeVar

from drivers.interfaces import Kept, Received, RecordStore, StateError
from flight.outcome import MissionEnd, Outcome, abort_reason
from missions.session import Session
from path.messages import AbortReason, Commit, Message, Status
from path.protocol import receiver, sender
from path.protocol.receiver import Holding, LetGo, Provisional, ReceiverMachine
from path.protocol.sender import AwaitingAccept, HandedOver, Idle, Keeping, SenderMachine
from path.protocol.values import (
    AbortRequested,
    Action,
    Actions,
    AgreementComplete,
    CommitHeard,
    Ended,
    Handoff,
    Heard,
    NewMission,
    Offer,
    PeerStatus,
    Persist,
    ProtocolConfig,
    ReceiverEvent,
    ReceiverRecord,
    Refused,
    Release,
    Send,
    SenderRecord,
    Settled,
    TakeResponsibility,
    Tick,
    VerifyAgain,
)
from path.protocol.values import Outcome as Decision

Machine = TypeVar("Machine", SenderMachine, ReceiverMachine)

_TAKE = TakeResponsibility(provisional=True)
_TICK_S = 0.1  # at the longest
_MAX_WAITING = 64  # messages while the disk is written to; what counts is said again
_WRITTEN_S = 2.0  # wait for the disk before the program ends


def protocol_config(session: Session) -> ProtocolConfig:
    """The protocol's deadlines for this mission: it may not end a handoff before the mission itself does."""
    deadlines = session.config.deadlines
    return ProtocolConfig(
        offer_s=deadlines.receiver_ready_s + deadlines.verify_s,
        handoff_s=deadlines.receiver_ready_s + 2.0 * deadlines.verify_s,
    )


class _Carrier:
    """Carries out actions of a machine, and remembers what was decided."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.ended: Ended | None = None
        self.settled: Settled | None = None

    def carry_out(self, action: Action) -> None:
        """A record to be written down has been."""
        session = self.session
        match action:
            case Send(message):
                session.link.send(message)
                if isinstance(message, Commit):
                    self._log("/commit", target_id=message.target_id, epoch=message.epoch, nonce=message.nonce,
                              lease_end_ns=message.lease_end_ns)  # fmt: skip
            case Persist(record):
                self._log("/epoch", epoch=record.epoch, duty=record.duty)
            case TakeResponsibility(provisional):
                session.set_responsible(True, provisional)
            case Release():
                session.set_responsible(False)
            case Ended():
                self.ended = action
                self._log("/decision", outcome=action.outcome.value, reason=_value(action.reason))
            case Settled():
                self.settled = action
                self._log("/settled", outcome=action.outcome.value)
            case Refused(why):
                self._log("/refused", why=why.value)

    def _log(self, topic: str, **record: object) -> None:
        self.session.log.write(topic, self.session.now_ns(), record)


def _value(reason: AbortReason | None) -> str | None:
    return None if reason is None else reason.value


async def _until(condition: Callable[[], bool], end_s: float) -> bool:
    """Poll a condition until a time of the loop; whether it came true."""
    loop = asyncio.get_running_loop()
    while not condition():
        if loop.time() > end_s:
            return False
        await asyncio.sleep(_TICK_S)
    return True


class _Handover(Generic[Machine]):
    """A machine on its role's link: messages, statuses and time in, actions carried out.

    Its state is written down before anything else: a restored one's instants are of this clock from now on, and a disk
    that cannot be written to is found before anything flies. Raises StateError.
    """

    def __init__(
        self,
        session: Session,
        store: RecordStore,
        machine: Machine,
        kept: Kept | None,
        made: SenderRecord | ReceiverRecord,
    ) -> None:
        self._session = session
        self._store = store
        self._machine = machine
        self._carrier = _Carrier(session)
        self._kept = kept
        self._ticking = False
        self._writing: asyncio.Task[None] | None = None
        self._waiting: deque[Callable[[], Any]] = deque()  # events, made when their turn comes
        self._moved = asyncio.Event()  # the machine's next deadline
        self._done = machine.state  # the newest state all of whose actions were carried out
        store.save(made)
        if kept is not None:  # the log of a program that was started again begins with what it made of its record
            self._carrier.carry_out(Persist(made))

    async def resume(self) -> None:
        """Before anything else is begun, what a restart left undecided is decided, and the other drone answered.

        On the ground a new mission begins then: what an earlier one gave away or held is over. In the air it raises
        MissionEnd(RESTARTED): a course is not taken up in its middle.
        """
        if self._kept is None:
            return
        self._start_ticking()
        flying = self._session.vehicle.state.armed
        await _until(lambda: not self.undecided(flying), math.inf)
        await self._written()
        if flying:
            raise MissionEnd(Outcome.RESTARTED, f"started again in the air, {self._kept.record.duty}")
        self.begin_anew()
        await self._written()

    def begin_anew(self) -> None:
        """On the ground, with nothing undecided: what an earlier mission gave away or held is over."""
        self._carrier.ended = self._carrier.settled = None
        self._step(NewMission())

    def undecided(self, flying: bool) -> bool:
        """Something is still to come of an earlier handoff; in the air, also whether it is orphaned."""
        raise NotImplementedError

    def _start_ticking(self) -> None:
        if not self._ticking:
            self._ticking = True
            self._session.spawn(self._tick())

    @property
    def state(self) -> Any:
        """The machine's, for whoever watches it; ``carried_out`` is the newest one whose actions all were."""
        return self._machine.state

    @property
    def carried_out(self) -> Any:
        return self._done

    @property
    def wake_ns(self) -> int | None:
        """When time next brings something about, own clock."""
        return self._machine.wake_ns

    def on_status(self, status: Status) -> None:
        alignment = self._session.alignment
        if alignment.ready:
            self._on_status(
                PeerStatus(status.responsible, alignment.to_own_ns(status.stamp_ns) - alignment.uncertainty_ns)
            )

    def _on_status(self, status: PeerStatus) -> None:
        self._hear(lambda: status)

    async def finish(self) -> None:
        """Before the link is closed: what was said to a machine is carried out, if the disk lets it in time."""
        try:
            async with asyncio.timeout(_WRITTEN_S):
                await self._written()
        except (TimeoutError, StateError) as error:
            self._session.say(str(error) or "the disk still writes what must survive a restart")

    async def _written(self) -> None:
        """Until nothing waits for the disk any more. Raises StateError."""
        while self._writing is not None:
            await asyncio.shield(self._writing)

    def _give_up(self, end: MissionEnd | None) -> None:
        if end is not None and self._machine.live is not None:
            try:
                self._step(AbortRequested(abort_reason(end.outcome)))
            except StateError as error:  # the mission ends anyhow, and the vehicle comes down
                self._session.say(str(error))

    async def _tick(self) -> None:
        """Time for the machine, for ever. A deadline that an event has just set is not slept through."""
        while True:
            wait_s = self.tick()
            self._moved.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._moved.wait()

    def tick(self) -> float:
        """Let the machine know when time has brought something about; how long to wait before it is asked again, s."""
        wake_ns, now_ns = self._machine.wake_ns, self._session.now_ns()
        if wake_ns is not None and now_ns >= wake_ns and self._writing is None:
            self._step(Tick())
            wake_ns = self._machine.wake_ns
        ahead_s = _TICK_S if wake_ns is None else (wake_ns - now_ns) * 1e-9
        return min(max(ahead_s, 0.005), _TICK_S)

    def _step(self, event: Any) -> None:
        self._step_with(lambda: event)

    def _hear(self, event: Callable[[], Any]) -> None:
        """A message, made an event when its turn comes: until then the clocks may be known better."""
        if len(self._waiting) < _MAX_WAITING:
            self._step_with(event)

    def _step_with(self, event: Callable[[], Any]) -> None:
        """Now, or when what is being written down is on the disk.

        Raises StateError when the machine wants something written down that cannot be: nothing after it is done, and
        when nothing before it was, the machine is where it was. When that turns out later it ends the mission.
        """
        self._waiting.append(event)
        self._go_through_waiting()

    def _go_through_waiting(self) -> None:
        while self._waiting and self._writing is None:
            made, before, wake_ns = self._waiting.popleft()(), self._machine.state, self._machine.wake_ns
            actions = self._machine.step(made, self._session.now_ns())
            if self._machine.wake_ns != wake_ns:
                self._moved.set()
            self._carry_out(actions, 0, before)

    def _carry_out(self, actions: Actions, begin: int, before: Any) -> None:
        """Actions of a machine that was in the state ``before``, from one of them on."""
        for number in range(begin, len(actions)):
            action = actions[number]
            if action == _TAKE and self._too_late():
                break  # it took too long to write down; the machine is about to let go
            if isinstance(action, Persist):
                saved = self._store.begin_save(action.record)
                if not saved.done():
                    self._writing = self._when_written(saved, partial(self._go_on, saved, actions, number, before))
                    return
                self._check(saved, number, before)
            self._carrier.carry_out(action)
        self._done = self._machine.state

    def _when_written(self, saved: Future[None], go_on: Callable[[], None]) -> asyncio.Task[None]:
        async def wait() -> None:
            written = asyncio.wrap_future(saved)
            written.add_done_callback(_retrieve)
            await asyncio.wait([written])
            go_on()

        return self._session.spawn(wait())

    def _go_on(self, saved: Future[None], actions: Actions, number: int, before: Any) -> None:
        """The rest of the actions once a record is on the disk, and then what was said to the machine meanwhile."""
        self._writing = None
        self._check(saved, number, before)
        self._carrier.carry_out(actions[number])
        self._carry_out(actions, number + 1, before)
        self._go_through_waiting()

    def _check(self, saved: Future[None], number: int, before: Any) -> None:
        """Raises StateError."""
        error = saved.exception()
        if error is not None:
            if number == 0:
                self._machine.state = before
            raise error

    def _too_late(self) -> bool:
        """What was just taken within a lease is over already."""
        state = self._machine.state
        return isinstance(state, Provisional) and self._session.now_ns() >= state.lease_end_ns


class SenderHandover(_Handover[SenderMachine]):
    """D1's side."""

    def __init__(self, session: Session, store: RecordStore) -> None:
        config, kept = protocol_config(session), store.load()
        machine = SenderMachine(config)
        if kept is not None:
            assert isinstance(kept.record, SenderRecord)
            machine.state = sender.restored(config, kept.record, session.now_ns(), same_clock=kept.same_clock)
        super().__init__(session, store, machine, kept, sender.record(machine.state))
        self._anew_ns = session.now_ns()
        self._free_ns: int | None = None  # the newest word of the other drone that it holds nothing; None: it does
        if kept is not None:  # on the ground a new mission begins: nobody tracks its target yet
            session.set_responsible(machine.responsible and session.vehicle.state.armed)

    def undecided(self, flying: bool) -> bool:
        state = self._machine.state
        return isinstance(state, AwaitingAccept) or (flying and isinstance(state, HandedOver) and not state.settled)

    @property
    def epoch(self) -> int:
        """Of the attempt under way; 0 before the first."""
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
        self._free_ns = None if status.responsible else status.stamp_ns

    @property
    def peer_is_free(self) -> bool:
        """The other drone said that it holds nothing, and said so since this one has nothing left to give to it."""
        return self._free_ns is not None and self._free_ns > self._anew_ns

    async def until_free(self) -> None:
        """Until the other drone is heard not to hold a target. Raises MissionEnd(PEER_ABORTED) when it goes on to."""
        session = self._session
        await session.until(
            lambda: self.peer_is_free,
            session.config.deadlines.peer_s,
            Outcome.PEER_ABORTED,
            "the receiver did not let go of an earlier handoff's target",
        )

    async def offer(self) -> None:
        """The target is tracked: this drone is responsible for it from now on, and offers it. Raises StateError."""
        self.begin_offer()
        await self._written()  # nothing is said in an epoch that a restart would begin once more

    def begin_offer(self) -> None:
        """``offer``, without waiting for the disk."""
        config = self._session.config
        self._step(Offer(config.handoff_id, config.target_id))
        self._start_ticking()

    def agreed(self, target_id: int) -> None:
        """The whole window agreed: release, then commit. Refused while the clocks are not known; may be said again."""
        if self.released:
            return
        session, alignment = self._session, self._session.alignment
        lease_end_ns = session.now_ns() + round(self._machine.config.lease_s * 1e9)
        uncertainty = alignment.uncertainty_at(lease_end_ns) if alignment.ready else None
        self._step(AgreementComplete(self.epoch, target_id, session.entropy.getrandbits(32), uncertainty))

    def on_message(self, received: Received) -> None:
        self._hear(lambda: Heard(received.message))

    def verify_again(self) -> None:
        """After taking back: once more, in the new epoch."""
        self._carrier.ended = None
        self._step(VerifyAgain())

    async def until_decided(self, timeout_s: float, verify_again: Callable[[], None]) -> None:
        """Until the receiver has accepted the target.

        An attempt that was committed and not accepted is taken back and verified again, as long as there is time.
        Raises MissionEnd otherwise.
        """
        carrier = self._carrier
        end_s = asyncio.get_running_loop().time() + timeout_s
        while True:
            if not await _until(lambda: carrier.ended is not None or self.released, end_s):
                raise MissionEnd(Outcome.NO_AGREEMENT, f"no agreement within {timeout_s:.0f} s")
            # a commit under way is decided by its lease, not by the deadline
            await _until(lambda: carrier.ended is not None, math.inf)
            assert carrier.ended is not None
            decision = carrier.ended.outcome
            if decision is Decision.HANDED_OVER:
                return
            if decision is not Decision.TAKEN_BACK:
                raise MissionEnd(_ENDS.get(decision, Outcome.PEER_ABORTED), decision.value)
            self.verify_again()
            verify_again()

    async def until_settled(self) -> None:
        """After ``until_decided``: until it is known that the receiver holds the target, or that nobody can say."""
        carrier = self._carrier
        await _until(lambda: carrier.settled is not None, math.inf)
        if carrier.settled is None or carrier.settled.outcome is not Decision.HANDED_OVER:
            raise MissionEnd(Outcome.ORPHANED, "the receiver did not say that it holds the target")

    def end(self, end: MissionEnd | None) -> None:
        """The mission ends on this side: nothing is transferred any more, unless it already was."""
        if not self.handed_over:
            self._give_up(end)


class ReceiverHandover(_Handover[ReceiverMachine]):
    """D2's side. ``able``: whether this drone sees the target and could follow it now."""

    def __init__(self, session: Session, store: RecordStore, able: Callable[[], bool]) -> None:
        config, kept = protocol_config(session), store.load()
        machine = ReceiverMachine(config)
        if kept is not None:
            assert isinstance(kept.record, ReceiverRecord)
            machine.state = receiver.restored(config, kept.record, session.now_ns(), same_clock=kept.same_clock)
        super().__init__(session, store, machine, kept, receiver.record(machine.state))
        self._able = able
        if kept is not None:
            session.set_responsible(machine.responsible, isinstance(machine.state, Provisional))

    def undecided(self, flying: bool) -> bool:
        state = self._machine.state
        return isinstance(state, Provisional) or (flying and isinstance(state, LetGo) and not state.settled)

    @property
    def live(self) -> Handoff | None:
        """The attempt this drone takes part in, once that is written down."""
        return self._done.live

    @property
    def holds(self) -> bool:
        """Responsible, provisionally or for good."""
        return self._machine.responsible

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
        return CommitHeard(message, lease_end_ns, uncertainty, self._able())

    async def until_held(self, timeout_s: float) -> None:
        """Until this drone holds the target for good. Raises MissionEnd otherwise.

        An attempt that the sender took back may be followed by another one, as long as there is time.
        """
        carrier, end_s = self._carrier, asyncio.get_running_loop().time() + timeout_s
        while await _until(lambda: carrier.ended is not None, end_s) or self.holds:
            # within a lease, the lease decides and not the deadline
            await _until(lambda: carrier.ended is not None, math.inf)
            assert carrier.ended is not None
            decision, carrier.ended = carrier.ended.outcome, None
            if decision is Decision.HANDED_OVER:
                return
            if decision is Decision.LET_GO:
                await _until(lambda: carrier.settled is not None, math.inf)
                assert carrier.settled is not None
                settled, carrier.settled = carrier.settled.outcome, None
                if settled is not Decision.TAKEN_BACK:
                    raise MissionEnd(Outcome.ORPHANED, f"the lease ended without the sender's word: {settled.value}")
            elif decision is not Decision.SUPERSEDED:
                raise MissionEnd(_ENDS.get(decision, Outcome.PEER_ABORTED), decision.value)
        raise MissionEnd(Outcome.NO_AGREEMENT, f"no hand-over within {timeout_s:.0f} s")

    def end(self, end: MissionEnd | None) -> None:
        """The mission ends on this side: a target held for good stays held; anything else is given up."""
        if not self.holds_for_good:
            self._give_up(end)


_ENDS = {Decision.TIMEOUT: Outcome.NO_AGREEMENT}


def _retrieve(written: asyncio.Future[Any]) -> None:
    """The carrier looks at the outcome itself, unless the mission has ended by then: asyncio need not tell of it."""
    if not written.cancelled():
        written.exception()
