"""A role's disk that fails: what is not written down is not said either."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any, cast

import pytest

from drivers.interfaces import Kept, StateError
from drivers.log.state_file import MemoryStore, StateFile
from flight.outcome import Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.handover import ReceiverHandover
from path.messages import Accept, Commit, Confirm, Role
from path.protocol.values import ReceiverRecord, SenderRecord
from tests.missions.fly.leg.handover_pair import NO_END, Pair, fly, killed, kinds, started, until


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


def with_failing(
    rig: Any, role: Role, duty: str, course: Callable[[Pair], Coroutine[Any, Any, None]]
) -> Pair:
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


def test_a_full_disk_is_a_named_end(
    rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
