"""One life of a role's program around its protocol machine.

Link, clocks, disk and hand-over are the roles' own; what the mission does to them is scripted.

A life begins with a start of the program and ends with the end of the run, or when it is killed between two effects.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from drivers.interfaces import Received
from drivers.link.wire import KEY_LENGTH, Codec, Drop
from drivers.log.state_file import MemoryStore
from flight.clocks import ClockAlignment, answer
from flight.config import Deadlines, MissionConfig
from flight.outcome import MissionEnd, Outcome
from missions.leg.handover import ReceiverHandover, SenderHandover
from path.messages import Candidate, Message, Ping, Pong, Role, Status, Target
from path.observations import MissReason
from path.protocol.values import HandoffOutcome as Decision
from path.protocol.values import ReceiverRecord, SenderRecord, TakeResponsibility

if TYPE_CHECKING:
    from missions.assurance.campaign.machines import Machines, TrueClock

MISSION = MissionConfig(deadlines=Deadlines(receiver_ready_s=1.5, verify_s=2.5))
OTHER_ID = MISSION.target_id + 1
FRAME_S = 0.25
ATTEMPTS = 3
FREE_S = 5.0  # a sender that begins anew waits as long for the receiver to hold nothing
ORIGIN, DOWN, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)


class Killed(BaseException):
    """The program's process is gone, in the middle of whatever it did."""


@dataclass(slots=True)
class Sent:
    """A packet that a program sent, and whether it was taken for what it is: never again may it be (S6)."""

    data: bytes
    taken: bool = False


