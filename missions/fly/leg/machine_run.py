"""A machine of the protocol on its role's link: it decides, this carries out what it wants done.

What a machine wants written down is on the disk before anything that follows is done or sent, so
that the program may die between any two lines of this file and be started again. Only the machine
waits for the disk: what it is told meanwhile comes to it after, as if the link had been that much
slower, and the drone is flown on.
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

from drivers.interfaces import Kept, RecordStore, StateError
from flight.outcome import MissionEnd, Outcome, abort_reason
from missions.fly.leg.session import RoleSession
from path.messages import AbortReason, Accept, Commit, Status
from path.protocol.receiver import Provisional, ReceiverMachine
from path.protocol.sender import SenderMachine
from path.protocol.values import (
    AbortRequested,
    Action,
    Actions,
    Ended,
    NewMission,
    PeerStatus,
    Persist,
    ReceiverRecord,
    Refusal,
    Refused,
    Release,
    Send,
    SenderRecord,
    Settled,
    TakeResponsibility,
    Tick,
)

Machine = TypeVar("Machine", SenderMachine, ReceiverMachine)

_TICK_S = 0.1  # at the longest
_MAX_WAITING = 64  # messages while the disk is written to; what counts is said again
_SLOW_S = 0.5  # a record that takes longer may cost the hand-over: a lease is not much more
_WRITTEN_S = 2.0  # wait for the disk before the program ends


class Carrier:
    """Carries out actions of a machine, and remembers what was decided."""

    def __init__(self, session: RoleSession) -> None:
        self.session = session
        self.ended: Ended | None = None
        self.settled: Settled | None = None
        self.refused: Refusal | None = (
            None  # the newest refusal; what was done since does not end it
        )

    def carry_out(self, action: Action) -> None:
        """A record to be written down has been."""
        session = self.session
        match action:
            case Send(message):
                # what it causes is stamped later, also by a peer that is quicker than this
                begun_ns = session.now_ns()
                session.link.send(message)
                if isinstance(message, Commit):
                    record = {
                        "target_id": message.target_id,
                        "epoch": message.epoch,
                        "nonce": message.nonce,
                    }
                    session.log.write(
                        "/commit", begun_ns, {**record, "lease_end_ns": message.lease_end_ns}
                    )
            case Persist(record):
                self._log("/epoch", epoch=record.epoch, duty=record.duty)
            case TakeResponsibility():
                session.set_claim(action)
            case Release():
                session.set_claim(None)
            case Ended():
                self.ended = action
                self._log("/decision", outcome=action.outcome.value, reason=_value(action.reason))
            case Settled():
                self.settled = action
                self._log("/settled", outcome=action.outcome.value)
            case Refused(why):
                self.refused = why
                self._log("/refused", why=why.value)

    def _log(self, topic: str, **record: object) -> None:
        self.session.log.write(topic, self.session.now_ns(), record)


def _value(reason: AbortReason | None) -> str | None:
    return None if reason is None else reason.value


async def until(condition: Callable[[], bool], end_s: float) -> bool:
    """Poll a condition until a time of the loop; whether it came true."""
    loop = asyncio.get_running_loop()
    while not condition():
        if loop.time() > end_s:
            return False
        await asyncio.sleep(_TICK_S)
    return True


class MachineRun(Generic[Machine]):
    """A machine on its role's link: messages, statuses and time in, actions carried out.

    Its state is written down before anything else: a restored one's instants are of this clock from
    now on, and a disk that cannot be written to is found before anything flies. Raises StateError.
    """

    def __init__(
        self,
        session: RoleSession,
        store: RecordStore,
        machine: Machine,
        kept: Kept | None,
        made: SenderRecord | ReceiverRecord,
    ) -> None:
        self._session = session
        self._store = store
        self._machine = machine
        self._carrier = Carrier(session)
        self._kept = kept
        self._ticking = False
        self._writing: asyncio.Task[None] | None = None
        self._begun_ns = 0  # to write
        self._waiting: deque[Callable[[], Any]] = deque()  # events, made when their turn comes
        self._moved = asyncio.Event()  # the machine's next deadline
        self._done = machine.state  # the newest state all of whose actions were carried out
        store.save(made)
        # the log of a program that was started again begins with what it made of its record
        if kept is not None:
            self._carrier.carry_out(Persist(made))

    async def resume(self) -> None:
        """Decide what a restart left undecided, and answer the other drone, before anything else
        is begun.

        On the ground a new mission begins then: what an earlier one gave away or held is over. In
        the air it raises MissionEnd(RESTARTED): a course is not taken up in its middle.
        """
        if self._kept is None:
            return
        self._start_ticking()
        flying = self._session.vehicle.state.armed
        await until(lambda: not self.undecided(flying), math.inf)
        await self._written()
        if flying:
            raise MissionEnd(
                Outcome.RESTARTED, f"started again in the air, {self._kept.record.duty}"
            )
        self.begin_anew()
        await self._written()

    def begin_anew(self) -> None:
        """Begin anew on the ground, with nothing undecided: what an earlier mission gave away or
        held is over.
        """
        self._carrier.ended = self._carrier.settled = None
        self._step(NewMission())

    def undecided(self, flying: bool) -> bool:
        """Something is still to come of an earlier handoff; in the air, also whether it is
        orphaned.
        """
        raise NotImplementedError

    def _start_ticking(self) -> None:
        if not self._ticking:
            self._ticking = True
            self._session.spawn(self._tick())

    @property
    def state(self) -> Any:
        """The machine's, for whoever watches it; ``carried_out`` is the newest one whose actions
        all were.
        """
        return self._machine.state

    @property
    def carried_out(self) -> Any:
        return self._done

    @property
    def wake_ns(self) -> int | None:
        """The instant at which time next brings something about, own clock; None when it does
        not.
        """
        return self._machine.wake_ns

    def on_status(self, status: Status) -> None:
        """Take a Status. It counts only by its stamp, and that only while the clocks are
        aligned.
        """
        alignment = self._session.alignment
        if alignment.ready:
            stamp_ns = alignment.to_own_ns(status.stamp_ns)
            earliest_ns = stamp_ns - alignment.uncertainty_at(stamp_ns)
            self._on_status(PeerStatus(status.responsible, earliest_ns, status.instance))

    def _on_status(self, status: PeerStatus) -> None:
        self._hear(lambda: status)

    async def finish(self) -> None:
        """Carries out what was said to a machine before the link is closed, if the disk lets it in
        time.
        """
        try:
            async with asyncio.timeout(_WRITTEN_S):
                await self._written()
        except (TimeoutError, StateError) as error:
            self._session.say(str(error) or "the disk still writes what must survive a restart")

    async def _written(self) -> None:
        """Wait until nothing waits for the disk any more. Raises StateError."""
        while self._writing is not None:
            await asyncio.shield(self._writing)

    def _give_up(self, end: MissionEnd | None) -> None:
        if end is not None and self._machine.live is not None:
            try:
                self._step(AbortRequested(abort_reason(end.outcome)))
            except StateError as error:  # the mission ends anyhow, and the vehicle comes down
                self._session.say(str(error))

    async def _tick(self) -> None:
        """Time for the machine, for ever. A deadline that an event has just set is not slept
        through.
        """
        while True:
            wait_s = self.tick()
            self._moved.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._moved.wait()

    def tick(self) -> float:
        """Let the machine know when time has brought something about; how long to wait before it is
        asked again, s.
        """
        wake_ns = self._machine.wake_ns
        now_ns = self._session.now_ns()
        if wake_ns is not None and now_ns >= wake_ns and self._writing is None:
            self._step(Tick())
            wake_ns = self._machine.wake_ns
        ahead_s = _TICK_S if wake_ns is None else (wake_ns - now_ns) * 1e-9
        return min(max(ahead_s, 0.005), _TICK_S)

    def _step(self, event: Any) -> None:
        self._step_with(lambda: event)

    def _hear(self, event: Callable[[], Any]) -> None:
        """A message, made an event when its turn comes: until then the clocks may be known
        better.
        """
        if len(self._waiting) < _MAX_WAITING:
            self._step_with(event)

    def _step_with(self, event: Callable[[], Any]) -> None:
        """Now, or when what is being written down is on the disk.

        Raises StateError when the machine wants something written down that cannot be: nothing
        after it is done, and when nothing before it was, the machine is where it was. When that
        turns out later it ends the mission.
        """
        self._waiting.append(event)
        self._go_through_waiting()

    def _go_through_waiting(self) -> None:
        while self._waiting and self._writing is None:
            made = self._waiting.popleft()()
            before = self._machine.state
            wake_ns = self._machine.wake_ns
            actions = self._machine.step(made, self._session.now_ns())
            if self._machine.wake_ns != wake_ns:
                self._moved.set()
            self._carry_out(actions, 0, before)

    def _carry_out(self, actions: Actions, begin: int, before: Any) -> None:
        """Actions of a machine that was in the state ``before``, from one of them on."""
        for number in range(begin, len(actions)):
            action = actions[number]
            if self._over(action):
                break  # it took too long to come to it; the machine is about to let go
            if isinstance(action, Persist):
                saved = self._store.begin_save(action.record)
                if not saved.done():
                    self._begun_ns = self._session.now_ns()
                    self._writing = self._when_written(
                        saved, partial(self._go_on, saved, actions, number, before)
                    )
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
        """The rest of the actions once a record is on the disk, and then what was said to the
        machine meanwhile.
        """
        self._writing = None
        self._check(saved, number, before)
        took_s = (self._session.now_ns() - self._begun_ns) * 1e-9
        if took_s > _SLOW_S:
            self._session.say(
                f"the disk took {took_s:.1f} s to write a record: use a quicker one, or a longer lease"
            )
        self._carrier.carry_out(actions[number])
        self._carry_out(actions, number + 1, before)
        self._go_through_waiting()

    def _check(self, saved: Future[None], number: int, before: Any) -> None:
        """Raise StateError."""
        error = saved.exception()
        if error is not None:
            if number == 0:
                self._machine.state = before
            raise error

    def _over(self, action: Action) -> bool:
        """Taken within a lease, or said of one, that is over already."""
        state = self._machine.state
        now_ns = self._session.now_ns()
        match action:
            case TakeResponsibility():
                return not action.at(now_ns)
            case Send(Accept()):
                return isinstance(state, Provisional) and now_ns >= state.lease_end_ns
            case _:
                return False


def _retrieve(written: asyncio.Future[Any]) -> None:
    """The carrier looks at the outcome itself, unless the mission has ended by then: asyncio need
    not tell of it.
    """
    if not written.cancelled():
        written.exception()
