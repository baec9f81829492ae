"""Both sides of the hand-over on a link that loses what a test wants lost, in virtual time."""

from __future__ import annotations

import asyncio
import gc
import random
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import Received, StateError
from drivers.log.state_file import MemoryStore
from flight.clocks import ClockAlignment, PingResult
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions import rig_library
from missions.leg import machine_run
from missions.leg.handover import protocol_config
from missions.leg.session import RoleSession
from path.messages import Abort, AbortReason, Accept, Commit, Confirm, Message, Pong, Role, Status
from path.protocol.receiver import LetGo, Provisional
from path.protocol.values import AbortRequested, PeerStatus, Send, TakeResponsibility
from tests.missions.leg.handover_pair import CONFIG, NO_END, OffsetClock, Pair, fly, kinds, until

RECEIVER_AHEAD_NS = 3_200_000_000  # of the sender's clock


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sim")


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
    provisional, for_good = receiver.of("/responsibility")
    assert provisional["responsible"] and provisional["until_ns"] < commit_of(pair).lease_end_ns + RECEIVER_AHEAD_NS
    assert for_good == {"responsible": True, "until_ns": None}
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


def commit_of(pair: Pair) -> Commit:
    commit = kinds(pair.link[Role.SENDER].sent, Commit)[0]
    assert isinstance(commit, Commit)
    return commit


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


# --- time --------------------------------------------------------------------------------------------------------


def test_a_lease_taken_at_its_very_end_is_let_go_in_time(rig: Any) -> None:
    """The receiver's program must not sleep through a deadline that the COMMIT has just set."""
    ends_ns: list[int] = []

    async def course(pair: Pair) -> None:
        pair.able = False
        for link in pair.link.values():
            link.lost = lambda _: pair.receiver.holds  # then it hears no more, and has only the time
        pair.sender.agreed(1)
        await asyncio.sleep(protocol_config(pair.session[Role.SENDER]).lease_s - 0.1)
        pair.able = True
        await until(lambda: pair.receiver.holds)
        ends_ns.append(pair.receiver.state.lease_end_ns - pair.session[Role.RECEIVER].now_ns())
        ends_ns[0] += round(asyncio.get_running_loop().time() * 1e9)
        await until(lambda: pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False})

    pair = fly(rig, course)
    let_go = [at_s for at_s, topic, _ in pair.log[Role.RECEIVER].entries if topic == "/responsibility"][-1]
    assert -1e-6 <= let_go - ends_ns[0] * 1e-9 < 0.02


@pytest.mark.parametrize("stall_s", [0.1, 0.39, 2.0])
def test_a_receiver_that_sleeps_through_the_end_of_its_lease_is_not_responsible_when_it_wakes(
    rig: Any, stall_s: float
) -> None:
    """S1 by the clock and not by a timer: nothing of its program runs while the sender takes back."""

    async def course(pair: Pair) -> None:
        receiver, session = pair.receiver, pair.session[Role.RECEIVER]
        pair.cut()
        pair.link[Role.SENDER].lost = lambda message: not isinstance(message, Commit)
        pair.sender.agreed(1)
        await until(lambda: session.responsible and receiver.holds)
        receiver.tick = lambda: 0.1  # it does not come to look at its deadlines
        pair.link[Role.SENDER].lost = lambda _: True
        await until(lambda: session.now_ns() >= receiver.state.lease_end_ns)
        await asyncio.sleep(stall_s)
        assert isinstance(receiver.state, Provisional)  # nobody has told it
        assert not session.responsible and not receiver.holds
        session.link.send(session._status())
        said = kinds(pair.link[Role.RECEIVER].sent, Status)[-1]
        assert isinstance(said, Status) and not said.responsible
        pair.session[Role.RECEIVER].log.write("/responsibility", 0, {"responsible": False, "until_ns": None})
        await until(lambda: pair.session[Role.SENDER].responsible)
        del receiver.tick

    fly(rig, course)


