"""Two sessions with their hand-overs, and the link between them, for tests in virtual time."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, cast

from drivers.interfaces import FlightMode, LinkCounters, Received, VehicleState
from drivers.log.state_file import MemoryStore
from flight.config import Deadlines, MissionConfig
from flight.outcome import MissionEnd, Outcome
from flight.steady_vehicle import SteadyVehicle
from hil.harness.virtual_time import run_virtual
from hil.monitors.claims import Claims, in_world_time
from missions.fly.leg.handover import ReceiverHandover, SenderHandover
from missions.fly.leg.session import RoleSession
from path.messages import Candidate, Message, Role, Target
from path.observations import MissReason

CONFIG = MissionConfig(deadlines=Deadlines(verify_s=12.0, receiver_ready_s=20.0))
STATE = VehicleState(
    0,
    0,
    (0.0, 0.0, -1.5),
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    True,
    True,
    True,
    FlightMode.OFFBOARD,
    0.9,
)
NO_END = MissionEnd(Outcome.TARGET_LOST, "target not seen for 2.0 s")


@dataclass
class OffsetClock:
    """Stands once the run is over."""

    offset_s: float
    _newest_ns: int = 0

    def now_ns(self) -> int:
        with suppress(RuntimeError):
            self._newest_ns = round((asyncio.get_running_loop().time() + self.offset_s) * 1e9)
        return self._newest_ns


@dataclass
class FakeLink:
    """One end. ``lost`` says of each message whether it is."""

    clock: OffsetClock
    lost: Callable[[Message], bool] = lambda _: False
    delay_s: float = 0.004
    counters: LinkCounters = field(default_factory=LinkCounters)
    sent: list[Message] = field(default_factory=list[Message])
    waiting: asyncio.Queue[Received] = field(default_factory=asyncio.Queue[Received])
    other: FakeLink | None = None

    def send(self, message: Message) -> None:
        self.sent.append(message)
        other = self.other
        assert other is not None
        if not self.lost(message):
            asyncio.get_running_loop().call_later(self.delay_s, other.arrive, message)

    def arrive(self, message: Message) -> None:
        self.waiting.put_nowait(Received(message, self.clock.now_ns()))

    async def receive(self) -> Received:
        return await self.waiting.get()


@dataclass
class FakeVehicle:
    state: VehicleState = STATE


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(6000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("did not come about within a minute")


Entry = tuple[float, str, dict[str, Any]]


@dataclass
class Recorder:
    """A log with true time."""

    entries: list[Entry] = field(default_factory=list[Entry])

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.entries.append((asyncio.get_running_loop().time(), topic, dict(record)))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [record for _, name, record in self.entries if name == topic]


class Pair:
    """Two sessions, their hand-overs, and what flows between them: Targets one way, Candidates the
    other.
    """

    def __init__(
        self, rig: Any, able: bool = True, delay_s: float = 0.004, clocks_s: float = 0.1
    ) -> None:
        self.able = able
        self.config = replace(CONFIG, clock_uncertainty_s=clocks_s)
        self.log = {role: Recorder() for role in Role}
        self.link = {
            Role.SENDER: FakeLink(OffsetClock(1.0), delay_s=delay_s),
            Role.RECEIVER: FakeLink(OffsetClock(4.2), delay_s=delay_s),
        }
        self.link[Role.SENDER].other, self.link[Role.RECEIVER].other = (
            self.link[Role.RECEIVER],
            self.link[Role.SENDER],
        )
        self.store = {role: MemoryStore() for role in Role}
        self.session = {role: self._session(rig, role) for role in Role}
        self.sender = SenderHandover(self.session[Role.SENDER], self.store[Role.SENDER])
        self.receiver = ReceiverHandover(
            self.session[Role.RECEIVER], self.store[Role.RECEIVER], lambda: self.able
        )
        self.verified_again: list[int] = []
        sender, receiver = self.session[Role.SENDER], self.session[Role.RECEIVER]
        sender.on_message, sender.on_status = self.sender.on_message, self.sender.on_status
        receiver.on_message, receiver.on_status = self.on_receiver, self.receiver.on_status

    def _session(self, rig: Any, role: Role) -> RoleSession:
        link = self.link[role]
        parts = cast(Any, (link.clock, FakeVehicle(), None, link))
        entropy = random.Random(role.value)
        return RoleSession(
            rig, role, self.config, self.log[role], lambda _: None, asyncio.Event(), parts, entropy
        )

    def on_receiver(self, received: Received) -> None:
        self.receiver.on_message(received)
        message, live = received.message, self.receiver.live
        if isinstance(message, Target) and live is not None:
            answer = Candidate(
                handoff_id=live.handoff_id,
                epoch=live.epoch,
                target_id=live.target_id,
                sequence=message.sequence,
                target_sequence=message.sequence,
                capture_ns=received.arrival_ns,
                box=None,
                reason=MissReason.NO_CANDIDATE,
                position_v_m=(0.0, 0.0, 1.0),
                rotation_v_c2=(1.0, 0.0, 0.0, 0.0),
                sigma_m=0.01,
            )
            self.link[Role.RECEIVER].send(answer)

    async def offer_targets(self) -> None:
        sequence = 0
        while True:
            sequence += 1
            stamp_ns = self.session[Role.SENDER].now_ns()
            epoch = self.sender.epoch
            if epoch and not self.sender.released:
                self.link[Role.SENDER].send(
                    Target(1, epoch, 1, sequence, stamp_ns, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 0.01)
                )
            await asyncio.sleep(0.04)

    async def begin(self) -> None:
        """Clocks aligned, target offered, candidates flowing."""
        for session in self.session.values():
            session.spawn(session.pump())
            session.spawn(session.report())
        await until(lambda: all(session.alignment.ready for session in self.session.values()))
        await self.sender.offer()
        self.receiver.start()
        self.session[Role.SENDER].spawn(self.offer_targets())
        # until a Candidate has come back
        await asyncio.sleep(0.5 + 3.0 * self.link[Role.SENDER].delay_s)

    async def _sender_decides(self, timeout_s: float) -> None:
        await self.sender.until_decided(timeout_s, self.verify_again)
        await self.sender.until_settled()

    async def decide(self, timeout_s: float = 10.0, agree: bool = True) -> dict[Role, Outcome]:
        """Both sides to their decision: the outcome of each."""
        if agree:
            self.sender.agreed(1)
        decisions = {
            Role.SENDER: self._sender_decides(timeout_s),
            Role.RECEIVER: self.receiver.until_held(2.0 * timeout_s),
        }
        ends = await asyncio.gather(*decisions.values(), return_exceptions=True)
        outcomes: dict[Role, Outcome] = {}
        for role, end in zip(decisions, ends, strict=True):
            if end is not None and not isinstance(end, MissionEnd):
                raise end
            outcomes[role] = Outcome.COMMITTED if end is None else end.outcome
        return outcomes

    def verify_again(self) -> None:
        self.verified_again.append(self.sender.epoch)

    def lose(
        self, role: Role, *kinds: type[Message], when: Callable[[], bool] = lambda: True
    ) -> None:
        """Loses what this role sends of these kinds, as long as ``when``."""
        self.link[role].lost = lambda message: isinstance(message, kinds) and when()

    def cut(self) -> None:
        for link in self.link.values():
            link.lost = lambda _: True

    async def end(self) -> None:
        for session in self.session.values():
            await session.cancel_spawned()
            if session.ended.done():
                raise session.ended.result()

    def responsible(self) -> dict[Role, bool]:
        return {role: session.responsible for role, session in self.session.items()}

    def check_never_two(self) -> None:
        """S1, in true time, and every change of mind logged."""
        changes = [
            (
                entry[0],
                role.value,
                in_world_time(entry[2], round(self.link[role].clock.offset_s * 1e9)),
            )
            for role, log in self.log.items()
            for entry in log.entries
            if entry[1] == "/responsibility"
        ]
        changes.sort(key=lambda change: change[0])
        claims = Claims()
        for at_s, role, record in changes:
            claims.note(role, record)
            assert len(claims.holders(at_s)) <= 1, f"two responsible at {at_s} s: {changes}"
        end_s = max(at_s for at_s, _, _ in changes) + 100.0
        assert {role.value for role, flag in self.responsible().items() if flag} == set(
            claims.holders(end_s)
        )


def fly(
    rig: Any, course: Callable[[Pair], Coroutine[Any, Any, None]], able: bool = True, **link: float
) -> Pair:
    async def main() -> Pair:
        pair = Pair(rig, able, **link)
        await pair.begin()
        await course(pair)
        await pair.end()
        pair.check_never_two()
        return pair

    return cast(Pair, run_virtual(main()))


def kinds(messages: list[Message], *of: type[Message]) -> list[Message]:
    return [message for message in messages if isinstance(message, of)]


async def killed(pair: Pair, role: Role) -> None:
    """Its tasks end between two packets; what was on the way to it is lost."""
    session = pair.session[role]
    await session.cancel_spawned()
    session.claim = None
    # as a dead program is
    pair.log[role].write("/responsibility", 0, {"responsible": False, "until_ns": None})
    while not pair.link[role].waiting.empty():
        pair.link[role].waiting.get_nowait()


def started(pair: Pair, rig: Any, role: Role, *, flying: bool) -> SenderHandover | ReceiverHandover:
    """A new program with the old one's disk."""
    session = pair.session[role] = pair._session(rig, role)
    vehicle = cast(Any, FakeVehicle(replace(STATE, armed=flying)))
    session.vehicle = SteadyVehicle(vehicle, session.config)
    handover: SenderHandover | ReceiverHandover
    if role is Role.SENDER:
        handover = pair.sender = SenderHandover(session, pair.store[role])
        session.on_message = handover.on_message
    else:
        handover = pair.receiver = ReceiverHandover(session, pair.store[role], lambda: True)
        session.on_message = pair.on_receiver
    session.on_status = handover.on_status
    session.spawn(session.pump())
    session.spawn(session.report())
    return handover