class Program:
    """The program of either role; stands in for the ``Session`` of its hand-over."""

    role: Role

    def __init__(self, world: Machines, clock: TrueClock, store: MemoryStore, life: int) -> None:
        self.world, self.clock, self._store = world, clock, store
        self.config = MISSION
        self.alignment = ClockAlignment()
        self.entropy = random.Random(f"{world.plan.seed} {self.role.value} {life}")
        self.link = self.log = self
        self.claim: TakeResponsibility | None = None
        self.instance: Callable[[], int] = int
        self.observing = False
        self.peer: Status | None = None
        self.alive = True
        self.end: MissionEnd | None = None
        self.decision: Decision | None = None
        self.settled: Decision | None = None
        self.fuse: tuple[int, bool] | None = None
        self.stall: tuple[int, float] | None = None  # effects until it, and for how long
        self._standing = False
        self._later: list[Callable[[], object]] = []  # what its turn comes for when it goes on
        self.writing: SenderRecord | ReceiverRecord | None = None
        self.vehicle = SimpleNamespace(state=SimpleNamespace(armed=world.flying))
        self._heard_s = self.began_s = world.now_s
        self._pings, self._pinged_s = 0, 0.0
        self._wake_ns: int | None = None
        self._ticks = 0
        self._codec = Codec(self.role, bytes(KEY_LENGTH), stamp=lambda: round(world.now_s * 1e5))
        self._settling = store.kept is not None

    handover: Any  # SenderHandover or ReceiverHandover

    @property
    def booted(self) -> bool:
        """Its hand-over is there."""
        return hasattr(self, "handover")

    # --- what the hand-over asks of its session, its link, its log and its disk ---------------------------------

    def now_ns(self) -> int:
        return self.clock.read_ns(self.world.now_s)

    def send(self, message: Message) -> None:
        def out() -> None:
            self.world.judge.sent(self, message)
            self.world.transmit(self.role, message, self._codec.encode(message))

        self._effect(out)

    @property
    def responsible(self) -> bool:
        return self.claim is not None and self.claim.at(self.now_ns())

    def set_claim(self, claim: TakeResponsibility | None) -> None:
        def change() -> None:
            self.claim = claim
            provisional = claim is not None and claim.provisional and "provisionally"
            self.world.tell(self.role, "is not responsible" if claim is None else "is responsible", provisional)
            self.world.judge.claimed(self)

        self._effect(change)

    def load(self) -> Any:
        return self._store.load()

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        def write() -> None:
            self._store.save(record)
            self.world.tell(self.role, f"writes down: {record.duty}, epoch", record.epoch)
            self.world.judge.kept(self, record)

        self._effect(write)

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        """Begins to save: on the disk after a while; when the program is killed meanwhile, perhaps."""
        self.writing = record
        return Future()

    def when_written(self, saved: Future[None], go_on: Callable[[], None]) -> None:
        def written() -> None:
            record, self.writing = self.writing, None
            assert record is not None
            self.save(record)
            saved.set_result(None)
            go_on()

        after_s = self.world.random.uniform(0.0, self.world.plan.disk_s)
        self.world.at(self.world.now_s + after_s, lambda: self.run(written))

    def say(self, note: str) -> None:
        self.world.tell(self.role, note)

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        del stamp_ns
        if topic == "/decision":
            self.decision = Decision(record["outcome"])
            self.world.judge.decided(self, self.decision, record["reason"])
        elif topic == "/settled":
            self.settled = Decision(record["outcome"])
        if topic in ("/decision", "/settled", "/refused"):
            self.world.tell(self.role, topic[1:], dict(record))

    def spawn(self, task: Any) -> None:
        task.close()  # time is brought by ``_tick``

    def _effect(self, do: Callable[[], None]) -> None:
        """Something the world can see; a kill that was ordered happens before or after it, a stall before."""
        self._stand_still()
        if self.fuse is None:
            do()
            return
        left, halfway = self.fuse
        self.fuse = left - 1, halfway
        if left <= 1 and not halfway:
            raise Killed
        do()
        if left <= 1:
            raise Killed

    def _stand_still(self) -> None:
        if self.stall is None:
            return
        left, for_s = self.stall
        self.stall = (left - 1, for_s) if left > 1 else None
        if left <= 1:
            self.world.tell(self.role, f"stands still for {for_s:.2f} s")
            self._standing = True
            self.world.pass_time(self.world.now_s + for_s)
            self._standing = False
            for do in self._later:
                self.world.at(self.world.now_s, do)
            self._later.clear()

    # --- what happens to it ------------------------------------------------------------------------------------

    def begin(self) -> None:
        self.run(self._boot)
        self._every(self._report)
        self._tick_on(0)
        self._every(self._frame)

    def run(self, do: Callable[[], object]) -> object:
        """Do something now; nothing once it is dead."""
        world, result = self.world, None
        if not self.alive:
            return None
        if self._standing:
            self._later.append(lambda: self.run(do))
            return None
        try:
            result = do()
            if self.writing is None:  # the course waits for the disk
                self._course()
        except Killed:
            world.killed(self)
        world.judge.after(self)
        if self.alive and self.handover.wake_ns != self._wake_ns:
            self._wake_ns = self.handover.wake_ns
            self._ticks += 1
            world.at(world.now_s, lambda ticks=self._ticks: self._tick_on(ticks))
        return result

    def arrived(self, data: bytes, sent: Sent | None) -> None:
        """A packet; ``sent``: what the other drone's program sent it as, None when that never sent it."""
        message = self._codec.decode(data)
        if isinstance(message, Drop):
            return
        kind = "forged" if sent is None else "damaged" if data != sent.data else "repeated" if sent.taken else "genuine"
        self.world.judge.taken(self, kind, message)
        if sent is not None:
            sent.taken = True
        self._heard_s, arrival_ns = self.world.now_s, self.now_ns()
        if isinstance(message, Ping):
            self.send(answer(message, arrival_ns, self.now_ns()))
        elif isinstance(message, Pong):
            self.alignment.on_pong(message, arrival_ns)
        elif isinstance(message, Status):
            self.peer = message
            self.handover.on_status(message)
        else:
            self.world.hear(self.role, message)
            before, writing = self.handover.state, self.writing is not None
            self._on_message(Received(message, arrival_ns))
            self.world.judge.heard(self, None if writing else before, message)

    def end_mission(self, outcome: Outcome, why: str = "") -> None:
        """The course is over: what is not transferred yet never will be."""
        if self.end is None:
            self.end = MissionEnd(outcome, why)
            self.world.tell(self.role, "ends its mission:", outcome.label)
            self.handover.end(self.end)

    # --- inside ------------------------------------------------------------------------------------------------

    def _every(self, do: Callable[[], float]) -> None:
        """Do something again and again, as long after each time as it says."""

        def once() -> None:
            if self._standing:
                self._later.append(once)
                return
            after_s = self.run(do)
            if self.alive:
                late_s = self.world.random.uniform(0.0, self.world.plan.late_s)
                wait_s = after_s if isinstance(after_s, float) else 0.0
                self.world.at(self.world.now_s + wait_s + late_s, once)

        once()

    def _tick_on(self, ticks: int) -> None:
        """Time for the machine, until another deadline is set."""
        if not self.alive or ticks != self._ticks:
            return
        if self._standing:
            self._later.append(lambda: self._tick_on(ticks))
            return
        after_s = self.run(self.handover.tick)
        wait_s = after_s if isinstance(after_s, float) else 0.0
        late_s = self.world.random.uniform(0.0, self.world.plan.late_s)
        self.world.at(self.world.now_s + wait_s + late_s, lambda: self._tick_on(ticks))

    def _report(self) -> float:
        rate_hz = self.config.status_hz if self.role is Role.SENDER else self.config.receiver_status_hz
        status = Status(
            self.role, self.now_ns(), ORIGIN, ORIGIN, 0.0, 0, self.responsible, self.observing, 1.0,
            self.instance(),
        )  # fmt: skip
        self.send(status)
        if self.alignment.fault:
            self.end_mission(Outcome.CLOCK_FAULT)
        if not self.alignment.ready or self.world.now_s - self._pinged_s >= 1.0 / self.config.ping_hz:
            self._pings, self._pinged_s = self._pings + 1, self.world.now_s
            self.send(Ping(self._pings, self.now_ns()))
        return 1.0 / rate_hz

    def _silent(self) -> bool:
        """The other drone was not heard for too long while both verify."""
        return self.world.now_s - self._heard_s > self.config.guard.near_silence_s

    def _boot(self) -> None:
        raise NotImplementedError

    def _course(self) -> None:
        raise NotImplementedError

    def _frame(self) -> float:
        raise NotImplementedError

    def _on_message(self, received: Received) -> None:
        raise NotImplementedError

    def _settle(self) -> bool:
        """Returns whether the course may go on after a start with a record. In the air it ends once all is decided."""
        if self._settling and not self.handover.undecided(self.world.flying):
            self._settling = False
            if self.world.flying:
                self.end_mission(Outcome.RESTARTED)
            else:
                self.world.judge.anew(self)
                self.handover.begin_anew()
                self.decision = self.settled = None
        return not self._settling and self.end is None


