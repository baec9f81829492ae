"""A role's program is killed and started again, or its disk fails: what was written down decides."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, wait
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from drivers.interfaces import Kept, StateError
from drivers.log.state_file import MemoryStore, StateFile
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions import rig_library
from missions.leg.handover import ReceiverHandover, SenderHandover, protocol_config
from path.messages import Abort, Accept, Commit, Confirm, Role, Status
from path.protocol.receiver import LetGo
from path.protocol.values import Handoff, ReceiverRecord, SenderRecord
from tests.missions.leg.handover_pair import NO_END, STATE, FakeVehicle, Pair, fly, kinds, until

LIVE = Handoff(1, 1, 1)
NS = 1_000_000_000


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sim")


async def killed(pair: Pair, role: Role) -> None:
    """Its tasks end between two packets; what was on the way to it is lost."""
    session = pair.session[role]
    await session.cancel_spawned()
    session.claim = None
    pair.log[role].write("/responsibility", 0, {"responsible": False, "until_ns": None})  # as a dead program is
    while not pair.link[role].waiting.empty():
        pair.link[role].waiting.get_nowait()


def started(pair: Pair, rig: Any, role: Role, *, flying: bool) -> SenderHandover | ReceiverHandover:
    """A new program with the old one's disk."""
    session = pair.session[role] = pair._session(rig, role)
    session.vehicle = cast(Any, FakeVehicle(replace(STATE, armed=flying)))
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


@pytest.mark.parametrize("down_s", [0.05, 0.4, 3.0])
def test_a_sender_killed_after_its_commit_takes_back_what_nobody_accepted(rig: Any, down_s: float) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await killed(pair, Role.SENDER)
        await asyncio.sleep(down_s)
        sender = started(pair, rig, Role.SENDER, flying=True)
        assert not pair.session[Role.SENDER].responsible
        with pytest.raises(MissionEnd) as caught:
            await sender.resume()
        assert caught.value.outcome is Outcome.RESTARTED
        assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}

    fly(rig, course)


def test_a_sender_killed_after_the_accept_confirms_it_when_it_is_back(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.SENDER, Confirm)
        pair.sender.agreed(1)
        await until(lambda: pair.sender.handed_over)
        await killed(pair, Role.SENDER)
        await asyncio.sleep(0.3)
        pair.link[Role.SENDER].lost = lambda _: False
        sender = started(pair, rig, Role.SENDER, flying=True)
        with pytest.raises(MissionEnd, match="handed_over"):
            await sender.resume()

    pair = fly(rig, course)
    assert pair.receiver.holds_for_good
    assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}
    assert pair.log[Role.SENDER].of("/settled")[-1]["outcome"] == "handed_over"


@pytest.mark.parametrize("down_s", [0.05, 3.0])
def test_a_receiver_killed_within_its_lease_holds_on_or_lets_go(rig: Any, down_s: float) -> None:
    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        await killed(pair, Role.RECEIVER)
        pair.link[Role.RECEIVER].lost = lambda _: False
        await asyncio.sleep(down_s)
        receiver = started(pair, rig, Role.RECEIVER, flying=True)
        assert pair.session[Role.RECEIVER].responsible == (down_s < 1.0)
        told = pair.log[Role.RECEIVER].of("/epoch")[-1]["duty"]  # what it is now, not what it was
        assert told == ("provisional" if down_s < 1.0 else "let_go")
        with pytest.raises(MissionEnd) as caught:
            await receiver.resume()
        assert caught.value.outcome is Outcome.RESTARTED
        handed_over = down_s < 1.0
        assert pair.responsible() == {Role.SENDER: not handed_over, Role.RECEIVER: handed_over}
        assert pair.receiver.holds_for_good == handed_over

    fly(rig, course)


def test_a_receiver_killed_while_it_holds_still_does_and_says_so(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await killed(pair, Role.RECEIVER)
        await asyncio.sleep(5.0)
        started(pair, rig, Role.RECEIVER, flying=True)
        await asyncio.sleep(0.5)
        (said,) = {cast(Status, m).responsible for m in kinds(pair.link[Role.RECEIVER].sent[-5:], Status)}
        assert said and pair.receiver.holds_for_good

    fly(rig, course)


def test_on_the_ground_a_new_mission_begins_with_the_next_epoch(rig: Any) -> None:
    """Whichever program is started first: a sender waits for the receiver to have let go of the old target."""

    async def course(pair: Pair) -> None:
        await pair.decide()
        for role in Role:
            await killed(pair, role)
        sender = cast(SenderHandover, started(pair, rig, Role.SENDER, flying=False))
        await sender.resume()
        free = asyncio.create_task(sender.until_free())
        receiver = started(pair, rig, Role.RECEIVER, flying=False)
        await asyncio.sleep(0.5)
        assert pair.receiver.holds_for_good and not free.done()
        await receiver.resume()
        await free
        await until(lambda: all(session.alignment.ready for session in pair.session.values()))
        assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: False}
        await sender.offer()
        pair.receiver.start()
        pair.session[Role.SENDER].spawn(pair.offer_targets())
        await asyncio.sleep(0.5)
        assert sender.epoch == 2
        assert await pair.decide() == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    fly(rig, course)