def test_a_confirm_after_a_stall_over_the_end_of_the_lease_holds_nothing(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        receiver, session = pair.receiver, pair.session[Role.RECEIVER]
        pair.lose(Role.SENDER, Confirm)
        pair.sender.agreed(1)
        await until(lambda: receiver.holds and pair.sender.handed_over)
        receiver.tick = lambda: 0.1
        await until(lambda: session.now_ns() > receiver.state.lease_end_ns)
        live, nonce = receiver.state.live, receiver.state.nonce
        late = Confirm(live.handoff_id, live.epoch, live.target_id, nonce, 1, live.instance)
        receiver.on_message(Received(late, session.now_ns()))
        assert isinstance(receiver.state, LetGo) and not session.responsible
        del receiver.tick

    fly(rig, course)


def test_a_status_counts_only_while_the_clocks_are_aligned_and_by_the_earliest_it_can_be_of(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def course(pair: Pair) -> None:
        session, alignment = pair.session[Role.SENDER], pair.session[Role.SENDER].alignment
        heard: list[PeerStatus] = []
        monkeypatch.setattr(pair.sender, "_on_status", heard.append)
        await session.cancel_spawned()
        stamp_ns = session.now_ns() + alignment.offset_ns + 10**12  # long after the newest exchange: a wide bound
        status = replace(cast(Status, kinds(pair.link[Role.RECEIVER].sent, Status)[-1]), stamp_ns=stamp_ns)
        pair.sender.on_status(status)
        own_ns = alignment.to_own_ns(stamp_ns)
        assert heard == [PeerStatus(False, own_ns - alignment.uncertainty_at(own_ns), pair.receiver.instance)]
        assert alignment.uncertainty_at(own_ns) > alignment.uncertainty_ns + 100_000_000
        alignment.reset()
        pair.sender.on_status(status)
        assert len(heard) == 1

    fly(rig, course)


def test_what_is_said_of_a_lease_that_is_over_is_not_said(rig: Any) -> None:
    """A stall between taking and saying so: no ACCEPT goes out that could only make an orphan."""

    async def course(pair: Pair) -> None:
        receiver, session = pair.receiver, pair.session[Role.RECEIVER]
        taken: list[TakeResponsibility | None] = []

        def slow(claim: TakeResponsibility | None) -> None:
            taken.append(claim)
            session.claim = claim
            if claim is not None:
                cast(OffsetClock, session.clock).offset_s += 2.0  # the whole program stands

        session.set_claim = slow
        pair.sender.agreed(1)
        await until(lambda: bool(taken))
        assert not session.responsible and not kinds(pair.link[Role.RECEIVER].sent, Accept)
        await until(lambda: isinstance(receiver.state, LetGo))
        assert taken[1:] == [None]

    fly(rig, course)


def test_no_commit_is_given_or_taken_while_the_clocks_are_not_aligned(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        for role in Role:
            session = pair.session[role]
            told, alignment = pair.log[role], session.alignment
            session.alignment = Deaf() if role is Role.RECEIVER else ClockAlignment()
            pair.sender.agreed(1)
            await asyncio.sleep(0.02)
            assert not pair.receiver.holds
            assert told.of("/refused")[-1]["why"] == "no_clock", role
            session.alignment = alignment
        assert await pair.decide(agree=False) == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    fly(rig, course)


class Deaf(ClockAlignment):
    """Clocks that do not become aligned."""

    def on_pong(self, pong: Pong, arrival_ns: int) -> PingResult:
        del pong, arrival_ns
        return PingResult.DUPLICATE


def test_a_slow_disk_is_told_of(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        slow = SlowStore(pair.store[Role.SENDER], 0.7)
        pair.sender._store = slow
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    notes = [note["note"] for note in fly(rig, course).log[Role.SENDER].of("/note")]
    assert any("took 0.7 s to write a record" in note for note in notes)


def test_a_disk_as_slow_as_it_may_be_is_not_told_of(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.sender._store = SlowStore(pair.store[Role.SENDER], 0.5)
        pair.session[Role.SENDER].now_ns = round_ms(pair.session[Role.SENDER].now_ns)  # type: ignore[method-assign]
        await pair.decide()

    notes = [note["note"] for note in fly(rig, course).log[Role.SENDER].of("/note")]
    assert not any("to write a record" in note for note in notes)


def round_ms(now_ns: Callable[[], int]) -> Callable[[], int]:
    return lambda: round(now_ns(), -6)


def test_what_waits_for_a_slow_disk_is_bounded(rig: Any) -> None:
    """Messages that count are said again."""

    async def course(pair: Pair) -> None:
        pair.sender._store = SlowStore(pair.store[Role.SENDER], 0.7)
        pair.cut()
        await asyncio.sleep(0.1)
        pair.sender.agreed(1)
        stray = Received(Confirm(1, 1, 1, 5, 1, 2), 0)
        refused = len(pair.log[Role.SENDER].of("/refused"))
        for _ in range(200):
            pair.sender.on_message(stray)
        assert len(pair.log[Role.SENDER].of("/refused")) == refused
        await asyncio.sleep(1.0)
        assert len(pair.log[Role.SENDER].of("/refused")) == refused + 64

    fly(rig, course)


def test_a_deadline_is_due_at_its_own_instant(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.cut()
        due_ns = pair.sender.wake_ns
        assert due_ns is not None
        now = pair.session[Role.SENDER]
        now.now_ns = lambda: due_ns - 1  # type: ignore[method-assign]
        pair.sender.tick()
        assert pair.log[Role.SENDER].of("/decision") == []
        now.now_ns = lambda: due_ns  # type: ignore[method-assign]
        pair.sender.tick()
        assert [record["outcome"] for record in pair.log[Role.SENDER].of("/decision")] == ["timeout"]
        del now.now_ns

    fly(rig, course)


def test_a_record_that_failed_after_the_mission_is_not_told_of_by_asyncio(caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        written = asyncio.get_running_loop().create_future()
        written.set_exception(OSError("full"))
        machine_run._retrieve(written)
        del written
        gc.collect()

    asyncio.run(main())
    assert caplog.records == []


class SlowStore:
    """A disk that takes its time."""

    def __init__(self, store: MemoryStore, seconds: float) -> None:
        self._store, self._seconds = store, seconds

    def load(self) -> Any:
        return self._store.load()

    def save(self, record: Any) -> None:
        self._store.save(record)

    def begin_save(self, record: Any) -> Future[None]:
        saved = Future[None]()

        def written() -> None:
            self._store.save(record)
            saved.set_result(None)

        asyncio.get_running_loop().call_later(self._seconds, written)
        return saved


# --- a new mission -----------------------------------------------------------------------------------------------


def test_a_new_mission_is_not_decided_by_the_one_before(rig: Any) -> None:
    """Nor is what became of it known already."""

    async def course(pair: Pair) -> None:
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}
        pair.receiver.begin_anew()
        pair.sender.begin_anew()
        await pair.sender.until_free()
        await pair.sender.offer()
        await asyncio.sleep(0.5)
        assert await pair.decide(timeout_s=1.0, agree=False) == {
            Role.SENDER: Outcome.NO_AGREEMENT,
            Role.RECEIVER: Outcome.NO_AGREEMENT,
        }
        assert pair.sender.epoch == 2 and not pair.receiver.holds

    fly(rig, course)


def test_time_is_told_to_a_machine_by_one_task_however_often_it_is_started(rig: Any) -> None:
    """And at least every tenth of a second."""

    async def course(pair: Pair) -> None:
        asked: list[float] = []
        right = pair.receiver.tick

        def tick() -> float:
            asked.append(asyncio.get_running_loop().time())
            return right()

        pair.receiver.tick = tick  # type: ignore[method-assign]
        for _ in range(3):
            pair.receiver.start()
        await asyncio.sleep(2.0)
        assert 18 <= len(asked) <= 24

    fly(rig, course)


def test_a_commit_is_stamped_before_anything_it_causes() -> None:
    """A receiver that is quicker than the sender's own log must not seem to have taken over before the COMMIT."""
    now_ns = 1_000
    written: list[tuple[str, int]] = []

    class SlowLink:
        def send(self, message: Message) -> None:
            nonlocal now_ns
            now_ns += 5_000_000

    class Log:
        def write(self, topic: str, stamp_ns: int, record: object) -> None:
            written.append((topic, stamp_ns))

    session = SimpleNamespace(link=SlowLink(), log=Log(), now_ns=lambda: now_ns)
    carrier = machine_run.Carrier(cast(Any, session))
    commit = Commit(1, epoch=1, target_id=1, nonce=7, lease_end_ns=2_000_000_000, stamp_ns=1_000, instance=5)
    carrier.carry_out(Send(commit))
    assert written == [("/commit", 1_000)]


def widening(session: RoleSession) -> Callable[[int], int]:
    """A bound on the clocks that is as wide as may be for a second from now, and then a little wider."""
    limit_ns, begun_ns = round(protocol_config(session).max_uncertainty_s * 1e9), session.now_ns()

    def uncertainty_at(at_ns: int) -> int:
        return limit_ns + (at_ns > begun_ns + 10**9)

    return uncertainty_at


def test_the_clocks_must_be_known_well_enough_still_at_the_leases_end(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bound that is good now and wider than allowed when the lease ends gives no COMMIT."""

    async def course(pair: Pair) -> None:
        session = pair.session[Role.SENDER]
        monkeypatch.setattr(session.alignment, "uncertainty_at", widening(session))
        pair.sender.agreed(1)
        assert not pair.sender.released and not kinds(pair.link[Role.SENDER].sent, Commit)
        monkeypatch.undo()
        pair.sender.agreed(1)
        assert pair.sender.released

    fly(rig, course)


def test_a_receiver_counts_for_two_seconds_after_its_status_and_not_longer(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def course(pair: Pair) -> None:
        session = pair.session[Role.SENDER]
        (heard_ns, _) = next(iter(pair.sender._words.values()))
        instance = pair.receiver.instance
        for after_ns, expected in ((2 * 10**9 - 1, (instance,)), (2 * 10**9, ())):
            monkeypatch.setattr(session, "now_ns", lambda at_ns=heard_ns + after_ns: at_ns)
            assert pair.sender.receivers == expected
        monkeypatch.undo()

    fly(rig, course)


def test_a_sender_without_an_attempt_names_no_receiver(rig: Any) -> None:
    """0 stands for none, here and in its Status."""

    async def main() -> int:
        return Pair(rig).session[Role.SENDER].instance()

    assert run_virtual(main()) == 0


def test_what_is_said_while_the_disk_writes_is_done_in_the_order_in_which_it_was_said(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An own decision does not overtake a message that waits: what was accepted before it was accepted."""
    done: list[object] = []

    async def course(pair: Pair) -> None:
        run = pair.receiver
        await pair.session[Role.RECEIVER].cancel_spawned()

        def step(event: object, _: int) -> tuple[()]:
            done.append(event)
            return ()

        monkeypatch.setattr(run._machine, "step", step)
        run._writing = asyncio.create_task(asyncio.sleep(0.0))
        run._hear(lambda: "a message")
        run._step(cast(Any, "an own decision"))
        assert done == []
        run._writing = None
        run._go_through_waiting()

    fly(rig, course)
    assert done[:2] == ["a message", "an own decision"]


def test_the_clocks_must_be_known_well_enough_still_at_the_end_of_a_lease_that_is_taken(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def course(pair: Pair) -> None:
        session = pair.session[Role.RECEIVER]
        monkeypatch.setattr(session.alignment, "uncertainty_at", widening(session))
        pair.sender.agreed(1)
        await asyncio.sleep(0.1)
        assert pair.sender.released and not pair.receiver.holds
        assert pair.log[Role.RECEIVER].of("/refused")[-1]["why"] == "no_clock"

    fly(rig, course)


def test_what_was_let_go_of_stays_so_when_the_disk_cannot_take_the_record_of_it(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The release came before the record: the machine does not go back to holding what its session let go of."""

    async def course(pair: Pair) -> None:
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

        def full(_: object) -> Future[None]:
            failed = Future[None]()
            failed.set_exception(StateError("cannot write: No space left on device", "make room"))
            return failed

        monkeypatch.setattr(pair.store[Role.RECEIVER], "begin_save", full)
        with pytest.raises(StateError):
            pair.receiver._step(AbortRequested(AbortReason.SHUTDOWN))
        assert not pair.session[Role.RECEIVER].responsible
        assert not pair.receiver.holds

    fly(rig, course)
