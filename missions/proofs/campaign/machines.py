"""One run of both protocol machines: real messages over a faulty link, clocks that wander, programs
that die.

Time is a queue of what is due. Each drone's program is ``Program``; this is what lies between and
around them.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from drivers.interfaces import Kept
from drivers.link.wire import KEY_LENGTH, Codec
from drivers.log.state_file import MemoryStore
from flight.outcome import Outcome
from missions.proofs.campaign.judge import Judge
from missions.proofs.campaign.plan import CLOCKS_S, ROLES, Crash, Forgotten, RunPlan, Stall, Step
from missions.proofs.campaign.program import Program, Sent
from missions.proofs.campaign.role_programs import ReceiverProgram, SenderProgram
from path.messages import Accept, Commit, Message, Role
from path.protocol import receiver, sender
from path.protocol.values import ReceiverRecord, SenderRecord
from path.values import frozen

LONGEST_S = 45.0
QUIET_S = 0.5
LOOK_EVERY = 16  # events
NOISY = ("Target", "Candidate", "Status", "Ping", "Pong")
PEER = {Role.SENDER: Role.RECEIVER, Role.RECEIVER: Role.SENDER}


class CampaignChannel(Protocol):
    """One direction of a link with faults, by seed (``hil.link.faulty.FaultyChannel``)."""

    def arrivals(self, data: bytes, now_s: float) -> list[tuple[float, bytes]]: ...


OpenChannel = Callable[[str, Mapping[str, float]], CampaignChannel]
Tell = Callable[[float, str, str], None]


@frozen
class ProgramRun:
    """The result of a run.

    Attributes:
        outcome: "commit", "timeout", "aborted: REASON" and so on, see ``docs/campaign.md``.
        violations, beyond: each "NAME at T s: what"; ``beyond``: after an assumption was broken,
            and which.
        broken: the assumptions that were: "clock", "disk".
        figures: in s: "decided_s", the longest wait for a decision since an attempt began;
            "commit_s", since a COMMIT; "gap_s", the longest time with nobody responsible, orphans
            apart; "simulated_s". After a broken assumption, and where a program stands still, only
            the last.
    """

    outcome: str
    violations: tuple[str, ...]
    beyond: tuple[str, ...]
    broken: tuple[str, ...]
    figures: Mapping[str, float]


@dataclass(slots=True)
class TrueClock:
    """A drone's clock, by true time."""

    offset_s: float
    rate: float

    def read_ns(self, true_s: float) -> int:
        return round((self.offset_s + self.rate * true_s) * 1e9)


class _Disk(MemoryStore):
    """A disk that may lose what it had said that it has."""

    def __init__(self, kept: Kept | None = None, older: Kept | None = None) -> None:
        super().__init__(kept)
        self._older = older

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        self._older = self.kept
        super().save(record)

    def after(self, forgets: Forgotten, reboot: bool) -> _Disk:
        """Return the disk as the next program finds it."""
        kept = self.kept if forgets == "nothing" else self._older if forgets == "newest" else None
        if reboot:
            kept = _of_another_clock(kept)
        return _Disk(kept, _of_another_clock(self._older) if reboot else self._older)


def _of_another_clock(kept: Kept | None) -> Kept | None:
    return None if kept is None else Kept(kept.record, same_clock=False)


@dataclass(slots=True)
class _Computer:
    """The parts of a drone that outlive its program: its clock, its disk."""

    clock: TrueClock
    store: _Disk = field(default_factory=_Disk)
    program: Program | None = None
    lives: int = 0
    crash: Crash | None = None


