"""Both sides of the hand-over on a link that loses what a test wants lost, in virtual time."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from drivers.interfaces import FlightMode, LinkCounters, Received, VehicleState
from drivers.state_file import MemoryStore
from flight.config import Deadlines, MissionConfig
from flight.outcome import MissionEnd, Outcome
from hil.virtual_time import run_virtual
from missions import rig_library
from missions.handover import ReceiverHandover, SenderHandover, protocol_config
from missions.session import Session
from path.messages import Abort, AbortReason, Accept, Candidate, Commit, Confirm, Message, Role, Status, Target
from path.observations import MissReason

CONFIG = MissionConfig(deadlines=Deadlines(verify_s=12.0, receiver_ready_s=20.0))
STATE = VehicleState(
    0, 0, (0.0, 0.0, -1.5), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, True, True, FlightMode.OFFBOARD, 0.9
)
NO_END = MissionEnd(Outcome.TARGET_LOST, "target not seen for 2.0 s")


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sim")


@dataclass
class OffsetClock:
    offset_s: float

    def now_ns(self) -> int:
        return round((asyncio.get_running_loop().time() + self.offset_s) * 1e9)


@dataclass
class FakeLink:
    """One end. ``lost`` says of each message whether it is."""

    clock: OffsetClock
    lost: Callable[[Message], bool] = lambda _: False
    counters: LinkCounters = field(default_factory=LinkCounters)
    sent: list[Message] = field(default_factory=list[Message])
    waiting: asyncio.Queue[Received] = field(default_factory=asyncio.Queue[Received])
    other: FakeLink | None = None

    def send(self, message: Message) -> None:
        self.sent.append(message)
        other = self.other
        assert other is not None
        if not self.lost(message):
            asyncio.get_running_loop().call_later(0.004, other.arrive, message)

    def arrive(self, message: Message) -> None:
        self.waiting.put_nowait(Received(message, self.clock.now_ns()))

    async def receive(self) -> Received:
        return await self.waiting.get()


@dataclass
class FakeVehicle:
    state: VehicleState = STATE


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.01)


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
    """Two sessions, their hand-overs, and what flows between them: Targets one way, Candidates the other."""

    def __init__(self, rig: Any, able: bool = True) -> None:
        self.able = able
        self.log = {role: Recorder() for role in Role}
        self.link = {Role.SENDER: FakeLink(OffsetClock(1.0)), Role.RECEIVER: FakeLink(OffsetClock(4.2))}
        self.link[Role.SENDER].other, self.link[Role.RECEIVER].other = (
            self.link[Role.RECEIVER],
            self.link[Role.SENDER],
        )
        self.store = {role: MemoryStore() for role in Role}
        self.session = {role: self._session(rig, role) for role in Role}
        self.sender = SenderHandover(self.session[Role.SENDER], self.store[Role.SENDER])
        self.receiver = ReceiverHandover(self.session[Role.RECEIVER], self.store[Role.RECEIVER], lambda: self.able)
        self.verified_again: list[int] = []
        sender, receiver = self.session[Role.SENDER], self.session[Role.RECEIVER]
        sender.on_message, sender.on_status = self.sender.on_message, self.sender.on_status
        receiver.on_message, receiver.on_status = self.on_receiver, self.receiver.on_status

    def _session(self, rig: Any, role: Role) -> Session:
        link = self.link[role]
        parts = cast(Any, (link.clock, FakeVehicle(), None, link))
        entropy = random.Random(role.value)
        return Session(rig, role, CONFIG, self.log[role], lambda _: None, asyncio.Event(), parts, entropy)

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
        self.sender.offer()
        self.receiver.start()
        self.session[Role.SENDER].spawn(self.offer_targets())
        await asyncio.sleep(0.5)

    async def decide(self, timeout_s: float = 10.0, agree: bool = True) -> dict[Role, Outcome]:
        """Both sides to their decision: the outcome of each."""
        if agree:
            self.sender.agreed(1)
        decisions = {
            Role.SENDER: self.sender.until_decided(timeout_s, self.verify_again),
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

    def lose(self, role: Role, *kinds: type[Message], when: Callable[[], bool] = lambda: True) -> None:
        """What this role sends of these kinds does not arrive, as long as ``when``."""
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
        changes = sorted(
            (entry[0], role.value, bool(entry[2]["responsible"]))
            for role, log in self.log.items()
            for entry in log.entries
            if entry[1] == "/responsibility"
        )
        now: dict[str, bool] = {}
        for at_s, role, responsible in changes:
            now[role] = responsible
            assert sum(now.values()) <= 1, f"two responsible at {at_s} s: {changes}"
        assert {role.value: flag for role, flag in self.responsible().items() if flag} == {
            role: flag for role, flag in now.items() if flag
        }


def fly(rig: Any, course: Callable[[Pair], Coroutine[Any, Any, None]], able: bool = True) -> Pair:
    async def main() -> Pair:
        pair = Pair(rig, able)
        await pair.begin()
        await course(pair)
        await pair.end()
        pair.check_never_two()
        return pair

    return cast(Pair, run_virtual(main()))


def kinds(messages: list[Message], *of: type[Message]) -> list[Message]:
    return [message for message in messages if isinstance(message, of)]


# --- the good path -----------------------------------------------------------------------------------------------


def test_commit_accept_confirm_hands_the_target_over(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}
    assert pair.sender.handed_over and pair.sender.released
    assert pair.receiver.holds and pair.receiver.holds_for_good
    assert pair.verified_again == []
    sender, receiver = pair.log[Role.SENDER], pair.log[Role.RECEIVER]
    assert [r["responsible"] for r in sender.of("/responsibility")] == [True, False]
    assert receiver.of("/responsibility") == [
        {"responsible": True, "provisional": True},
        {"responsible": True, "provisional": False},
    ]
    assert [r["outcome"] for r in sender.of("/decision")] == ["handed_over"]
    assert [r["outcome"] for r in sender.of("/settled")] == ["handed_over"]
    assert [r["outcome"] for r in receiver.of("/decision")] == ["handed_over"]


def test_the_release_is_written_before_the_commit_is_sent(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        sent_before = len(kinds(pair.link[Role.SENDER].sent, Commit))
        pair.sender.agreed(1)
        assert (sent_before, len(kinds(pair.link[Role.SENDER].sent, Commit))) == (0, 1)

    pair = fly(rig, course)
    topics = [
        topic for _, topic, _ in pair.log[Role.SENDER].entries if topic in ("/epoch", "/responsibility", "/commit")
    ]
    assert topics[-3:] == ["/epoch", "/responsibility", "/commit"]
    assert pair.log[Role.SENDER].of("/epoch")[-1] == {"epoch": 1, "duty": "released"}
    (commit,) = pair.log[Role.SENDER].of("/commit")
    (sent,) = kinds(pair.link[Role.SENDER].sent, Commit)
    assert isinstance(sent, Commit)
    assert commit == {"target_id": 1, "epoch": 1, "nonce": sent.nonce, "lease_end_ns": sent.lease_end_ns}


def test_agreeing_frame_after_frame_is_one_commit(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Commit, when=lambda: asyncio.get_running_loop().time() < 1.0)
        for _ in range(5):
            pair.sender.agreed(1)
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    commits = kinds(fly(rig, course).link[Role.SENDER].sent, Commit)
    assert len({commit.nonce for commit in commits if isinstance(commit, Commit)}) == 1


def test_an_attempt_taken_back_before_anybody_waited_is_verified_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await asyncio.sleep(4.0)
        assert await pair.decide(agree=False, timeout_s=2.0) == {
            Role.SENDER: Outcome.NO_AGREEMENT,
            Role.RECEIVER: Outcome.NO_AGREEMENT,
        }

    assert fly(rig, course).verified_again == [2]


# --- what a link may lose ----------------------------------------------------------------------------------------


def test_a_lost_accept_is_taken_back_and_verified_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept, when=lambda: pair.sender.epoch == 1)
        agree = asyncio.create_task(agree_again(pair))
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}
        agree.cancel()

    pair = fly(rig, course)
    assert pair.verified_again == [2]
    assert [r["outcome"] for r in pair.log[Role.SENDER].of("/decision")] == ["taken_back", "handed_over"]
    assert [r["outcome"] for r in pair.log[Role.RECEIVER].of("/decision")] == ["let_go", "handed_over"]
    assert [r["epoch"] for r in pair.log[Role.SENDER].of("/commit")][-1] == 2
    nonces = {commit["epoch"]: commit["nonce"] for commit in pair.log[Role.SENDER].of("/commit")}
    assert nonces[1] != nonces[2]
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


async def agree_again(pair: Pair) -> None:
    await until(lambda: bool(pair.verified_again))
    await asyncio.sleep(0.5)
    pair.sender.agreed(1)


def test_a_lost_confirm_is_asked_for_again(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        start_s = asyncio.get_running_loop().time()
        pair.lose(Role.SENDER, Confirm, when=lambda: asyncio.get_running_loop().time() < start_s + 0.4)
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    pair = fly(rig, course)
    assert len(kinds(pair.link[Role.RECEIVER].sent, Accept)) > 3
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


def test_without_any_confirm_nobody_holds_and_both_say_so(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Confirm)
        assert await pair.decide() == {Role.SENDER: Outcome.ORPHANED, Role.RECEIVER: Outcome.ORPHANED}

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: False}
    assert pair.verified_again == []  # what was accepted is never taken back


def test_a_link_that_dies_after_the_accept_orphans(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.link[Role.SENDER].lost = lambda message: isinstance(message, Confirm) or pair.sender.handed_over
        pair.link[Role.RECEIVER].lost = lambda _: pair.sender.handed_over
        assert await pair.decide() == {Role.SENDER: Outcome.ORPHANED, Role.RECEIVER: Outcome.ORPHANED}

    pair = fly(rig, course)
    assert pair.log[Role.SENDER].of("/settled")[0]["outcome"] == "unconfirmed"
    assert pair.log[Role.RECEIVER].of("/settled")[0]["outcome"] == "unconfirmed"


def test_a_link_that_dies_at_the_commit_leaves_the_target_with_the_sender(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.cut()
        outcomes = await pair.decide(timeout_s=5.0)
        assert outcomes == {Role.SENDER: Outcome.NO_AGREEMENT, Role.RECEIVER: Outcome.NO_AGREEMENT}

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert pair.verified_again == [2]


@pytest.mark.parametrize("seed", range(8))
def test_whatever_is_lost_there_are_never_two_and_both_come_to_an_end(rig: Any, seed: int) -> None:
    """S1 and no dead end, with up to 80 % of all packets lost."""
    chance = random.Random(seed)
    share = chance.uniform(0.2, 0.8)

    async def course(pair: Pair) -> None:
        for link in pair.link.values():
            link.lost = lambda _: chance.random() < share

        async def agree_always() -> None:
            while True:
                pair.sender.agreed(1)
                await asyncio.sleep(0.3)

        agreeing = asyncio.create_task(agree_always())
        outcomes = await pair.decide()
        agreeing.cancel()
        assert set(outcomes.values()) <= {
            Outcome.COMMITTED,
            Outcome.NO_AGREEMENT,
            Outcome.ORPHANED,
            Outcome.PEER_ABORTED,
        }
        if outcomes[Role.SENDER] is Outcome.COMMITTED:
            assert pair.receiver.holds_for_good
        if pair.receiver.holds_for_good:
            assert pair.sender.handed_over

    fly(rig, course)


# --- deadlines and ends ------------------------------------------------------------------------------------------


def test_without_agreement_the_deadline_ends_it(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        start_s = asyncio.get_running_loop().time()
        with pytest.raises(MissionEnd) as caught:
            await pair.sender.until_decided(6.0, pair.verify_again)
        assert caught.value.outcome is Outcome.NO_AGREEMENT
        assert asyncio.get_running_loop().time() - start_s == pytest.approx(6.0, abs=0.5)
        pair.sender.end(caught.value)
        with pytest.raises(MissionEnd) as peer:
            await pair.receiver.until_held(6.0)
        assert peer.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    (abort,) = kinds(pair.link[Role.SENDER].sent, Abort)
    assert isinstance(abort, Abort)
    assert abort.reason is AbortReason.TIMEOUT


def test_a_commit_under_way_at_the_deadline_is_decided_by_its_lease(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        async def agree_late() -> None:
            await asyncio.sleep(2.9)
            pair.lose(Role.RECEIVER, Accept, when=lambda: asyncio.get_running_loop().time() < deadline_s + 0.5)
            pair.sender.agreed(1)

        deadline_s = asyncio.get_running_loop().time() + 3.0
        late = asyncio.create_task(agree_late())
        assert await pair.decide(timeout_s=3.0, agree=False) == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }
        await late

    fly(rig, course)


@pytest.mark.parametrize("quitter", Role)
def test_who_gives_up_before_the_commit_tells_the_other_why(rig: Any, quitter: Role) -> None:
    async def course(pair: Pair) -> None:
        (pair.sender if quitter is Role.SENDER else pair.receiver).end(NO_END)
        stays = (
            pair.receiver.until_held(5.0) if quitter is Role.SENDER else pair.sender.until_decided(5.0, lambda: None)
        )
        with pytest.raises(MissionEnd) as caught:
            await stays
        assert caught.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    reasons = [abort.reason for abort in kinds(pair.link[quitter].sent, Abort) if isinstance(abort, Abort)]
    assert reasons[0] is AbortReason.TARGET_LOST
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}


def test_what_was_handed_over_is_not_given_up_by_a_later_end(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        before = {role: len(kinds(pair.link[role].sent, Abort)) for role in Role}
        pair.sender.end(NO_END)
        pair.receiver.end(NO_END)
        await asyncio.sleep(1.0)
        assert {role: len(kinds(pair.link[role].sent, Abort)) for role in Role} == before

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}


def test_a_mission_that_ends_well_gives_nothing_up(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.sender.end(None)
        pair.receiver.end(None)
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    fly(rig, course)


def test_a_receiver_that_gives_up_what_it_holds_provisionally_orphans_nothing_it_was_not_given(rig: Any) -> None:
    """Its ACCEPTs are lost, it ends: the sender takes back at the lease's end, and knows that it was no time-out."""

    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await asyncio.sleep(0.2)
        assert pair.receiver.holds and not pair.receiver.holds_for_good
        pair.receiver.end(NO_END)
        assert not pair.receiver.holds
        with pytest.raises(MissionEnd) as caught:
            await pair.sender.until_decided(5.0, pair.verify_again)
        assert caught.value.outcome is Outcome.PEER_ABORTED

    pair = fly(rig, course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert pair.verified_again == []


def test_a_receiver_that_does_not_see_the_target_refuses_it(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        outcomes = await pair.decide(timeout_s=3.0)
        assert outcomes[Role.SENDER] is Outcome.NO_AGREEMENT

    pair = fly(rig, course, able=False)
    assert "not_able" in [record["why"] for record in pair.log[Role.RECEIVER].of("/refused")]
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert not kinds(pair.link[Role.RECEIVER].sent, Accept)


def test_the_protocol_does_not_end_a_handoff_before_the_mission_does(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        config = protocol_config(pair.session[Role.SENDER])
        deadlines = CONFIG.deadlines
        assert config.offer_s >= deadlines.receiver_ready_s + deadlines.verify_s
        assert config.handoff_s >= config.offer_s + deadlines.verify_s

    fly(rig, course)


def test_a_status_says_who_is_responsible(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await asyncio.sleep(0.5)

    pair = fly(rig, course)
    newest = {role: kinds(pair.link[role].sent, Status)[-1] for role in Role}
    assert [cast(Status, newest[role]).responsible for role in Role] == [False, True]