class _Sender(SenderHandover):
    def _when_written(self, saved: Future[None], go_on: Callable[[], None]) -> Any:
        cast(Any, self._session).when_written(saved, go_on)
        return True


class _Receiver(ReceiverHandover):
    def _when_written(self, saved: Future[None], go_on: Callable[[], None]) -> Any:
        cast(Any, self._session).when_written(saved, go_on)
        return True


class SenderProgram(Program):
    """D1: offers, has its script agree, decides, verifies again after taking back."""

    role = Role.SENDER

    def _boot(self) -> None:
        self.handover: SenderHandover = _Sender(cast(Any, self), cast(Any, self))
        self._first_s: float | None = None
        self._attempts = 0
        self._lied = False
        self._again = self._settling

    def _course(self) -> None:
        if not self._settle():
            return
        if not self._attempts:
            free = not self._again or self.handover.peer_is_free
            if free and self.world.now_s - self.began_s >= self.world.plan.offer_s:
                self._attempt(self.handover.begin_offer)
                self.observing = True
            elif self.world.now_s - self.began_s > FREE_S:
                self.end_mission(Outcome.PEER_ABORTED)
        elif self.decision is Decision.TAKEN_BACK and self._attempts < ATTEMPTS:
            self.decision = None
            self._attempt(self.handover.verify_again)
        elif self.decision is Decision.HANDED_OVER:
            if self.settled is not None:
                held = self.settled is Decision.HANDED_OVER
                self.end_mission(Outcome.COMMITTED if held else Outcome.ORPHANED)
        elif self.decision is not None:
            self.end_mission(_END.get(self.decision, Outcome.PEER_ABORTED))
        elif self._first_s is not None and not self.handover.released and self._silent():
            self.end_mission(Outcome.PEER_LOST)

    def _attempt(self, begin: Callable[[], None]) -> None:
        self._attempts += 1
        self._first_s, self._lied = None, False
        self.world.judge.begun()
        begin()

    def _frame(self) -> float:
        """Says where the target is, and has the views agree when the script wants them to."""
        epoch, script = self.handover.epoch, self.world.plan
        if not epoch or self.end is not None:
            return FRAME_S
        config = self.config
        self.send(Target(config.handoff_id, epoch, config.target_id, 0, self.now_ns(), DOWN, DOWN, 0.01))
        if self._first_s is None or script.agree_s is None or self.handover.released:
            return FRAME_S
        seen_s = self.world.now_s - self._first_s
        if script.wrong and not self._lied and seen_s > 0.5 * script.agree_s:
            self._lied = True
            self.handover.agreed(OTHER_ID)
        if seen_s >= script.agree_s:
            self.world.judge.agreed(epoch)
            self.handover.agreed(config.target_id)
        return FRAME_S

    def _on_message(self, received: Received) -> None:
        message = received.message
        if isinstance(message, Candidate) and message.epoch == self.handover.epoch and self._first_s is None:
            self._first_s = self.world.now_s
        self.handover.on_message(received)