def test_a_sender_does_not_begin_anew_while_the_receiver_holds(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        await pair.decide()
        await killed(pair, Role.SENDER)
        sender = cast(SenderHandover, started(pair, rig, Role.SENDER, flying=False))
        await sender.resume()
        with pytest.raises(MissionEnd, match="did not let go") as caught:
            await sender.until_free()
        assert caught.value.outcome is Outcome.PEER_ABORTED
        assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: True}

    fly(rig, course)


def test_what_the_receiver_said_before_it_was_given_the_target_is_no_word_of_its_being_free(rig: Any) -> None:
    """A sender killed after its COMMIT, started on the ground, hands over by its record and begins anew at once."""

    async def course(pair: Pair) -> None:
        session = pair.session[Role.SENDER]
        status = next(m for m in reversed(pair.link[Role.RECEIVER].sent) if isinstance(m, Status))
        assert not status.responsible
        old_ns = session.alignment.to_own_ns(status.stamp_ns)
        handover = pair.sender
        handover.begin_anew()
        handover.on_status(status)
        assert not handover.peer_is_free and old_ns < session.now_ns()
        handover.on_status(replace(status, stamp_ns=status.stamp_ns + 10**9))
        assert handover.peer_is_free
        handover.on_status(replace(status, stamp_ns=status.stamp_ns + 2 * 10**9, responsible=True))
        assert not handover.peer_is_free

    fly(rig, course)


# --- disks that fail ---------------------------------------------------------------------------------------------


class FailingStore(MemoryStore):
    """Its disk is full from the first record of this duty on."""

    def __init__(self, duty: str) -> None:
        super().__init__()
        self.duty = duty
        self.failing = False

    def save(self, record: SenderRecord | ReceiverRecord) -> None:
        self.failing = self.failing or record.duty == self.duty
        if self.failing:
            raise StateError("cannot write: No space left on device", "make room")
        super().save(record)


def with_failing(rig: Any, role: Role, duty: str, course: Callable[[Pair], Coroutine[Any, Any, None]]) -> Pair:
    async def main() -> Pair:
        pair = Pair(rig)
        pair.store[role] = store = FailingStore(duty)
        (pair.sender if role is Role.SENDER else pair.receiver)._store = store
        await pair.begin()
        await course(pair)
        for session in pair.session.values():
            await session.cancel_spawned()
        pair.check_never_two()
        return pair

    return cast(Pair, run_virtual(main()))


@pytest.mark.parametrize("role", Role)
def test_a_disk_that_cannot_be_written_is_found_before_anything_flies(rig: Any, role: Role) -> None:
    async def main() -> None:
        pair = Pair(rig)
        pair.store[role] = FailingStore("idle" if role is Role.SENDER else "observing")
        with pytest.raises(StateError):
            started(pair, rig, role, flying=False)

    run_virtual(main())