class Machines:
    """The world of one run. ``tell``: given every event when somebody wants to read the story."""

    def __init__(self, plan: RunPlan, open_channel: OpenChannel, tell: Tell | None = None) -> None:
        self.plan = plan
        self._tell = tell
        self.now_s = 0.0
        self.random = random.Random(f"{plan.seed} world")
        self.judge = Judge(self)
        self.flying = True
        self._order = 0
        self._due: list[tuple[float, int, Callable[[], Any]]] = []
        self._last_s = _last_s(plan)
        self._channels = {
            role: open_channel(f"{plan.seed} {role.value}", plan.link) for role in ROLES
        }
        self._drones = {
            role: _Computer(TrueClock(plan.offset_s[role], 1.0 + plan.drift_ppm[role] * 1e-6))
            for role in ROLES
        }
        self._recorded: dict[Role, list[Sent]] = {role: [] for role in ROLES}

    def run(self) -> ProgramRun:
        plan = self.plan
        for role in ROLES:
            self.at(plan.start_s[role], lambda role=role: self._start(role))
        for crash in plan.crashes:
            self.at(crash.at_s, lambda crash=crash: self._arm(crash))
        for step in plan.steps:
            self.at(step.at_s, lambda step=step: self._set_clock(step))
        for stall in plan.stalls:
            self.at(stall.at_s, lambda stall=stall: self._stall(stall))
        for role, at_s in plan.pilots:
            self.at(at_s, lambda role=role: self._pilot(role))
        if plan.forged_hz > 0.5:
            self.at(self.random.expovariate(plan.forged_hz), self._forge)
        quiet_s = 0.0
        events = 0
        while self.now_s < LONGEST_S:
            self._next()
            events += 1
            if events % LOOK_EVERY:
                continue
            if not self._over():
                quiet_s = self.now_s
            elif self.now_s - quiet_s > QUIET_S:
                break
        return self._outcome()

    def _next(self) -> None:
        self.now_s, _, do = heapq.heappop(self._due)
        do()

    def pass_time(self, until_s: float) -> None:
        """Everything else that happens until then, while a program stands still between two of its
        effects.
        """
        while self._due and self._due[0][0] < until_s:
            self._next()
        self.now_s = max(self.now_s, until_s)  # the other one may have stood still for longer

    def at(self, time_s: float, do: Callable[[], Any]) -> None:
        self._order += 1
        heapq.heappush(self._due, (time_s, self._order, do))

    def program(self, role: Role) -> Program | None:
        return self._drones[role].program

    def state(self, role: Role) -> Any:
        """Return the machine's state; None while its program does not run."""
        program = self._drones[role].program
        return program.handover.carried_out if program is not None and program.booted else None

    def tell(self, role: Role, what: str, more: object = "") -> None:
        if self._tell is not None:
            self._tell(
                self.now_s, role.value, f"{what} {more}" if more not in ("", False) else what
            )

    def hear(self, role: Role, message: Message) -> None:
        if self._tell is not None and type(message).__name__ not in NOISY:
            self.tell(role, f"hears {_named(message)}")

    # --- the link

    def transmit(self, role: Role, message: Message, data: bytes) -> None:
        """Send a program's packet on; each that arrives knows whether it is the genuine one
        (S6).
        """
        now_s = self.now_s
        peer = PEER[role]
        if self._tell is not None and type(message).__name__ not in NOISY:
            self.tell(role, f"sends {_named(message)}")
        sent = Sent(data)
        if self.plan.forged_hz:
            self._recorded[role].append(sent)
        if any(
            out.begin_s <= now_s < out.end_s and out.of in (None, role) for out in self.plan.outages
        ):
            return
        for at_s, packet in self._channels[role].arrivals(data, now_s):
            self.at(at_s, lambda packet=packet: self._deliver(peer, packet, sent))

    def _deliver(self, role: Role, packet: bytes, sent: Sent | None) -> None:
        program = self._drones[role].program
        if program is not None:
            program.run(lambda: program.arrived(packet, sent))

    def _forge(self) -> None:
        """A stranger: packets with another key, altered ones, and any that was ever sent."""
        rng = self.random
        role = rng.choice(ROLES)
        recorded = self._recorded[PEER[role]]
        choice = rng.random()
        if choice < 0.4 and recorded:
            sent = rng.choice(recorded)  # if the link lost it, it is but late
            self._deliver(role, sent.data, sent)
        elif choice < 0.7 and recorded:
            altered = bytearray(rng.choice(recorded).data)
            altered[rng.randrange(len(altered))] ^= 1 << rng.randrange(8)
            self._deliver(role, bytes(altered), None)
        else:
            forger = Codec(PEER[role], rng.randbytes(KEY_LENGTH), stamp=lambda: rng.getrandbits(47))
            epoch = rng.randint(1, 3)
            nonce = rng.getrandbits(32)
            lease_ns = self._drones[PEER[role]].clock.read_ns(self.now_s) + 1_500_000_000
            told = rng.getrandbits(24)
            if role is Role.RECEIVER:
                word: Message = Commit(1, epoch, 1, nonce, lease_ns, 1, told)
            else:
                word = Accept(1, epoch, 1, nonce, 1, told)
            self._deliver(role, forger.encode(word), None)
        self.at(self.now_s + rng.expovariate(self.plan.forged_hz), self._forge)

    # --- what goes wrong

    def _start(self, role: Role) -> None:
        drone = self._drones[role]
        drone.lives += 1
        kind = SenderProgram if role is Role.SENDER else ReceiverProgram
        self.tell(role, "starts" if drone.lives == 1 else "starts again", f"life {drone.lives}")
        program = drone.program = kind(self, drone.clock, drone.store, drone.lives)
        program.begin()

    def _arm(self, crash: Crash) -> None:
        program = self._drones[crash.role].program
        if program is not None:
            self._drones[crash.role].crash = crash
            program.fuse = (crash.after, crash.halfway)

    def killed(self, program: Program) -> None:
        drone = self._drones[program.role]
        crash = drone.crash
        assert crash is not None
        program.alive = False
        program.claim = None
        drone.program = None
        if program.writing is not None and self.random.random() < 0.5:
            drone.store.save(program.writing)
        self.tell(program.role, "is killed")
        self.judge.died(program)
        self.at(self.now_s + crash.down_s, lambda: self._restart(crash))

    def _restart(self, crash: Crash) -> None:
        drone = self._drones[crash.role]
        self.flying = crash.flying
        if crash.reboot:
            drone.clock.offset_s = self.random.uniform(*CLOCKS_S)
        if crash.forgets != "nothing" and drone.store.kept is not None:
            self.tell(
                crash.role,
                f"its disk has lost {'its newest record' if crash.forgets == 'newest' else 'it all'}",
            )
            self.judge.forgot()
        drone.store = drone.store.after(crash.forgets, crash.reboot)
        self._start(crash.role)

    def _stall(self, stall: Stall) -> None:
        program = self._drones[stall.role].program
        if program is not None:
            program.stall = (stall.after, stall.for_s)
            self.judge.stalled(stall.for_s)

    def _set_clock(self, step: Step) -> None:
        self.tell(step.role, f"its clock is set by {step.by_s:+.2f} s")
        self._drones[step.role].clock.offset_s += step.by_s
        self.judge.clock_set()

    def _pilot(self, role: Role) -> None:
        program = self._drones[role].program
        if program is not None:
            program.run(lambda: program.end_mission(Outcome.PILOT_OVERRIDE))

    # --- the end

    def _over(self) -> bool:
        """Return whether nothing more is to come.

        Both missions have ended, or the receiver holds, and nobody waits for anything.
        """
        if self.now_s < self._last_s:
            return False
        for drone in self._drones.values():
            program = drone.program
            if program is None or (program.role is Role.SENDER and program.end is None):
                return False
            wake = sender.wake_ns if program.role is Role.SENDER else receiver.wake_ns
            if wake(program.handover.state) is not None:
                return False
        return True

    def _outcome(self) -> ProgramRun:
        judge = self.judge
        judge.close()
        figures = {"simulated_s": self.now_s}
        if not judge.broken and not self.plan.stalls:
            figures |= {"decided_s": judge.decided_s, "gap_s": judge.gap_s}
            if judge.commit_s is not None:
                figures["commit_s"] = judge.commit_s
        return ProgramRun(
            judge.outcome(),
            tuple(judge.violations),
            tuple(judge.beyond),
            tuple(judge.broken),
            figures,
        )


def _last_s(plan: RunPlan) -> float:
    """Return the instant by which the last of what was planned has happened."""
    at = [plan.start_s[Role.SENDER] + plan.offer_s, *(step.at_s for step in plan.steps)]
    return max((*at, *(out.end_s for out in plan.outages), *(at_s for _, at_s in plan.pilots)))


def _named(message: Message) -> str:
    about = getattr(message, "epoch", "")
    nonce = getattr(message, "nonce", None)
    return f"{type(message).__name__.upper()} epoch {about}" + (
        f" nonce {nonce:08x}" if nonce is not None else ""
    )
