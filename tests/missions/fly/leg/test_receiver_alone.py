"""D2's decisions beside the flight of a whole leg: what it judges the marker by, what it keeps, and
how it ends.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import Received
from drivers.log.state_file import MemoryStore
from flight.config import MissionConfig
from flight.guidance import Vec3, add, approach, bearing, from_heading, subtract
from flight.outcome import KEPT_S, MissionEnd, Outcome
from flight.phases import Phase
from flight.tracking.target_track import TargetTrack
from flight.way_out import way_out_m
from missions.fly.leg.receiver import Receiver
from path.messages import Pong, Role, Status, Target
from path.observations import Missed, MissReason
from path.protocol.values import Handoff
from tests.doubles import LoopClock
from tests.missions.fly.leg.session_bench import STATE, Bench, virtual

CONFIG = MissionConfig()
PEER = Status(
    Role.SENDER, 500_000_000, (3.0, 2.0, -1.5), (0.3, 0.1, 0.0), 0.7, 4, False, False, 0.8
)
TARGET = Target(1, 1, 1, 1, 400_000_000, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 0.01)
AWAY_S = CONFIG.deadlines.marker_coast_s + CONFIG.deadlines.marker_regain_s
LOST_S = AWAY_S + CONFIG.deadlines.marker_away_s


def with_receiver(rig: Any, main: Callable[[Bench, Any], Coroutine[Any, Any, None]]) -> None:
    """Run something with a receiver on a session whose parts stand in."""

    async def run() -> None:
        bench = Bench(rig, role=Role.RECEIVER)
        bench.session.peer, bench.session.peer_heard_ns = PEER, bench.session.now_ns()
        await main(bench, cast(Any, Receiver(bench.session, MemoryStore())))

    virtual(run())


def tracked(place: Vec3 = (5.0, 1.0, -0.2), moves: Vec3 = (0.4, -0.2, 0.3)) -> TargetTrack:
    track = TargetTrack.of(CONFIG, place, LoopClock(1.0).now_ns())
    track.velocity_n_mps = moves
    return track


def marker(way_n_m: Vec3 | None, found: bool = True, unseen_s: float = 0.0) -> Any:
    """What the marker's view says."""

    def predict(_stamp_ns: int) -> object:
        return None if way_n_m is None else SimpleNamespace(marker_n_m=way_n_m)

    def is_found(_now_ns: int) -> bool:
        return found

    def unseen(_stamp_ns: int) -> float:
        return unseen_s

    return SimpleNamespace(predict=predict, found=is_found, unseen_s=unseen)


def ended(step: Callable[[], object]) -> MissionEnd:
    with pytest.raises(MissionEnd) as caught:
        step()
    return caught.value


