"""D1's decisions beside the flight of a whole leg: whom it makes room for, what it keeps to, what
is an answer.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import Received
from drivers.log.state_file import MemoryStore
from flight.config import MissionConfig
from flight.guidance import Vec3, add, from_heading, norm, scale, subtract
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.tracking.target_track import TargetTrack
from flight.way_out import way_out_m
from missions.fly.leg.sender import Sender
from path.geometry.rotation import quat_from_rpy
from path.messages import Candidate, Pong, Role, Status
from path.observations import Box, Missed, MissReason
from tests.doubles import LoopClock
from tests.missions.fly.leg.session_bench import STATE, Bench, virtual

CONFIG = MissionConfig()
PEER = Status(Role.RECEIVER, 1, (1.0, 3.0, -1.5), (0.0, 0.0, 0.0), 0.0, 0, False, False, 0.8)
CANDIDATE = Candidate(
    1,
    1,
    1,
    1,
    1,
    500_000_000,
    Box(1.0, 2.0, 3.0, 4.0),
    None,
    (-0.6, 0.0, -0.8),
    (1.0, 0.0, 0.0, 0.0),
    0.01,
)


def with_sender(rig: Any, main: Callable[[Bench, Any], Coroutine[Any, Any, None]]) -> None:
    """Run something with a sender on a session whose parts stand in."""

    async def run() -> None:
        bench = Bench(rig)
        await main(bench, cast(Any, Sender(bench.session, MemoryStore())))

    virtual(run())


def align(bench: Bench, ahead_ns: int = 0) -> None:
    for nonce in range(1, 9):
        sent_ns = nonce * 1000
        there_ns = sent_ns + ahead_ns
        bench.session.alignment.on_pong(Pong(nonce, sent_ns, there_ns, there_ns), sent_ns + 10)
    assert bench.session.alignment.ready


def tracked(place: Vec3 = (5.0, 1.0, -0.2), moves: Vec3 = (0.4, -0.2, 0.3)) -> TargetTrack:
    track = TargetTrack.of(CONFIG, place, LoopClock(1.0).now_ns())
    track.velocity_n_mps = moves
    return track


def test_what_the_link_brings_reaches_the_hand_over_and_answers_the_cycle_too(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        heard: list[object] = []
        answers: list[object] = []

        def hear(received: Received) -> None:
            heard.append(received.message)

        sender._handover.on_message = hear
        sender._on_candidate = answers.append
        bench.session.spawn(bench.session.pump())
        bench.link.waiting.put_nowait(CANDIDATE)
        await asyncio.sleep(0.1)
        assert heard == answers == [CANDIDATE]
        assert bench.session.on_status == sender._handover.on_status
        await bench.session.cancel_spawned()

    with_sender(rig, main)


@pytest.mark.parametrize(
    ("peer", "heading_rad", "silent_s", "side"),
    [
        (None, 0.0, 0.0, -1.0),
        (PEER, 0.0, 0.0, 1.0),
        (replace(PEER, position_n_m=(1.0, 1.9, -1.5)), 0.0, 0.0, -1.0),
        (replace(PEER, position_n_m=(1.0, 2.0, -1.5)), 0.0, 0.0, -1.0),
        (replace(PEER, position_n_m=(0.0, 2.0, -1.5)), math.pi / 2, 0.0, 1.0),
        (replace(PEER, position_n_m=(2.0, 2.0, -1.5)), math.pi / 2, 0.0, -1.0),
        (replace(PEER, velocity_n_mps=(0.0, -2.0, 0.0)), 0.0, 0.4, 1.0),
        (replace(PEER, velocity_n_mps=(0.0, -2.0, 0.0)), 0.0, 0.6, -1.0),
        # nobody flies on for so long
        (replace(PEER, velocity_n_mps=(0.0, -1.0, 0.0)), 0.0, 9.0, 1.0),
    ],
)
def test_the_receiver_s_side_is_where_it_was_heard_and_flew_to(
    rig: Any, peer: Status | None, heading_rad: float, silent_s: float, side: float
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        bench.session.peer = peer
        bench.session.peer_heard_ns = bench.session.now_ns() - round(silent_s * 1e9)
        sender._heading_rad = heading_rad
        assert sender._side_of_receiver(STATE) == side
        sender._receiver_side = -side
        assert sender._side_of_receiver(STATE) == -side  # as it was measured

    with_sender(rig, main)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_leaves_to_the_side_where_the_receiver_is_not_and_to_the_same_place_however_often_it_is_asked(
    rig: Any, side: float
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        heading_rad = 0.4
        bench.vehicle.state = replace(STATE, q_n_b=quat_from_rpy(0.0, 0.0, 1.1))
        sender._track, sender._receiver_side, sender._heading_rad = tracked(), side, heading_rad
        aside = from_heading((0.0, -side, 0.0), heading_rad)
        way_m = way_out_m(
            sender._track,
            STATE.position_n_m,
            aside,
            CONFIG,
            bench.session.now_ns(),
            CONFIG.depart_m,
        )
        left = sender._leave()
        assert left.position_n_m == pytest.approx(add(STATE.position_n_m, scale(aside, way_m)))
        assert left.yaw_rad == pytest.approx(1.1)
        bench.vehicle.state = replace(STATE, position_n_m=(9.0, 9.0, -1.5))
        assert sender._leave() is left

    with_sender(rig, main)


def test_without_a_target_it_leaves_nobody_s_way(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        assert sender._leave().position_n_m == STATE.position_n_m

    with_sender(rig, main)


def test_how_near_the_receiver_is_goes_by_what_it_does(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        assert sender._may_regain() and not sender._comes_near()
        for phase in Phase:
            bench.session.peer = replace(PEER, phase=int(phase))
            # a mission of one's own does not say where it is
            on_a_course = phase is not Phase.MISSION
            assert sender._may_regain() is not (on_a_course and phase >= Phase.STAND_OFF)
            assert sender._comes_near() is (on_a_course and phase >= Phase.APPROACH)
        bench.session.peer = None
        bench.session.enter(Phase.VERIFY)
        assert sender._comes_near()

    with_sender(rig, main)


def test_it_backs_off_once_the_target_is_unseen_for_half_of_what_may_be_coasted(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        assert not sender._regaining()
        sender._track = tracked()
        half_ns = round(0.5 * CONFIG.deadlines.target_coast_s * 1e9)
        sender._track.stamp_ns = bench.session.now_ns() - half_ns
        assert not sender._regaining()
        sender._track.stamp_ns -= 1000
        assert sender._regaining()
        bench.session.peer = replace(PEER, phase=int(Phase.STAND_OFF))
        assert not sender._regaining()

    with_sender(rig, main)


@pytest.mark.parametrize(("silent_s", "stands"), [(0.8, False), (0.81, True)])
def test_it_stands_still_while_a_receiver_that_was_near_is_not_heard(
    rig: Any, silent_s: float, stands: bool
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        sender._track = tracked()
        bench.session.peer = replace(PEER, phase=int(Phase.APPROACH))
        bench.session.peer_heard_ns = bench.session.now_ns() - round(silent_s * 1e9)
        setpoint = sender._follow_target(STATE)
        assert (norm(setpoint.velocity_n_mps) == 0.0) is stands
        bench.session.peer = replace(PEER, phase=int(Phase.SEARCH))
        assert norm(sender._follow_target(STATE).velocity_n_mps) > 0.0

    with_sender(rig, main)


def test_it_follows_over_ground_and_looks_at_the_target(rig: Any) -> None:
    """What a target that does not fly seems to do up and down is not followed."""

    async def main(bench: Bench, sender: Any) -> None:
        sender._track = tracked()
        target, (north, east, _) = sender._track.believed(bench.session.now_ns())
        place = sender._view_of(target)
        expected = sender._approach(place, (north, east, 0.0), STATE)
        setpoint = sender._follow_target(STATE)
        assert setpoint.velocity_n_mps == expected.velocity_n_mps
        assert setpoint.yaw_rad == sender._look_round.yaw_rad(STATE.position_n_m, target)
        leaving = sender._leave_watching(STATE)
        seen, _ = sender._track.predict(bench.session.now_ns())
        to_target = subtract(seen, STATE.position_n_m)
        assert leaving.yaw_rad == pytest.approx(math.atan2(to_target[1], to_target[0]))
        assert leaving.velocity_n_mps == sender._leave().hold(STATE).velocity_n_mps

    with_sender(rig, main)


def test_an_answer_counts_once_there_is_an_attempt_and_the_clocks_are_known(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        heard: list[tuple[object, int, int]] = []
        answer: list[Missed | None] = [None]

        def hear(candidate: Candidate, capture_ns: int, now_ns: int) -> Missed | None:
            heard.append((candidate, capture_ns, now_ns))
            return answer[0]

        side = SimpleNamespace(hear=hear)
        sender._on_candidate(CANDIDATE)
        sender._side = side
        sender._on_candidate(CANDIDATE)
        assert (heard, sender._candidates) == ([], 0)
        align(bench, ahead_ns=7_000_000)
        sender._on_candidate(CANDIDATE)
        ((candidate, capture_ns, now_ns),) = heard
        assert candidate is CANDIDATE and now_ns == bench.session.now_ns()
        assert (
            capture_ns
            == bench.session.alignment.to_own_ns(CANDIDATE.capture_ns)
            != CANDIDATE.capture_ns
        )
        assert sender._candidates == 1 and len(bench.log.of("/heard_candidate")) == 1
        assert sender._receiver_side == -1.0
        assert bench.session.shown.separation_m == pytest.approx(1.0)
        answer[0] = Missed(MissReason.STALE, ignored=True)
        right = replace(CANDIDATE, position_v_m=(0.6, 0.0, 0.0))
        sender._on_candidate(right)
        # what is refused tells nothing
        assert (sender._candidates, sender._receiver_side) == (1, -1.0)
        answer[0] = None
        sender._on_candidate(replace(right, box=None, reason=MissReason.NO_CANDIDATE))
        assert (sender._candidates, sender._receiver_side) == (2, -1.0)
        sender._on_candidate(right)
        assert (sender._candidates, sender._receiver_side) == (3, 1.0)

    with_sender(rig, main)


def test_a_step_of_the_estimator_reaches_the_evidence_once_there_is_some(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        bench.session.on_step(3)  # before any attempt
        anew: list[int] = []
        sender._side = SimpleNamespace(begin_evidence_anew=anew.append)
        bench.session.on_step(4)
        assert anew == [4]

    with_sender(rig, main)


def test_a_target_that_is_not_found_in_time_ends_the_search_with_what_was_looked_for(
    rig: Any,
) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        with pytest.raises(MissionEnd) as caught:
            await sender._until_acquired(5.0)
        assert caught.value.outcome is Outcome.TARGET_NOT_FOUND
        assert caught.value.detail == f"within 5 s: {sender._designating.why()}"
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.3)
        sender._track = tracked()
        await sender._until_acquired(0.0)

    with_sender(rig, main)


def test_the_receiver_must_be_heard_until_the_target_is_given_away(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        state = SimpleNamespace(handed_over=False, released=True)
        sender._handover = state
        bench.session.peer = PEER
        watching = asyncio.create_task(sender._watch_peer())
        await asyncio.sleep(9.0)
        assert not watching.done()  # the lease decides
        state.released = False
        await asyncio.sleep(1.0)
        assert watching.done() and isinstance(watching.exception(), MissionEnd)
        state.handed_over = True
        await sender._watch_peer()

    with_sender(rig, main)


def test_a_message_of_another_kind_is_no_answer(rig: Any) -> None:
    async def main(bench: Bench, sender: Any) -> None:
        heard: list[object] = []
        sender._handover = SimpleNamespace(on_message=heard.append)
        answers: list[object] = []
        sender._on_candidate = answers.append
        received = Received(replace(PEER), 5)
        sender._on_message(received)
        assert heard == [received] and answers == []

    with_sender(rig, main)
