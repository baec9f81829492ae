"""A role's disk that is slow: what follows waits for it, and the rest goes on."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from typing import Any, cast

import pytest

from drivers.interfaces import StateError
from drivers.log.state_file import MemoryStore
from flight.outcome import Outcome
from hil.harness.virtual_time import run_virtual
from path.messages import Abort, Accept, Commit, Role, Status
from path.protocol.values import Handoff, ReceiverRecord, SenderRecord
from tests.missions.fly.leg.handover_pair import NO_END, Pair, fly, kinds, until

LIVE = Handoff(1, 1, 1)


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
                saved.set_exception(
                    StateError("cannot write: No space left on device", "make room")
                )
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
        # and whoever flies the drone is not held up either
        assert len(kinds(link.sent, Status)) >= said + 4
        assert session.peer_silence_s() < 0.3
        await until(lambda: not session.responsible)
        assert store.kept is not None and store.kept.record.duty == "released"
        assert await pair.decide(agree=False) == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    pair = fly(rig, course)
    assert (
        len(
            {
                commit.nonce
                for commit in cast(list[Commit], kinds(pair.link[Role.SENDER].sent, Commit))
            }
        )
        == 1
    )


def test_what_is_said_while_the_disk_is_written_to_is_heard_after(rig: Any) -> None:
    async def course(pair: Pair) -> None:
        store = slow(pair, Role.SENDER, 0.5)
        pair.sender.agreed(1)
        await until(lambda: pair.receiver.holds)
        heard = len(kinds(pair.link[Role.RECEIVER].sent, Accept))
        # comes before the ACCEPT is written down: too late to abort, it waits its turn
        pair.sender.end(NO_END)
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


def test_a_disk_that_turns_out_to_be_full_ends_the_mission_and_leaves_all_as_it_was(
    rig: Any,
) -> None:
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