def test_a_sender_that_cannot_write_it_down_does_not_release_nor_commit(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        with pytest.raises(StateError):
            pair.sender.agreed(1)
        pair.sender.end(NO_END)
        await asyncio.sleep(0.5)

    pair = with_failing(rig, Role.SENDER, "released", course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert not kinds(pair.link[Role.SENDER].sent, Commit)


def test_a_sender_that_cannot_write_the_accept_down_confirms_nothing(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.sender.agreed(1)
        ended = pair.session[Role.SENDER].ended
        assert (await ended).outcome is Outcome.STATE_LOST
        await asyncio.sleep(3.0)

    pair = with_failing(rig, Role.SENDER, "handed_over", course)
    assert not kinds(pair.link[Role.SENDER].sent, Confirm)
    assert pair.responsible()[Role.RECEIVER] is False


def test_a_receiver_that_cannot_write_it_down_takes_and_accepts_nothing(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        pair.sender.agreed(1)
        assert (await pair.session[Role.RECEIVER].ended).outcome is Outcome.STATE_LOST
        await until(lambda: pair.session[Role.SENDER].responsible)

    pair = with_failing(rig, Role.RECEIVER, "provisional", course)
    assert pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False}
    assert not kinds(pair.link[Role.RECEIVER].sent, Accept)


def test_a_receiver_whose_disk_takes_longer_than_the_lease_takes_nothing(rig: Any) -> None:
    class Slow(MemoryStore):
        def save(self, record: SenderRecord | ReceiverRecord) -> None:
            super().save(record)
            if record.duty == "provisional":
                clock.offset_s += 5.0  # the loop stood still for so long

    async def main() -> Pair:
        nonlocal clock
        pair = Pair(rig)
        clock = pair.link[Role.RECEIVER].clock
        pair.receiver._store = Slow()
        await pair.begin()
        pair.sender.agreed(1)
        await asyncio.sleep(0.05)
        assert not pair.session[Role.RECEIVER].responsible
        assert not kinds(pair.link[Role.RECEIVER].sent, Accept)
        for session in pair.session.values():
            await session.cancel_spawned()
        return pair

    clock: Any = None
    run_virtual(main())


class Waited(StateFile):
    """Virtual time does not know how long a thread takes: it stands still for a real disk."""

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        saved = super().begin_save(record)
        wait([saved])
        return saved


def test_real_files_carry_a_handover_over_a_kill_of_both(rig: Any, tmp_path: Path) -> None:
    async def course(pair: Pair) -> None:
        for role, handover in ((Role.SENDER, pair.sender), (Role.RECEIVER, pair.receiver)):
            pair.store[role] = cast(Any, Waited(tmp_path / f"{role.value}.json", role))
            handover._store = pair.store[role]
        pair.lose(Role.SENDER, Confirm)
        pair.sender.agreed(1)
        await until(lambda: pair.sender.handed_over)
        for role in Role:
            await killed(pair, role)
        assert cast(Kept, pair.store[Role.SENDER].load()).record.duty == "handed_over"
        assert cast(Kept, pair.store[Role.RECEIVER].load()).record.duty == "provisional"
        pair.link[Role.SENDER].lost = lambda _: False
        started(pair, rig, Role.SENDER, flying=True)
        cast(ReceiverHandover, started(pair, rig, Role.RECEIVER, flying=True)).start()
        await until(lambda: pair.receiver.holds_for_good)

    fly(rig, course)


def test_a_full_disk_is_a_named_end(rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def course(pair: Pair) -> None:
        pair.sender._store = Waited(tmp_path / "sender.json", Role.SENDER)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(StateError, match="No space left"):
                pair.sender.agreed(1)
        assert pair.session[Role.SENDER].responsible and not pair.sender.released

    fly(rig, course)


# --- disks that are slow -----------------------------------------------------------------------------------------


class SlowStore(MemoryStore):
    """It takes a while, and the loop goes on meanwhile."""

    def __init__(self, takes_s: float, fails: bool = False) -> None:
        super().__init__()
        self.takes_s = takes_s
        self.fails = fails
        self.duties: list[str] = []

    def begin_save(self, record: SenderRecord | ReceiverRecord) -> Future[None]:
        saved = Future[None]()
        self.duties.append(record.duty)

        def on_the_disk() -> None:
            if self.fails:
                saved.set_exception(StateError("cannot write: No space left on device", "make room"))
            else:
                self.save(record)
                saved.set_result(None)

        asyncio.get_running_loop().call_later(self.takes_s, on_the_disk)
        return saved


def slow(pair: Pair, role: Role, takes_s: float, fails: bool = False) -> SlowStore:
    store = pair.store[role] = SlowStore(takes_s, fails)
    (pair.sender if role is Role.SENDER else pair.receiver)._store = store
    return store


def test_nothing_that_follows_is_done_before_the_disk_has_it_and_the_rest_goes_on(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        session, link = pair.session[Role.SENDER], pair.link[Role.SENDER]
        store = slow(pair, Role.SENDER, 0.6)
        said = len(kinds(link.sent, Status))
        pair.sender.agreed(1)
        await asyncio.sleep(0.5)
        pair.sender.agreed(1)  # the next frame agrees too: that is no second commit
        assert store.kept is None and session.responsible
        assert not kinds(link.sent, Commit)
        assert len(kinds(link.sent, Status)) >= said + 4  # and whoever flies the drone is not held up either
        assert session.peer_silence_s() < 0.3
        await until(lambda: not session.responsible)
        assert store.kept is not None and store.kept.record.duty == "released"
        assert await pair.decide(agree=False) == {Role.SENDER: Outcome.COMMITTED, Role.RECEIVER: Outcome.COMMITTED}

    pair = fly(rig, course)
    assert len({commit.nonce for commit in cast(list[Commit], kinds(pair.link[Role.SENDER].sent, Commit))}) == 1


def test_what_is_said_while_the_disk_is_written_to_is_heard_after(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        store = slow(pair, Role.SENDER, 0.5)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        heard = len(kinds(pair.link[Role.RECEIVER].sent, Accept))
        pair.sender.end(NO_END)  # comes before the ACCEPT is written down: too late to abort, it waits its turn
        await until(lambda: pair.receiver.holds_for_good)
        assert store.duties == ["released", "handed_over"]
        assert len(kinds(pair.link[Role.RECEIVER].sent, Accept)) > heard

    assert fly(rig, course).responsible() == {Role.SENDER: False, Role.RECEIVER: True}


@pytest.mark.parametrize(("takes_s", "held"), [(0.6, True), (2.0, False)])
def test_a_receiver_whose_disk_is_slow_takes_within_the_lease_or_not_at_all(
    rig: Any, takes_s: float, held: bool
) -> None:
    async def course(pair: Pair) -> None:
        slow(pair, Role.RECEIVER, takes_s)
        pair.sender.agreed(1)
        await asyncio.sleep(takes_s - 0.1)
        assert pair.responsible() == {Role.SENDER: False, Role.RECEIVER: False} or not held
        await asyncio.sleep(3.0)
        assert pair.responsible() == {Role.SENDER: not held, Role.RECEIVER: held}

    pair = fly(rig, course)
    assert bool(kinds(pair.link[Role.RECEIVER].sent, Accept)) is held


def test_a_new_epoch_is_on_the_disk_before_it_is_spoken_in(rig: Any) -> None:
    async def main() -> None:
        pair = Pair(rig)
        store = slow(pair, Role.SENDER, 0.5)
        offering = asyncio.create_task(pair.sender.offer())
        await asyncio.sleep(0.4)
        assert not offering.done() and pair.sender.epoch == 0
        await offering
        assert pair.sender.epoch == 1 and store.kept is not None
        for session in pair.session.values():
            await session.cancel_spawned()

    run_virtual(main())


def test_a_receiver_answers_in_a_new_attempt_once_it_is_written_down(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        slow(pair, Role.RECEIVER, 0.5)
        pair.lose(Role.RECEIVER, Accept)
        pair.receiver.end(NO_END)
        assert pair.receiver.live == LIVE
        await asyncio.sleep(0.4)
        assert pair.receiver.live == LIVE
        await until(lambda: pair.receiver.live is None)

    fly(rig, course)


def test_a_disk_that_turns_out_to_be_full_ends_the_mission_and_leaves_all_as_it_was(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        slow(pair, Role.SENDER, 0.5, fails=True)
        pair.sender.agreed(1)
        end = await pair.session[Role.SENDER].ended
        assert end.outcome is Outcome.STATE_LOST
        assert not pair.sender.released and pair.session[Role.SENDER].responsible
        assert not kinds(pair.link[Role.SENDER].sent, Commit)
        pair.session[Role.SENDER].ended = asyncio.get_running_loop().create_future()

    fly(rig, course)


def test_the_end_of_a_program_waits_for_the_disk_but_not_for_ever(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        loop = asyncio.get_running_loop()
        slow(pair, Role.RECEIVER, 0.5)
        pair.receiver.end(NO_END)
        await pair.receiver.finish()
        assert kinds(pair.link[Role.RECEIVER].sent, Abort)
        slow(pair, Role.SENDER, 60.0)
        pair.sender.agreed(1)
        begun_s = loop.time()
        await pair.sender.finish()
        assert loop.time() - begun_s < 3.0

    fly(rig, course)


def test_after_a_reboot_a_lease_is_over_for_the_receiver_and_begins_anew_for_the_sender(rig: Any) -> None:
    """The boot's change reaches the machines: instants of another clock are no instants."""

    async def course(pair: Pair) -> None:
        pair.lose(Role.RECEIVER, Accept)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        kept = {role: cast(Kept, pair.store[role].load()).record for role in Role}
        session = pair.session[Role.RECEIVER]
        again = ReceiverHandover(session, MemoryStore(Kept(kept[Role.RECEIVER], same_clock=False)), lambda: True)
        assert isinstance(again.state, LetGo) and not again.holds and not session.responsible
        sender = pair.session[Role.SENDER]
        whole = SenderHandover(sender, MemoryStore(Kept(kept[Role.SENDER], same_clock=False)))
        config = protocol_config(sender)
        longest_ns = round((config.lease_s + config.max_uncertainty_s) * 1e9)
        assert whole.state.take_back_ns == sender.now_ns() + longest_ns

    fly(rig, course)