def test_what_the_link_brings_reaches_the_hand_over_first_and_targets_the_cycle_too(
    rig: Any,
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        heard: list[str] = []

        def hear(_received: Received) -> None:
            heard.append("hand-over")

        def take_up(target: Target) -> None:
            heard.append(f"target {target.sequence}")

        receiver._handover = SimpleNamespace(holds=False, on_message=hear)
        receiver._on_target = take_up
        bench.session.spawn(bench.session.pump())
        bench.link.waiting.put_nowait(TARGET)
        await asyncio.sleep(0.1)
        assert heard == ["hand-over", "target 1"]
        await bench.session.cancel_spawned()

    with_receiver(rig, main)


def test_a_status_reaches_the_hand_over(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        assert bench.session.on_status == receiver._handover.on_status

    with_receiver(rig, main)


def test_the_picture_in_which_the_target_was_taken_over_is_kept(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        kept: list[tuple[object, bool]] = []
        state = SimpleNamespace(holds=False)

        def keep(view: object, wanted: bool = False) -> None:
            kept.append((view, wanted))

        def hear(_received: Received) -> None:
            state.holds = True

        cast(Any, bench.session.frames).log_image = keep
        state.on_message = hear
        receiver._handover, receiver._seen = state, "a view"
        message = cast(Any, SimpleNamespace(message=PEER))
        receiver._on_message(message)
        receiver._on_message(message)  # held already
        assert kept == [("a view", True)]

    with_receiver(rig, main)


@pytest.mark.parametrize(
    ("taken_s", "kept_s", "outcome"),
    [
        (None, 3.0, Outcome.TARGET_LOST),
        (20.0, 3.0, Outcome.LOST_AFTER),
        (20.0, KEPT_S - 0.01, Outcome.LOST_AFTER),
        (20.0, KEPT_S, Outcome.TARGET_LOST),
    ],
)
def test_a_target_that_is_lost_soon_after_it_was_taken_over_is_a_loss_of_its_own(
    rig: Any, taken_s: float | None, kept_s: float, outcome: Outcome
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._track = tracked()
        receiver._taken_ns = 0 if taken_s is None else round(taken_s * 1e9)
        receiver._track.seen_ns = round(((taken_s or 0.0) + kept_s) * 1e9)
        end = receiver._lost("gone")
        assert (end.outcome, end.detail) == (outcome, "gone")

    with_receiver(rig, main)


def test_a_target_that_was_never_seen_after_it_was_taken_over_is_lost_after_it(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._taken_ns = 1
        assert receiver._lost("gone").outcome is Outcome.LOST_AFTER

    with_receiver(rig, main)


def test_it_can_take_what_it_saw_within_half_a_second_and_has_in_view_what_may_be_coasted(
    rig: Any,
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        await asyncio.sleep(10.0)
        assert not receiver._able() and not receiver._in_view()
        receiver._track = tracked()
        now_ns, coast_ns = bench.session.now_ns(), round(CONFIG.deadlines.target_coast_s * 1e9)
        for ago_ns, able, in_view in (
            (0, True, True),
            (499_999_999, True, True),
            (500_000_000, False, True),
            (coast_ns, False, True),
            (coast_ns + 1000, False, False),
        ):
            receiver._track.seen_ns = now_ns - ago_ns
            assert (receiver._able(), receiver._in_view()) == (able, in_view), ago_ns

    with_receiver(rig, main)


def test_it_goes_back_before_it_lands_off_the_way_of_what_it_follows(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        assert receiver._retreat_m(STATE, 0.4) == 1.8
        receiver._track = tracked(moves=(-0.4, 0.0, 0.0))
        back = from_heading((-1.0, 0.0, 0.0), 0.4)
        expected = way_out_m(
            receiver._track, STATE.position_n_m, back, CONFIG, bench.session.now_ns(), 1.8
        )
        assert receiver._retreat_m(STATE, 0.4) == expected >= 1.8

    with_receiver(rig, main)


def test_the_way_back_is_behind_it_in_its_own_heading(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        ways: list[Any] = []

        async def come_down(_end: MissionEnd | None, way_out: Any) -> bool:
            ways.append(way_out)
            return True

        async def finish() -> None: ...

        ends: list[MissionEnd | None] = []
        receiver._come_down = come_down
        receiver._handover = SimpleNamespace(end=ends.append, finish=finish)
        end = MissionEnd(Outcome.MARKER_LOST, "x")
        assert await receiver.recover(end)
        (way_out,) = ways
        assert way_out.position_n_m == pytest.approx(add(STATE.position_n_m, (-1.8, 0.0, 0.0)))
        assert way_out.yaw_rad == 0.0 and ends == [end] and receiver._leaving

    with_receiver(rig, main)


@pytest.mark.parametrize(
    ("way_m", "found", "near"),
    [(1.5, True, True), (1.5, False, False), (9.0, True, False), (None, True, False)],
)
def test_it_is_near_enough_to_approach_once_it_has_measured_the_marker_nearer_than_the_stand_off(
    rig: Any, way_m: float | None, found: bool, near: bool
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._marker = marker(None if way_m is None else (way_m, 0.0, 0.0), found)
        assert receiver._near() is near
        assert 1.5 < receiver._rendezvous.stand_off_m < 9.0

    with_receiver(rig, main)


def test_a_measured_distance_is_told_and_judged_and_shows_where_the_sender_is_while_it_is_flown_to(
    rig: Any,
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        told: list[object] = []
        seen: list[tuple[object, Vec3]] = []
        cast(Any, bench.session).note_separation = told.append

        def note_seen(state: object, way_n_m: Vec3) -> None:
            seen.append((state, way_n_m))

        receiver._rendezvous = SimpleNamespace(note_seen=note_seen)
        receiver._marker = marker((0.0, 3.0, 4.0))
        for phase in Phase:
            bench.session.phase = phase
            receiver._judge_marker(5)
        assert told == [5.0] * len(Phase)
        # stand-off, search, approach, verify
        assert [way for _, way in seen] == [(0.0, 3.0, 4.0)] * 4
        receiver._marker = marker((0.0, 0.0, CONFIG.separation.minimum_m - 0.01))
        assert ended(lambda: receiver._judge_marker(5)).outcome is Outcome.TOO_CLOSE

    with_receiver(rig, main)


@pytest.mark.parametrize("phase", list(Phase))
def test_a_marker_that_stays_unseen_ends_a_verification_and_nothing_else(
    rig: Any, phase: Phase
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        bench.session.phase = phase
        receiver._marker = marker(None, unseen_s=LOST_S)
        receiver._judge_marker(5)
        receiver._marker = marker(None, unseen_s=LOST_S + 0.1)
        if phase is not Phase.VERIFY:
            receiver._judge_marker(5)
            return
        end = ended(lambda: receiver._judge_marker(5))
        assert (end.outcome, end.detail) == (
            Outcome.MARKER_LOST,
            f"marker not seen for {LOST_S + 0.1:.1f} s",
        )

    with_receiver(rig, main)


def test_a_receiver_that_lost_the_marker_in_verification_holds_off_until_it_is_found_again(
    rig: Any,
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        pilot = bench.session.pilot
        way = receiver._rendezvous
        bench.session.phase = Phase.VERIFY
        pilot.in_control = True
        pilot.guidance = way.to_viewpoint
        receiver._marker = marker(None, found=False, unseen_s=AWAY_S)
        receiver._judge_marker(5)
        assert pilot.guidance == way.to_viewpoint  # it backs off at first, and sees it again
        receiver._marker = marker(None, found=False, unseen_s=AWAY_S + 0.1)
        receiver._judge_marker(6)
        assert pilot.guidance == way.hold_off
        receiver._marker = marker((0.0, 3.0, 4.0), found=False)  # seen once
        receiver._judge_marker(7)
        assert pilot.guidance == way.hold_off
        receiver._marker = marker((0.0, 3.0, 4.0))
        receiver._judge_marker(8)
        assert pilot.guidance == way.to_viewpoint
        pilot.in_control = False
        receiver._marker = marker(None, found=False, unseen_s=AWAY_S + 0.1)
        receiver._judge_marker(9)
        assert pilot.guidance == way.to_viewpoint

    with_receiver(rig, main)


def test_what_is_wrong_with_the_marker_is_told_once_of_each_kind(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        assert receiver._marker_not_seen() == "the sender's marker was not seen"
        for missed in (
            Missed(MissReason.NO_MARKER),
            Missed(MissReason.NO_MARKER, cause="another id"),
            Missed(MissReason.NO_MARKER, cause="another id again"),
            Missed(MissReason.MARKER_FLIPPED, cause="upside down"),
        ):
            receiver._note_cause(missed)
        notes = [record["note"] for record in bench.log.of("/note")]
        assert notes == ["the sender's marker: another id", "the sender's marker: upside down"]
        assert (
            receiver._marker_not_seen()
            == "the sender's marker was not seen; another id; upside down"
        )

    with_receiver(rig, main)


def test_the_sender_s_motion_is_of_the_instant_it_says_once_its_clock_is_known(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        session = bench.session
        before = receiver._motion()
        assert before.peer_stamp_ns == session.peer_heard_ns
        assert (before.own_stamp_ns, before.own_n_mps) == (STATE.stamp_ns, STATE.velocity_n_mps)
        assert (before.peer_n_mps, before.peer_yaw_rad) == (PEER.velocity_n_mps, PEER.yaw_rad)
        for nonce in range(1, 9):
            session.alignment.on_pong(
                Pong(nonce, nonce * 1000, nonce * 1000, nonce * 1000), nonce * 1000 + 10
            )
        assert session.alignment.ready
        assert receiver._motion().peer_stamp_ns == session.alignment.to_own_ns(PEER.stamp_ns)

    with_receiver(rig, main)


def test_it_keeps_the_place_beside_the_target_that_it_was_found_in(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._track, receiver._keep_n_m = tracked(), (-2.0, 0.5, -1.4)
        target, (north, east, _) = receiver._track.believed(bench.session.now_ns())
        error = subtract(add(target, (-2.0, 0.5, -1.4)), STATE.position_n_m)
        answer = CONFIG.follow.answer(CONFIG.max_accel_mps2)
        setpoint = receiver._follow_target(STATE)
        assert setpoint.velocity_n_mps == approach(
            error, STATE.velocity_n_mps, (north, east, 0.0), answer
        )
        assert setpoint.yaw_rad == bearing(subtract(target, STATE.position_n_m))

    with_receiver(rig, main)


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.VERIFY, Phase.DEPART, Phase.LAND])
def test_a_sender_on_its_way_down_ends_the_receiver_s_flight_while_nothing_is_decided(
    rig: Any, phase: Phase
) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        state = SimpleNamespace(holds_for_good=False, within_lease=True)
        receiver._handover = state
        bench.session.peer = replace(PEER, phase=int(phase))
        watching = asyncio.create_task(receiver._watch_peer())
        await asyncio.sleep(1.0)
        assert not watching.done()  # the lease decides
        state.within_lease = False
        await asyncio.sleep(0.5)
        assert watching.done() is (phase >= Phase.DEPART)
        if watching.done():
            end = cast(MissionEnd, watching.exception())
            assert (end.outcome, end.detail) == (
                Outcome.PEER_ABORTED,
                "the sender is on its way down",
            )
            return
        state.holds_for_good = True
        await asyncio.sleep(0.5)
        assert watching.done() and watching.exception() is None

    with_receiver(rig, main)


def test_a_sender_that_is_not_heard_any_more_ends_it_too(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        receiver._handover = SimpleNamespace(holds_for_good=False, within_lease=False)
        with pytest.raises(MissionEnd) as caught:
            await receiver._watch_peer()
        assert caught.value.outcome is Outcome.PEER_LOST
        silent_s = CONFIG.guard.peer_silence_s
        assert asyncio.get_running_loop().time() == pytest.approx(silent_s, abs=0.5)

    with_receiver(rig, main)


def test_a_target_is_taken_up_once_an_attempt_is_live_and_the_clocks_are_known(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        session, live = bench.session, Handoff(1, 1, 1, 77)
        receiver._handover = SimpleNamespace(live=None)
        receiver._on_target(TARGET)
        receiver._handover.live = live
        receiver._on_target(TARGET)
        assert receiver._newest is None and receiver._side is None
        for nonce in range(1, 9):
            session.alignment.on_pong(
                Pong(nonce, nonce * 1000, nonce * 1000, nonce * 1000), nonce * 1000 + 10
            )
        message = replace(TARGET, capture_ns=session.now_ns() - 5_000_000)
        receiver._on_target(message)
        assert receiver._newest == message and len(bench.log.of("/attempt")) == 1
        side = receiver._side
        later = replace(message, sequence=2, capture_ns=message.capture_ns + 20_000)
        receiver._on_target(later)
        assert receiver._newest == later and receiver._side is side
        receiver._on_target(later)  # again: it says nothing new
        assert len(bench.log.of("/heard_target")) == 3
        receiver._handover.live = Handoff(1, 2, 1, 78)
        receiver._on_target(
            replace(later, epoch=2, sequence=3, capture_ns=later.capture_ns + 20_000)
        )
        assert receiver._side is not side and len(bench.log.of("/attempt")) == 2

    with_receiver(rig, main)


def test_what_was_handed_over_but_never_located_is_lost(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        end = ended(lambda: receiver._follow_once(None, None))
        assert end.outcome is Outcome.TARGET_LOST and "never located" in end.detail

    with_receiver(rig, main)


def test_the_computer_s_load_says_how_often_the_marker_is_searched_for(rig: Any) -> None:
    async def main(bench: Bench, receiver: Any) -> None:
        cast(Any, bench.session.frames).shedding = SimpleNamespace(search_every=4)
        searches = [True]
        view: Any = SimpleNamespace(stamp_ns=7)

        def look(*_: object) -> Missed:
            return Missed(MissReason.NO_MARKER)

        def searched(stamp_ns: int) -> bool:
            return searches[0] and stamp_ns == 7

        receiver._marker = SimpleNamespace(look=look, searched=searched)
        receiver._look(view, np.eye(3), None)
        assert receiver._marker.search_every == 4
        assert receiver._searched is view
        searches[0], receiver._searched = False, None
        receiver._look(view, np.eye(3), None)
        assert receiver._searched is None

    with_receiver(rig, main)
