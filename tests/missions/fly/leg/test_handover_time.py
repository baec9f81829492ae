"""Leases, clocks and statuses of a hand-over, to the instant at which each of them is over."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import pytest

from drivers.interfaces import Received
from flight.clocks import ClockAlignment, PingResult
from flight.outcome import Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.handover import protocol_config
from missions.fly.leg.session import RoleSession
from path.messages import Accept, Commit, Confirm, Pong, Role, Status
from path.protocol.receiver import LetGo, Provisional
from path.protocol.values import PeerStatus, TakeResponsibility
from tests.missions.fly.leg.handover_pair import OffsetClock, Pair, fly, kinds, until


def test_a_lease_taken_at_its_very_end_is_let_go_in_time(rig: Any) -> None:
    """The receiver's program must not sleep through a deadline that the COMMIT has just set."""
    ends_ns: list[int] = []

    async def course(pair: Pair) -> None:
        pair.able = False
        for link in pair.link.values():
            # then it hears no more, and has only the time
            link.lost = lambda _: pair.receiver.holds
        pair.sender.agreed(1)
        await asyncio.sleep(protocol_config(pair.session[Role.SENDER]).lease_s - 0.1)
        pair.able = True
        await until(lambda: pair.receiver.holds)
        ends_ns.append(pair.receiver.state.lease_end_ns - pair.session[Role.RECEIVER].now_ns())
        ends_ns[0] += round(asyncio.get_running_loop().time() * 1e9)
        await until(lambda: pair.responsible() == {Role.SENDER: True, Role.RECEIVER: False})

    pair = fly(rig, course)
    let_go = [
        at_s for at_s, topic, _ in pair.log[Role.RECEIVER].entries if topic == "/responsibility"
    ][-1]
    assert -1e-6 <= let_go - ends_ns[0] * 1e-9 < 0.02


@pytest.mark.parametrize("stall_s", [0.1, 0.39, 2.0])
def test_a_receiver_that_sleeps_through_the_end_of_its_lease_is_not_responsible_when_it_wakes(
    rig: Any, stall_s: float
) -> None:
    """S1 by the clock and not by a timer: nothing of its program runs while the sender takes
    back.
    """

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
        pair.session[Role.RECEIVER].log.write(
            "/responsibility", 0, {"responsible": False, "until_ns": None}
        )
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
        # long after the newest exchange: a wide bound
        stamp_ns = session.now_ns() + alignment.offset_ns + 10**12
        status = replace(
            cast(Status, kinds(pair.link[Role.RECEIVER].sent, Status)[-1]), stamp_ns=stamp_ns
        )
        pair.sender.on_status(status)
        own_ns = alignment.to_own_ns(stamp_ns)
        assert heard == [
            PeerStatus(False, own_ns - alignment.uncertainty_at(own_ns), pair.receiver.instance)
        ]
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
        assert await pair.decide(agree=False) == {
            Role.SENDER: Outcome.COMMITTED,
            Role.RECEIVER: Outcome.COMMITTED,
        }

    fly(rig, course)


class Deaf(ClockAlignment):
    """Clocks that do not become aligned."""

    def on_pong(self, pong: Pong, arrival_ns: int) -> PingResult:
        del pong, arrival_ns
        return PingResult.DUPLICATE


def widening(session: RoleSession) -> Callable[[int], int]:
    """A bound on the clocks that is as wide as may be for a second from now, and then a little
    wider.
    """
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
