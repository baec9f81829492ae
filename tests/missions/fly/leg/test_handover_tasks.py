"""The disk, tasks and deadlines of a hand-over's machine: their order, and what waits for what."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import Received, StateError
from drivers.log.state_file import MemoryStore
from flight.outcome import MissionEnd, Outcome
from missions.fly.leg import machine_run
from path.messages import AbortReason, Commit, Confirm, Message, Role
from path.protocol.values import AbortRequested, Send
from tests.missions.fly.leg.handover_pair import Pair, fly


def test_a_slow_disk_is_told_of(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        slow = SlowStore(pair.store[Role.SENDER], 0.7)
        pair.sender._store = slow
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

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
        assert [record["outcome"] for record in pair.log[Role.SENDER].of("/decision")] == [
            "timeout"
        ]
        del now.now_ns

    fly(rig, course)


def test_a_record_that_failed_after_the_mission_is_not_told_of_by_asyncio(
    caplog: pytest.LogCaptureFixture,
) -> None:
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


# --- a new mission


def test_a_new_mission_is_not_decided_by_the_one_before(rig: Any) -> None:
    """Nor is what became of it known already."""

    async def course(pair: Pair) -> None:
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }
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
    """A receiver that is quicker than the sender's own log must not seem to have taken over before
    the COMMIT.
    """
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
    commit = Commit(
        1, epoch=1, target_id=1, nonce=7, lease_end_ns=2_000_000_000, stamp_ns=1_000, instance=5
    )
    carrier.carry_out(Send(commit))
    assert written == [("/commit", 1_000)]


def test_what_is_said_while_the_disk_writes_is_done_in_the_order_in_which_it_was_said(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An own decision does not overtake a message that waits: what was accepted before it was
    accepted.
    """
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


def test_what_was_let_go_of_stays_so_when_the_disk_cannot_take_the_record_of_it(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The release came before the record: the machine does not go back to holding what its session
    let go of.
    """

    async def course(pair: Pair) -> None:
        assert await pair.decide() == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

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


def test_an_end_that_the_disk_does_not_take_is_said_and_ends_all_the_same(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def course(pair: Pair) -> None:
        def full(_: object) -> None:
            raise StateError("cannot write: No space left on device", "make room")

        said: list[str] = []
        monkeypatch.setattr(pair.session[Role.SENDER], "say", said.append)
        monkeypatch.setattr(pair.sender, "_step", full)
        monkeypatch.setattr(pair.sender, "_machine", SimpleNamespace(live=object()))
        pair.sender._give_up(MissionEnd(Outcome.INTERRUPTED, "Ctrl-C"))
        assert said == ["cannot write: No space left on device"]
        monkeypatch.undo()

    fly(rig, course)