class ReceiverProgram(Program):
    """D2: answers every Target, and holds what it is given."""

    role = Role.RECEIVER

    def _boot(self) -> None:
        self.handover: ReceiverHandover = _Receiver(cast(Any, self), cast(Any, self), self._able)
        self.observing = True

    def _able(self) -> bool:
        blind = self.world.plan.blind
        return blind is None or not blind[0] <= self.world.now_s <= blind[1]

    def _course(self) -> None:
        if not self._settle() or (self.decision is None and self.handover.holds):
            return
        match self.decision:
            case None:
                if self.handover.live is not None and self._silent():
                    self.end_mission(Outcome.PEER_LOST)
            case Decision.HANDED_OVER:
                pass
            case Decision.LET_GO:
                if self.settled is Decision.TAKEN_BACK:
                    self.decision = self.settled = None
                elif self.settled is not None:
                    self.end_mission(Outcome.ORPHANED)
            case Decision.SUPERSEDED:
                self.decision = None
            case _:
                self.end_mission(_END.get(self.decision, Outcome.PEER_ABORTED))

    def _frame(self) -> float:
        return 10.0 * FRAME_S  # it answers

    def _on_message(self, received: Received) -> None:
        message, handover = received.message, self.handover
        handover.on_message(received)
        live = handover.live
        if isinstance(message, Target) and live is not None and self.end is None and not handover.holds:
            bound = (live.handoff_id, live.epoch, live.target_id)
            missed = (None, MissReason.NO_CANDIDATE)
            self.send(Candidate(*bound, 0, message.sequence, self.now_ns(), *missed, DOWN, UPRIGHT, 0.01))


_END = {Decision.TIMEOUT: Outcome.NO_AGREEMENT}
