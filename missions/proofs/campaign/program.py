"""One life of a role's program around its protocol machine.

Link, clocks, disk and hand-over are the roles' own; what the mission does to them is scripted.

A life begins with a start of the program and ends with the end of the run, or when it is killed
between two effects.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from drivers.interfaces import Received
from drivers.link.wire import KEY_LENGTH, Codec, Drop
from drivers.log.state_file import MemoryStore
from flight.clocks import ClockAlignment, answer
from flight.config import Deadlines, MissionConfig
from flight.outcome import MissionEnd, Outcome
from path.messages import Message, Ping, Pong, Role, Status
from path.protocol.values import HandoffOutcome as Decision
from path.protocol.values import ReceiverRecord, SenderRecord, TakeResponsibility

if TYPE_CHECKING:
    from missions.proofs.campaign.machines import Machines, TrueClock

MISSION = MissionConfig(deadlines=Deadlines(receiver_ready_s=1.5, verify_s=2.5))
OTHER_ID = MISSION.target_id + 1
ORIGIN = (0.0, 0.0, 0.0)


class Killed(BaseException):
    """The program's process is gone, in the middle of whatever it did."""


@dataclass(slots=True)
class Sent:
    """A packet that a program sent, and whether it was taken for what it is: never again may it be
    (S6).
    """

    data: bytes
    taken: bool = False


class Program:
    """The program of either role; stands in for the ``Session`` of its hand-over."""

    role: Role

    def __init__(self, world: Machines, clock: TrueClock, store: MemoryStore, life: int) -> None:
        self.world = world
        self.clock = clock
        self._store = store
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
        self._pings = 0
        self._pinged_s = 0.0
        self._wake_ns: int | None = None
        self._ticks = 0
        self._codec = Codec(self.role, bytes(KEY_LENGTH), stamp=lambda: round(world.now_s * 1e5))
        self._settling = store.kept is not None

    handover: Any  # SenderHandover or ReceiverHandover

    @property
    def booted(self) -> bool:
        """Its hand-over is there."""
        return hasattr(self, "handover")

    # --- what the hand-over asks of its session, its link, its log and its disk

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
            self.world.tell(
                self.role, "is not responsible" if claim is None else "is responsible", provisional
            )
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
        """Begin to save: on the disk after a while; when the program is killed meanwhile,
        perhaps.
        """
        self.writing = record
        return Future()

    def when_written(self, saved: Future[None], go_on: Callable[[], None]) -> None:
        def written() -> None:
            record = self.writing
            self.writing = None
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
        """Something the world can see; a kill that was ordered happens before or after it, a stall
        before.
        """
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

    # --- what happens to it

    def begin(self) -> None:
        self.run(self._boot)
        self._every(self._report)
        self._tick_on(0)
        self._every(self._frame)

    def run(self, do: Callable[[], object]) -> object:
        """Do something now; nothing once it is dead."""
        world = self.world
        result = None
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
        """A packet; ``sent``: what the other drone's program sent it as, None when that never sent
        it.
        """
        message = self._codec.decode(data)
        if isinstance(message, Drop):
            return
        kind = (
            "forged"
            if sent is None
            else "damaged"
            if data != sent.data
            else "repeated"
            if sent.taken
            else "genuine"
        )
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
            before = self.handover.state
            writing = self.writing is not None
            self._on_message(Received(message, arrival_ns))
            self.world.judge.heard(self, None if writing else before, message)

    def end_mission(self, outcome: Outcome, why: str = "") -> None:
        """The course is over: what is not transferred yet never will be."""
        if self.end is None:
            self.end = MissionEnd(outcome, why)
            self.world.tell(self.role, "ends its mission:", outcome.label)
            self.handover.end(self.end)

    # --- inside

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
        rate_hz = (
            self.config.status_hz if self.role is Role.SENDER else self.config.receiver_status_hz
        )
        status = Status(
            self.role, self.now_ns(), ORIGIN, ORIGIN, 0.0, 0, self.responsible, self.observing, 1.0,
            self.instance(),
        )  # fmt: skip
        self.send(status)
        if self.alignment.fault:
            self.end_mission(Outcome.CLOCK_FAULT)
        if (
            not self.alignment.ready
            or self.world.now_s - self._pinged_s >= 1.0 / self.config.ping_hz
        ):
            self._pings = self._pings + 1
            self._pinged_s = self.world.now_s
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
        """Return whether the course may go on after a start with a record. In the air it ends once
        all is decided.
        """
        if self._settling and not self.handover.undecided(self.world.flying):
            self._settling = False
            if self.world.flying:
                self.end_mission(Outcome.RESTARTED)
            else:
                self.world.judge.anew(self)
                self.handover.begin_anew()
                self.decision = self.settled = None
        return not self._settling and self.end is None
